# SPDX-License-Identifier: MIT
"""Rollouts of the trained joint agent at planning time, in calls of few sizes.

A bridger proves some of them (`joint_bridger`); an explorer returns them all as they are.
"""

import functools
from collections.abc import Callable
from dataclasses import replace

import jax
import numpy as np
from jax import Array

from hybrid_jax.agents import networks
from hybrid_jax.agents.joint import (
    JointAgentConfig,
    make_net,
    planning_env,
    rollouts,
    spreads,
    uses_mjx,
)
from hybrid_jax.contracts import Explorer, Segments, take
from hybrid_jax.kernels.batching import by_backend
from hybrid_jax.runtime.compiler_options import quick_options
from hybrid_jax.runtime.kept_programs import kept
from hybrid_jax.runtime.keys import fold_in
from hybrid_jax.types import Workcell

SEGMENTS_PER_CALL = 16
"""Most segments that are bridged in one call."""
ROLLOUTS_PER_CALL, ACCELERATOR_ROLLOUTS = (16, 64), (64, 1024)
"""Sizes of calls in rollouts, on a CPU and on an accelerator: few programs serve all attempts."""


def _rollouts(
    cell: Workcell,
    policy: networks.Policy,
    segments: Segments,
    index: Array,
    spread: Array,
    enough: Array,
    key: Array,
    config: JointAgentConfig,
) -> tuple[Array, Array]:
    env, net = planning_env(cell, segments, config), make_net(cell, config)
    return rollouts(env, net, policy, index, spread, key, enough)


_kept_rollouts = kept(static=("config",), hot=True)(_rollouts)


def rollout_program(cell: Workcell, config: JointAgentConfig) -> Callable:
    """`_rollouts` in a cell: kept on disk, but for MJX, whose models are made of its host side."""
    config = replace(config, rollouts=(), candidates=1)
    if not uses_mjx(config):
        return functools.partial(_kept_rollouts, cell, config=config)
    rollouts = functools.partial(_rollouts, cell, config=config)
    return jax.jit(rollouts, compiler_options=quick_options())


def _call_size(rollouts_wanted: int) -> int:
    """Rollouts of the smallest call that suffices, or of the largest call."""
    sizes = by_backend(ROLLOUTS_PER_CALL, ACCELERATOR_ROLLOUTS)
    return next((size for size in sizes if size >= rollouts_wanted), sizes[-1])


def run_rollouts(
    run: Callable,
    policy: networks.Policy,
    segments: Segments,
    key: Array,
    each: int,
    config: JointAgentConfig,
) -> tuple[np.ndarray, np.ndarray]:
    """`each` rollouts of every segment, in calls of few sizes, by a `rollout_program`.

    Returns:
        Way points `[segment, rollout, point, joint]` [rad], and `[segment, rollout]` True where the
        goal was reached.
    """
    count = len(segments.start)
    size = max(_call_size(each * count), each)
    per_call = min(size // each, SEGMENTS_PER_CALL)
    parts = []
    for call, first in enumerate(range(0, count, per_call)):
        used = min(per_call, count - first)
        # a segment more than may be used: what is left of the call runs on it, and it never counts
        rows = np.append(np.minimum(first + np.arange(SEGMENTS_PER_CALL), count - 1), first)
        index = np.full(size, SEGMENTS_PER_CALL, np.int32)
        index[: used * each] = np.repeat(np.arange(used), each)
        spread = np.resize(spreads(each), size)
        enough = np.zeros(SEGMENTS_PER_CALL + 1, np.int32)
        enough[:used] = max(1, int(config.enough * each))
        q, reached = jax.device_get(
            run(
                policy,
                take(segments, rows),
                index,
                spread,
                enough,
                fold_in(key, call),
            )
        )
        q = np.moveaxis(q[:, : used * each].reshape(len(q), used, each, -1), 0, 2)
        parts.append((q, reached[: used * each].reshape(used, each)))
    ways, arrived = (np.concatenate(part) for part in zip(*parts, strict=True))
    return ways, arrived


def make_explorer(cell: Workcell, policy: networks.Policy, config: JointAgentConfig) -> Explorer:
    """The trained agent as a function that explores from the start of segments.

    Args:
        cell: robot and fixtures.
        policy: the trained agent; agents of one cell and `config` share their programs.
        config: of its training; the last of `rollouts` is the number of a segment's rollouts.

    Returns:
        An `Explorer`: rollouts from the policy's mode to the boldest one, none of them proven.
    """
    # whether a rollout ends in the target area is for the planner to say: all of them go on
    run, each = rollout_program(cell, replace(config, enough=1.0)), config.rollouts[-1]

    def explore(segments: Segments, key: Array) -> np.ndarray:
        ways, _ = run_rollouts(run, policy, segments, key, each, replace(config, enough=1.0))
        # the last way point is the goal itself, wherever the rollout ended
        return ways[:, :, :-1]

    return explore
