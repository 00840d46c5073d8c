# SPDX-License-Identifier: MIT
"""The trained DRL-Feasibility agent as a bridger: the best of many rollouts, proven free."""

import numpy as np
from jax import Array

from hybrid_jax.agents import networks
from hybrid_jax.agents.joint import JointAgentConfig
from hybrid_jax.agents.joint_rollouts import SEGMENTS_PER_CALL, rollout_program, run_rollouts
from hybrid_jax.contracts import Bridger, Segments, take
from hybrid_jax.envs.segments import refuse_infeasible
from hybrid_jax.kernels.collision.motion_validation import clearances_in_scenes, paths_are_free
from hybrid_jax.runtime.keys import fold_in
from hybrid_jax.types import Scene, Workcell

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

    run = rollout_program(cell, config)

    def attempt(segments, key, ways, index, each):
        """Bridge the segments `index` by `each` rollouts, where possible; fills in their `ways`."""
        chosen = take(segments, index)
        q, reached = run_rollouts(run, policy, chosen, key, each, config)
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
