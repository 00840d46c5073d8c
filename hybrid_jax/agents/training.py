# SPDX-License-Identifier: MIT
"""The host's side of a training: loop, report, stop where something breaks."""

import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from hybrid_jax.agents import worlds
from hybrid_jax.agents.networks import ActorCritic
from hybrid_jax.agents.programs import Config, Training, make_programs
from hybrid_jax.errors import TrainingError

Report = Callable[[int, Training, dict[str, np.ndarray]], None]
"""Called after each update with steps done, the training and its metrics `[seed]`."""


@jax.jit
def _finite(tree: Any) -> jax.Array:
    """Are all numbers of a pytree finite?"""
    return jnp.all(jnp.stack([jnp.all(jnp.isfinite(a)) for a in jax.tree.leaves(tree)]))


def refuse_broken(steps: int, metrics: dict[str, np.ndarray], params: Any) -> None:
    """Raise if a reported number or a parameter is not finite.

    Raises:
        TrainingError: names the step and what broke.
    """
    broken = [k for k, v in metrics.items() if not np.isfinite(v).all()]
    if not jax.device_get(_finite(params)):
        # the last gradient step of an update shows in its parameters only
        broken.append("parameters")
    if broken:
        raise TrainingError(f"training broke at step {steps}: {', '.join(broken)} not finite")


def train(
    world: worlds.World,
    net: ActorCritic,
    config: Config,
    *,
    seeds: tuple[int, ...] | None = None,
    state: Training | None = None,
    report: Report | None = None,
    devices=None,
) -> Training:
    """Train until `config.steps`.

    Args:
        world: what to learn in.
        net: from `networks.make_networks` or `sac.make_networks`.
        config: settings; their type says whether PPO or SAC trains.
        seeds: one training each, side by side; `config.seed` alone if None.
        state: where an earlier training stopped; fresh if None.
        report: called after each update (metrics contain `rate`, steps/s of each seed).
        devices: to use; as many as it pays to if None.

    Raises:
        TrainingError: a number is not finite; the message names it and the step.
    """
    programs = make_programs(world, net, config, devices)
    state = programs.start(seeds or (config.seed,)) if state is None else programs.place(state)
    for iteration in range(int(state.learner.iteration[0]), config.iterations):
        began = time.perf_counter()
        state, metrics = programs.advance(state)
        values = jax.device_get(metrics)
        steps = (iteration + 1) * config.steps_per_iteration
        refuse_broken(steps, values, state.learner.params)
        if report:
            rate = config.steps_per_iteration / (time.perf_counter() - began)
            report(steps, state, values | {"rate": np.full_like(values["reward"], rate)})
    return state
