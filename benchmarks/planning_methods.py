# SPDX-License-Identifier: MIT
"""What the planning benchmark compares, on one cell with one trained joint agent."""

import functools
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from hybrid_jax.agents import joint, switching, training
from hybrid_jax.agents.segments import Segments
from hybrid_jax.agents.switching import Combined
from hybrid_jax.feasibility.building import build_feasibility_map
from hybrid_jax.planner.ablations import ablated
from hybrid_jax.planner.directly import joint_agent_only
from hybrid_jax.planner.harvest import harvest
from hybrid_jax.planner.lfd import optimal_chooser
from hybrid_jax.planner.loading import optimal_switcher, read_library
from hybrid_jax.planner.pipeline import lfd_only, plan_motion
from hybrid_jax.planner.records import Planner, PlanResult
from hybrid_jax.planner.switchdata import combined_phases
from hybrid_jax.presets import DEFAULT, SMOKE, Preset
from hybrid_jax.progress import Progress
from hybrid_jax.seeds import BENCHMARK_TRAINING, SWITCHING_TEST
from hybrid_jax.skills.task import Task
from hybrid_jax.skills.tasks import random_task
from hybrid_jax.types import Workcell

TRAINING_TASKS = 100
"""Tasks that the joint agent trains on."""
SWITCH_TASKS = 24
"""Training tasks whose combined trajectories the switching agent sees, ..."""
SWITCH_TEST = 48
"""... and the number of those that it is tested on."""

Method = Callable[[Task, jax.Array], PlanResult]


@dataclass(frozen=True)
class Learned:
    """A planner with its agents, and how the switching agent compares with the optimum."""

    planner: Planner
    ppo_switch: Callable
    optimality: np.ndarray
    """`[problem]` return of the switching agent over that of the optimum, on unseen tasks."""
    rule: np.ndarray
    """`[problem]` the same of the joint agent wherever it has a motion."""
    seconds: float
    """Of all trainings."""


def train_joint_agent(cell: Workcell, segments: Segments, preset: Preset) -> joint.Bridger:
    """A preset's joint agent."""
    config = preset.joint
    net = joint.make_net(cell, config)
    state = training.train(joint.make_world(cell, segments, config), net, config.training)
    return joint.make_bridger(cell, net, state.policy(), config)


def switch_problems(
    planner: Planner, key: jax.Array, counts: tuple[int, int] = (SWITCH_TASKS, SWITCH_TEST)
) -> tuple[Combined, Combined]:
    """Combined trajectories of training tasks and of unseen ones, stacked."""
    found = (
        combined_phases(planner, [random_task(planner.cell, first + i) for i in range(count)], key)
        for first, count in (
            (BENCHMARK_TRAINING.start, counts[0]), (SWITCHING_TEST.start, counts[1]),
        )
    )
    training_, test = (jax.tree.map(lambda *a: jnp.stack(a), *some) for some in found)
    return training_, test


def optimal_returns(problems: Combined, config: switching.SwitchConfig) -> np.ndarray:
    """Return of the best choices for each of some problems `[problem]`."""
    each = (jax.tree.map(lambda a, i=i: a[i], problems) for i in range(len(problems.available)))
    return np.array([switching.optimal_switching(one, config)[1] for one in each])


def train_switch(
    planner: Planner, key: jax.Array, preset: Preset, counts: tuple[int, int]
) -> tuple[Callable, np.ndarray, np.ndarray]:
    """The switching agent as a `Switcher`; its returns and the rule's over the optimum's on unseen
    tasks."""
    config: switching.SwitchConfig = preset.switch
    problems, test = switch_problems(planner, key, counts)
    net = switching.make_net(planner.cell.home.size, config)
    policy = training.train(
        switching.SwitchWorld(problems, config), net, config.training
    ).policy()
    choose = jax.jit(functools.partial(switching.choose, net, config=config))
    best = optimal_returns(test, config)
    follow = jax.vmap(lambda one: switching.episode_return(one, one.available, config))
    reached = np.asarray(choose(policy, test)[1]) / best
    return switching.make_switcher(net, policy, config), reached, np.asarray(follow(test)) / best


def learn_planner(cell: Workcell, tiny: bool = False) -> Planner:
    """Preset `default`'s planner with a joint agent that is trained on tasks that no test uses."""
    library, preset = read_library(), DEFAULT.planner
    agent, count = (SMOKE, 4) if tiny else (DEFAULT, TRAINING_TASKS)
    # the scale is drawn from random configurations: any grid will do
    scale = float(build_feasibility_map(cell, SMOKE.map).manipulability_scale)
    segments = harvest(
        cell, library, optimal_chooser, preset.skills, preset.first_look, scale, seed=0,
        tasks=BENCHMARK_TRAINING[:count], progress=Progress("collect", "tasks"),
    )  # fmt: skip
    bridge, switch = train_joint_agent(cell, segments, agent), optimal_switcher(DEFAULT.switch)
    return Planner(cell, library, optimal_chooser, bridge, switch, scale, preset)


def learn(cell: Workcell, tiny: bool = False) -> Learned:
    """Train both agents."""
    began, planner = time.perf_counter(), learn_planner(cell, tiny)
    preset, counts = (SMOKE, (2, 2)) if tiny else (DEFAULT, (SWITCH_TASKS, SWITCH_TEST))
    found = train_switch(planner, jax.random.key(0), preset, counts)
    return Learned(planner, *found, time.perf_counter() - began)


def methods(learned: Learned) -> dict[str, Method]:
    """Every method by its name; `hybrid` is the planner as it is used."""
    planner = learned.planner
    alone = replace(planner, config=replace(planner.config, fallback=None))

    def with_(some: Planner, plan=plan_motion) -> Method:
        return lambda task, key: plan(some, task, key=key)

    return {
        "hybrid": with_(planner),
        "hybrid_ppo": with_(replace(planner, switch=learned.ppo_switch)),
        **{
            f"ablation_{name}": with_(ablated(name, planner, DEFAULT, lambda: planner.choose))
            for name in ("rrt", "untrained", "straight", "rule")
        },
        "no_fallback": with_(alone),
        "lfd": with_(lfd_only(planner)),
        "drl": with_(alone, joint_agent_only),
    }


