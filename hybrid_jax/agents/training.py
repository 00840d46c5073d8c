# SPDX-License-Identifier: MIT
"""The host's side of a training: loop, reports, and an error where a number is not finite."""

import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from hybrid_jax.agents.networks import ActorCritic
from hybrid_jax.agents.trainers import Config, Training, make_programs
from hybrid_jax.envs import base
from hybrid_jax.errors import TrainingError

Report = Callable[[int, Training, dict[str, np.ndarray]], None]
"""Called after each update with steps done, the training and its metrics `[seed]`."""


@jax.jit
def _finite(tree: Any) -> jax.Array:
    """Are all numbers of a pytree finite?"""
    return jnp.all(jnp.stack([jnp.all(jnp.isfinite(a)) for a in jax.tree.leaves(tree)]))


def refuse_broken(steps: int, metrics: dict[str, np.ndarray], params: Any) -> None:
    """Raise if a reported number or a parameter is not finite.

    Args:
        steps: environment steps done.
        metrics: arrays `[...]` by name.
        params: pytree of arrays.

    Raises:
        TrainingError: names the step and what broke.
    """
    non_finite = [k for k, v in metrics.items() if not np.isfinite(v).all()]
    if not jax.device_get(_finite(params)):
        # the last gradient step of an update shows in its parameters only
        non_finite.append("parameters")
    if non_finite:
        raise TrainingError(f"training broke at step {steps}: {', '.join(non_finite)} not finite")


def train(
    env: base.Env,
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
        env: environment to learn in.
        net: from `networks.make_networks` or `sac.make_networks`.
        config: settings; their type selects PPO or SAC.
        seeds: one training each, side by side; `config.seed` alone if None.
        state: where an earlier training stopped; fresh if None.
        report: called after each update (metrics contain `rate`, steps/s of each seed).
        devices: to use; see `trainers.pick_devices` if None.

    Returns:
        The state at the end; the leading axis of its arrays runs over seeds.

    Raises:
        TrainingError: a number is not finite; the message names it and the step.
    """
    programs = make_programs(env, net, config, devices)
    state = programs.start(seeds or (config.seed,)) if state is None else programs.place(state)
    for iteration in range(int(state.learner.iteration[0]), config.iterations):
        start_time = time.perf_counter()
        state, metrics = programs.advance(state)
        # also waits for the device, so that the rate below is not that of the dispatch alone
        values = jax.device_get(metrics)
        steps = (iteration + 1) * config.steps_per_iteration
        refuse_broken(steps, values, state.learner.params)
        if report:
            rate = config.steps_per_iteration / (time.perf_counter() - start_time)
            report(steps, state, values | {"rate": np.full_like(values["reward"], rate)})
    return state
