# SPDX-License-Identifier: MIT
"""Trainings of the benchmark: several seeds, and what they report along the way."""

import time
from dataclasses import dataclass, field

import jax
import numpy as np

from hybrid_jax.agents import networks
from hybrid_jax.agents.trainers import Config, Training, make_programs
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


def run(env, net, config: Config, seeds: tuple[int, ...], devices=None) -> Trained:
    """Train the seeds side by side."""
    began = time.perf_counter()
    programs = make_programs(env, net, config, devices)
    state, curve = advance(programs, programs.start(seeds), config.iterations)
    seconds = time.perf_counter() - began
    return Trained([state.policy(i) for i in range(len(seeds))], curve, seconds)


def advance(programs, state: Training, until: int) -> tuple[Training, Curve]:
    """Train up to an iteration."""
    curve, each = Curve(), programs.config.steps_per_iteration
    sums = {}
    for iteration in range(int(state.learner.iteration[0]), until):
        state, metrics = programs.advance(state)
        values, steps = jax.device_get(metrics), (iteration + 1) * each
        refuse_broken(steps, values, state.learner.params)
        _count(sums, values)
        if steps % WINDOW < each or iteration + 1 == until:
            _note(curve, sums, steps)
            sums = {}
    return state, curve


def _count(sums: dict, values: dict) -> None:
    """Add an iteration: episodes that ended, what they gained, and how many ended well."""
    ended = values["episodes"]
    rows = {
        "gained": values["return"] * ended,
        "episodes": ended,
        "success": values["success"] * ended,
    }
    for name, row in rows.items():
        sums[name] = sums.get(name, 0.0) + row


def _note(curve: Curve, sums: dict, steps: int) -> None:
    ended = np.where(sums["episodes"] > 0, sums["episodes"], np.nan)
    curve.steps.append(steps)
    curve.total_reward.append(sums["gained"] / ended)
    curve.success.append(sums["success"] / ended)
