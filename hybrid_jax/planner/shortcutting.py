# SPDX-License-Identifier: MIT
"""Shortcuts: detours of joint paths replaced by straight edges."""

import numpy as np

from hybrid_jax.kernels.collision.motion_validation import Measure, measure_here
from hybrid_jax.planner.smoothing import SmoothingConfig, densify
from hybrid_jax.types import Workcell

LEAST_GAIN = 1e-3
"""Smallest length that a shortcut must save [rad]."""
FEW = 4
"""Every `FEW`-th point of an edge is checked before the others."""


def _promising(q: np.ndarray, rng, config: SmoothingConfig) -> np.ndarray:
    """Pairs of points `[pair, 2]` of a path that an edge would join by a shorter way.

    Those that save most stand first.
    """
    pairs = np.sort(rng.integers(0, len(q), (config.shortcuts, 2)), axis=1)
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(q, axis=0), axis=1))])
    starts, ends = pairs.T
    gain = length[ends] - length[starts] - np.linalg.norm(q[ends] - q[starts], axis=1)
    best = np.argsort(-gain, kind="stable")[: config.checked]
    return pairs[best[gain[best] > LEAST_GAIN]]


def _first_free(
    measure: Measure, owner: np.ndarray, edges: np.ndarray, margin: float, fine: int
) -> np.ndarray:
    """Numbers of the edges that are the first of their path to keep a margin at all points.

    Most of the edges that would save much are blocked, and few points show it.

    Args:
        measure: clearances on the paths.
        owner: `[edge]` path of each edge, in ascending order.
        edges: `[edge, 2, joint]` both ends of each edge, the best of a path first.
        margin: clearance to keep [m].
        fine: number of points at which an edge is checked.

    Returns:
        `[n]` at most one edge of each path.
    """

    def keeps(some: np.ndarray, share: np.ndarray) -> np.ndarray:
        starts, ends = edges[some, :1], edges[some, 1:]
        points = (starts + share[:, None] * (ends - starts)).reshape(-1, edges.shape[2])
        gaps = measure(np.repeat(owner[some], len(share)), points, margin)
        # clearances are cut off at the margin in single precision: compare with the same number
        return np.all(gaps.reshape(len(some), len(share)) >= np.float32(margin), axis=1)

    share = np.arange(1, fine + 1) / fine
    coarse = np.arange(fine) % FEW == FEW - 1
    remaining = np.flatnonzero(keeps(np.arange(len(edges)), share[coarse]))
    accepted = []
    while len(remaining):
        # as owners ascend, `np.unique` gives the best remaining edge of each path
        firsts = remaining[np.unique(owner[remaining], return_index=True)[1]]
        is_free = keeps(firsts, share[~coarse])
        accepted.append(firsts[is_free])
        remaining = remaining[
            ~np.isin(remaining, firsts) & ~np.isin(owner[remaining], owner[firsts[is_free]])
        ]
    return np.concatenate(accepted) if accepted else np.zeros(0, int)


def shortcut_paths(
    measure: Measure, paths: list[np.ndarray], margin: float, config: SmoothingConfig, seed: int = 0
) -> list[np.ndarray]:
    """Replace detours of polylines by straight edges that keep a margin, all paths together.

    Args:
        measure: clearances on the paths.
        paths: way points `[point, joint]` of each [rad or m].
        margin: clearance at the points of the edges [m].
        config: number of edges that are tried, and of points at which they are checked.
        seed: of the random pairs, the same for each path.

    Returns:
        `[point, joint]` of each path, with the same ends, in steps of `config.spacing` at most.
    """
    # a generator for each path: what is drawn for it does not depend on the other paths
    rngs = [np.random.default_rng(seed) for _ in paths]
    paths = [densify(q, config.spacing) for q in paths]
    for _ in range(config.shortcut_rounds):
        pairs = [_promising(q, rng, config) for q, rng in zip(paths, rngs, strict=True)]
        counts = np.array([len(path_pairs) for path_pairs in pairs], int)
        if not counts.any():
            continue
        owner = np.repeat(np.arange(len(paths)), counts)
        edges = np.concatenate([q[path_pairs] for q, path_pairs in zip(paths, pairs, strict=True)])
        pairs = np.concatenate(pairs)
        for edge in _first_free(measure, owner, edges, margin, config.fine):
            q, (a, b) = paths[owner[edge]], pairs[edge]
            paths[owner[edge]] = densify(np.concatenate([q[: a + 1], q[b:]]), config.spacing)
    return paths


def shortcut(cell: Workcell, q: np.ndarray, margin: float, config: SmoothingConfig) -> np.ndarray:
    """Shorten one path in the scene of the cell, see `shortcut_paths`.

    Args:
        cell: robot and scene.
        q: `[point, joint]` way points [rad or m].
        margin: clearance at the points of new edges [m].
        config: number of edges that are tried, and of points at which they are checked.

    Returns:
        `[point, joint]` way points of the shorter path, with the same ends.
    """
    return shortcut_paths(measure_here(cell), [q], margin, config)[0]
