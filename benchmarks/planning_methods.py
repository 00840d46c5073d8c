# SPDX-License-Identifier: MIT
"""What the planning benchmark compares: a run's planner as users get it, its parts, ablations."""

import contextlib
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from hybrid_jax.agents import switching
from hybrid_jax.baselines.ablations import (
    ABLATIONS,
    ablated,
    joint_agent_only,
    lfd_only,
    plan_directly,
    rule_switcher,
)
from hybrid_jax.baselines.trained import whole_space_agent
from hybrid_jax.contracts import Combined, PlanResult
from hybrid_jax.planner.pipeline import plan_motion
from hybrid_jax.planner.records import Planner
from hybrid_jax.runs.load_planner import load_learned_chooser
from hybrid_jax.runs.run_folder import Run, create_run, open_run
from hybrid_jax.runs.seeds import SWITCHING_TEST
from hybrid_jax.runs.stages import learn
from hybrid_jax.runs.switch_problems import switch_problems
from hybrid_jax.tasks.registry import random_task
from hybrid_jax.tasks.task import Task

SWITCH_TEST = 48
"""Unseen tasks whose phases the switching agent is tried on."""

Method = Callable[[Task, jax.Array], PlanResult]


@contextlib.contextmanager
def trained_run(folder: Path | None, tiny: bool = False) -> Iterator[Run]:
    """A run of the handling cell with all agents: a folder's, or one made for the purpose.

    Args:
        folder: of a run; None trains one as `python -m hybrid_jax.train` does, and removes it.
        tiny: with preset `smoke`.
    """
    if folder:
        yield open_run(folder)
        return
    with tempfile.TemporaryDirectory() as made:
        preset = "smoke" if tiny else "default"
        run = create_run("gen3_handling", preset, 0, Path(made) / "run")
        learn(run)
        yield run


def phases_of(planner: Planner, tasks: range) -> Combined:
    """Both motions of the phases of random tasks, stacked."""
    drawn = [random_task(planner.cell, number) for number in tasks]
    return switch_problems(planner, drawn, jax.random.key(0))


def problems(some: Combined) -> list[Combined]:
    """Each of some stacked problems."""
    return [jax.tree.map(lambda a, i=i: a[i], some) for i in range(len(some.available))]


def optimal_returns(some: Combined, config: switching.SwitchConfig) -> np.ndarray:
    """Return of the best choices for each of some problems `[problem]`."""
    return np.array([switching.optimal_switching(one, config)[1] for one in problems(some)])


@dataclass(frozen=True)
class Optimality:
    """Returns on unseen phases over those of the optimum."""

    agent: np.ndarray
    """`[problem]` of the switching agent, ..."""
    rule: np.ndarray
    """... and of the joint agent wherever it has a motion."""


def switch_optimality(planner: Planner, config: switching.SwitchConfig, count: int) -> Optimality:
    """How a planner's switch compares with the best choices on the phases of so many tasks."""
    test = phases_of(planner, SWITCHING_TEST[:count])
    best = optimal_returns(test, config)
    follow = jax.jit(switching.episode_return, static_argnums=2)
    found = [
        np.array([float(follow(one, jnp.asarray(switch(one)), config)) for one in problems(test)])
        for switch in (planner.switch, rule_switcher)
    ]
    return Optimality(*(returns / best for returns in found))


def methods(run: Run, planner: Planner) -> dict[str, Method]:
    """Every method by its name; `hybrid` is the planner as `load_planner` gives it."""
    alone = replace(planner, fallback=None)
    direct = joint_agent_only(whole_space_agent(run, planner))

    def with_(some: Planner) -> Method:
        return lambda task, key: plan_motion(some, task, key=key)

    return {
        "hybrid": with_(planner),
        **{
            f"ablation_{name}": with_(
                ablated(name, planner, run.preset, lambda: load_learned_chooser(run))
            )
            for name in ABLATIONS
        },
        "no_fallback": with_(alone),
        "lfd": with_(lfd_only(planner)),
        "drl": lambda task, key: plan_directly(direct, [task], key=key)[0],
    }
