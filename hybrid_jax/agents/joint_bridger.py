# SPDX-License-Identifier: MIT
"""The trained DRL-Feasibility agent as a bridger: the best of many rollouts, proven free."""

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
from hybrid_jax.contracts import Bridger, Segments, take
from hybrid_jax.envs.segments import refuse_infeasible
from hybrid_jax.kernels.batching import by_backend
from hybrid_jax.kernels.collision.motion_validation import clearances_in_scenes, paths_are_free
from hybrid_jax.runtime.compiler_options import quick_options
from hybrid_jax.runtime.kept_programs import kept
from hybrid_jax.runtime.keys import fold_in
from hybrid_jax.types import Scene, Workcell

SEGMENTS_PER_CALL = 16
"""Most segments that are bridged in one call."""
ROLLOUTS_PER_CALL, ACCELERATOR_ROLLOUTS = (16, 64), (64, 1024)
"""Sizes of calls in rollouts, on a CPU and on an accelerator: few programs serve all attempts."""
RANKED = 32
"""Way points of a rollout at which clearance is measured to rank it."""


def _best_first(
    cell: Workcell, scenes: Scene, q: np.ndarray, reached: np.ndarray, config: JointAgentConfig
) -> tuple[np.ndarray, np.ndarray]:
    """The shortest rollouts of every segment, best first by length and clearance.

    Args:
        cell: robot and fixtures.
        scenes: of the segments, leaves `[segment, ...]`.
        q: `[segment, rollout, point, joint]` way points [rad].
        reached: `[segment, rollout]` which of them arrived.
        config: how many are ranked, and what clearance is worth.

    Returns:
        Paths `[segment, candidate, point, joint]` [rad], and `[segment, candidate]` True for those
        that arrived.
    """
    length = np.where(reached, np.abs(np.diff(q, axis=2)).sum(axis=(2, 3)), np.inf)
    segment = np.arange(len(q))[:, None]
    shortest = np.argsort(length, axis=1, kind="stable")[:, : config.candidates]
    length, paths = length[segment, shortest], q[segment, shortest]
    arrived = np.isfinite(length)
    ranked = [_ranked_points(path) for path in paths[arrived]]
    owner = np.repeat(np.nonzero(arrived)[0], RANKED)
    if not ranked:
        return paths, arrived
    gaps = clearances_in_scenes(cell, scenes, owner, np.concatenate(ranked), config.ample_clearance)
    gap = np.zeros(length.shape)
    gap[arrived] = gaps.reshape(-1, RANKED).min(axis=1)
    order = np.argsort(length - config.clearance_worth * gap, axis=1, kind="stable")
    return paths[segment, order], arrived[segment, order]


def _ranked_points(path: np.ndarray) -> np.ndarray:
    """`[RANKED, joint]` way points spread evenly over a path `[point, joint]` until it rests."""
    moving = np.flatnonzero(np.any(np.diff(path[:-1], axis=0) != 0, axis=-1))
    last = moving[-1] + 1 if moving.size else 0
    return path[np.round(np.linspace(0.0, last, RANKED)).astype(int)]


def _moved(q: np.ndarray) -> np.ndarray:
    """Way points `[point, joint]` without those that repeat their predecessor."""
    changed = np.abs(np.diff(q, axis=0)).max(axis=1) > 1e-6
    return np.concatenate([q[:1], q[1:][changed]])


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


def _program(cell: Workcell, config: JointAgentConfig) -> Callable:
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


def _run_rollouts(
    run: Callable,
    policy: networks.Policy,
    segments: Segments,
    key: Array,
    each: int,
    config: JointAgentConfig,
) -> tuple[np.ndarray, np.ndarray]:
    """`each` rollouts of every segment, in calls of few sizes, by a `_program`.

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


def make_bridger(cell: Workcell, policy: networks.Policy, config: JointAgentConfig) -> Bridger:
    """The trained agent as a function that the planner calls.

    The shortest rollouts are ranked by length and clearance; the first whose every edge is proven
    free is returned.

    Args:
        cell: robot and fixtures.
        policy: the trained agent; agents of one cell and `config` share their programs.
        config: of its training; number of rollouts, ranking and checks.

    Returns:
        A `Bridger`: from segments with `[segment, joint]` ends [rad] and a key to way points
        `[point, joint]` [rad] of each, None where no free path was found.

    Raises:
        SegmentError: the function, if an end of a segment is outside the limits or not free.
    """

    run = _program(cell, config)

    def attempt(segments, key, ways, index, each):
        """Bridge the segments `index` by `each` rollouts, where possible; fills in their `ways`."""
        chosen = take(segments, index)
        q, reached = _run_rollouts(run, policy, chosen, key, each, config)
        ranked, arrived = _best_first(cell, chosen.scene, q, reached, config)
        for rank in range(ranked.shape[1]):
            rows = [r for r in range(len(index)) if ways[index[r]] is None and arrived[r, rank]]
            paths = [_moved(ranked[r, rank]) for r in rows]
            if not rows:
                continue
            scenes = take(segments, index[rows]).scene
            for row, path, free in zip(
                rows, paths, paths_are_free(cell, scenes, paths), strict=True
            ):
                if free:
                    ways[index[row]] = path

    def bridge(segments: Segments, key: Array) -> list[np.ndarray | None]:
        refuse_infeasible(cell, segments, 0.0)
        solutions: list[np.ndarray | None] = [None] * segments.start.shape[0]
        for number, each in enumerate(config.rollouts):
            unsolved = np.array([i for i, path in enumerate(solutions) if path is None], int)
            for first in range(0, len(unsolved), SEGMENTS_PER_CALL):
                key_part = fold_in(fold_in(key, number), first)
                attempt(
                    segments, key_part, solutions, unsolved[first : first + SEGMENTS_PER_CALL], each
                )
        return solutions

    return bridge
