# SPDX-License-Identifier: MIT
"""Trainings of the benchmark: several seeds, what they report, and policies along the way."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import jax
import numpy as np

from hybrid_jax.agents import networks
from hybrid_jax.agents.programs import Config, Training, make_programs
from hybrid_jax.agents.training import refuse_broken

WINDOW = 40_960
"""Steps over which a curve's points are taken together."""


@dataclass
class Curve:
    """What a training reported, per seed, in windows of steps."""

    steps: list[int] = field(default_factory=list)
    total_reward: list[np.ndarray] = field(default_factory=list)
    """Of an episode, `[seed]`; not a number where none ended."""
    success: list[np.ndarray] = field(default_factory=list)
    """Share of the episodes that ended well."""


@dataclass
class Trained:
    """Several seeds of one training."""

    policies: list[networks.Policy]
    curve: Curve
    seconds: float
    """Of all seeds together, compiling included."""


def run(world, net, config: Config, seeds: tuple[int, ...], devices=None) -> Trained:
    """Train the seeds side by side."""
    began = time.perf_counter()
    programs = make_programs(world, net, config, devices)
    state, curve = advance(programs, programs.start(seeds), config.iterations)
    seconds = time.perf_counter() - began
    return Trained([state.policy(i) for i in range(len(seeds))], curve, seconds)


def advance(
    programs, state: Training, until: int, watch: Callable[[int, Training], None] | None = None
) -> tuple[Training, Curve]:
    """Train up to an iteration.

    Args:
        programs: of the training.
        state: where it stands.
        until: iteration to stop before.
        watch: called with steps done and the state after each iteration.
    """
    curve, each = Curve(), programs.config.steps_per_iteration
    sums = {}
    for iteration in range(int(state.learner.iteration[0]), until):
        state, metrics = programs.advance(state)
        values, steps = jax.device_get(metrics), (iteration + 1) * each
        refuse_broken(steps, values, state.learner.params)
        _count(sums, values, each)
        if steps % WINDOW < each or iteration + 1 == until:
            _note(curve, sums, steps)
            sums = {}
        if watch:
            watch(steps, state)
    return state, curve


def _count(sums: dict, values: dict, steps: int) -> None:
    """Add an iteration: sums over it of rewards, ended episodes and successes."""
    rows = {
        "reward": steps * values["reward"],
        "episodes": values["episodes"],
        "success": values["success"] * np.maximum(values["episodes"], 1.0),
    }
    for name, row in rows.items():
        sums[name] = sums.get(name, 0.0) + row


def _note(curve: Curve, sums: dict, steps: int) -> None:
    ended = np.where(sums["episodes"] > 0, sums["episodes"], np.nan)
    curve.steps.append(steps)
    curve.total_reward.append(sums["reward"] / ended)
    curve.success.append(sums["success"] / ended)
