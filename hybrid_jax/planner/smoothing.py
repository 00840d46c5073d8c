# SPDX-License-Identifier: MIT
"""Shortcuts and smoothing of joint paths; what was demonstrated keeps its shape."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from hybrid_jax.kernels.collision.motion_validation import (
    Measure,
    measure_here,
    split_counts,
)
from hybrid_jax.types import Workcell

MarkedPath = tuple[np.ndarray, np.ndarray]
"""A joint path `[point, joint]` [rad or m] and the `Source` of each of its points `[point]`."""

LEAST_GAIN = 1e-3
"""Smallest length that a shortcut must save [rad]."""
FEW = 4
"""Every `FEW`-th point of an edge is checked before the others."""


@dataclass(frozen=True)
class SmoothingConfig:
    """Settings of shortcuts and smoothing."""

    spacing: float = 0.05
    """Distance of way points before smoothing [rad]."""
    widths: tuple[float, ...] = (8.0, 4.0, 2.0, 1.0, 0.0)
    """Widths of the smoothing filter, tried in turn, in way points."""
    kept: float = 0.7
    """Width of the filter on what was demonstrated, in way points: only its corners are rounded."""
    blend: float = 3.0
    """Width over which the two filters blend, in way points."""
    margin: float = 0.002
    """Clearance that a smoothed path keeps [m]."""
    beside: int = 12
    """Number of half steps beside an end with less clearance, where less is asked for."""
    shortcuts: int = 16
    """Number of pairs of points that are drawn in each round of shortcuts."""
    shortcut_rounds: int = 2
    """Number of rounds of shortcuts."""
    checked: int = 8
    """Number of pairs whose edges are checked: those that would save most."""
    fine: int = 32
    """Number of points at which an edge is checked."""


def refine(q: np.ndarray, spacing: float) -> np.ndarray:
    """Places along a polyline, so dense that no joint moves by more than `spacing` between two.

    Args:
        q: `[point, joint]` way points [rad or m].
        spacing: largest change of a joint between neighbouring places [rad or m].

    Returns:
        `[n]` places, in points of the polyline: 1.5 is half-way between points 1 and 2.
    """
    size = np.abs(np.diff(q, axis=0)).max(axis=1)
    counts = np.maximum(1, np.ceil(size / spacing).astype(int))
    edge, number = split_counts(counts)
    return np.append(edge + number / counts[edge], len(q) - 1.0)


def at_places(q: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Points of a polyline at places between its points.

    Args:
        q: `[point, column]` points of the polyline.
        places: `[n]` places, in points of the polyline (see `refine`).

    Returns:
        `[n, column]` points, interpolated linearly.
    """
    q, low = np.asarray(q, float), np.clip(places.astype(int), 0, max(0, len(q) - 2))
    share = (places - low)[:, None]
    return q[low] + share * (q[np.minimum(low + 1, len(q) - 1)] - q[low])


def densify(q: np.ndarray, spacing: float) -> np.ndarray:
    """The same polyline `[point, joint]` with more points, as `refine` places them."""
    return at_places(q, refine(q, spacing))


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


def _filtered(q: np.ndarray, width: float) -> np.ndarray:
    """A path `[point, joint]` with rounded corners; its ends hardly move."""
    if not width:
        return q
    # what is filtered is the deviation from the straight line between the ends; beyond them it is
    # mirrored with the opposite sign, so that the filter hardly moves the ends
    line = q[0] + np.linspace(0, 1, len(q))[:, None] * (q[-1] - q[0])
    bent = np.concatenate([-(q - line)[::-1], q - line, -(q - line)[::-1]])
    return line + gaussian_filter1d(bent, width, axis=0)[len(q) : 2 * len(q)]


def _required(gap: np.ndarray, config: SmoothingConfig) -> np.ndarray:
    """Clearance to keep at each point `[point]` [m]; less beside an end that has less itself."""
    # clearances end at the margin as float32: it may be less than the margin itself
    most, point = np.float32(config.margin), np.arange(len(gap))
    margin = np.full(len(gap), most, np.float32)
    for end_gap, distance in ((gap[0], point), (gap[-1], point[::-1])):
        margin[distance < config.beside] = min(most, 0.9 * max(end_gap, 0.0))
    return margin


def _resampled(q: np.ndarray, sources: np.ndarray, config: SmoothingConfig) -> MarkedPath:
    """The path in small, even steps, and the source of each point.

    A bridge begins and ends on the skill, so the edge between a point of the skill and one of
    another source belongs to the other source.
    """
    distinct = np.concatenate([[True], np.abs(np.diff(q, axis=0)).max(axis=1) > 1e-5])
    distinct[-1] = True
    q, sources = q[distinct], sources[distinct]
    steps = np.abs(np.diff(q, axis=0)).max(axis=1)
    # a very short path is divided too: a spline needs several points
    places = refine(q, min(config.spacing, max(1e-4, steps.max() / 4), max(steps.sum() / 4, 1e-9)))
    segment = np.minimum(places.astype(int), len(q) - 2)
    return at_places(q, places), np.maximum(sources[segment], sources[segment + 1])


def _rounded(q: np.ndarray, sources: np.ndarray, width: float, config: SmoothingConfig):
    """The path `[point, joint]` with rounded corners: narrowly where it was demonstrated."""
    weight = gaussian_filter1d((sources > 0).astype(float), config.blend)
    weight = np.clip(2 * weight, 0, 1)[:, None]
    narrow = _filtered(q, min(width, config.kept))
    path = narrow + weight * (_filtered(q, width) - narrow)
    path[0], path[-1] = q[0], q[-1]
    return path


def smooth_paths(
    measure: Measure, paths: list[MarkedPath], config: SmoothingConfig
) -> list[MarkedPath | None]:
    """Round the corners of paths as far as the margin allows, all paths together.

    Args:
        measure: clearances on the paths.
        paths: way points `[point, joint]` [rad or m] and sources `[point]` of each. Source 0 is
            what was demonstrated: there the filter is narrow.
        config: widths and margin.

    Returns:
        Each path in small steps, `[point, joint]`, and its sources `[point]`; None if no width
        keeps the margin. The ends stay exactly where they are.
    """
    dense = [_resampled(q, sources, config) for q, sources in paths]
    smoothed: list[MarkedPath | None] = [None] * len(paths)
    pending = list(range(len(paths)))
    for width in config.widths:
        if not pending:
            break
        trials = [_rounded(*dense[i], width, config) for i in pending]
        points = [densify(q, config.spacing / 2) for q in trials]
        sizes = [len(q) for q in points]
        gaps = measure(np.repeat(pending, sizes), np.concatenate(points), config.margin)
        for i, q, gap in zip(pending, trials, np.split(gaps, np.cumsum(sizes)[:-1]), strict=True):
            if (gap >= _required(gap, config)).all():
                smoothed[i] = q, dense[i][1]
        pending = [i for i in pending if smoothed[i] is None]
    return smoothed


def smooth(
    cell: Workcell, q: np.ndarray, sources: np.ndarray, config: SmoothingConfig
) -> MarkedPath | None:
    """Smooth one path in the scene of the cell, see `smooth_paths`.

    Args:
        cell: robot and scene.
        q: `[point, joint]` way points [rad or m].
        sources: `[point]` `Source` of each point.
        config: widths and margin.

    Returns:
        The path `[point, joint]` and its sources `[point]`; None if no width keeps the margin.
    """
    return smooth_paths(measure_here(cell), [(q, sources)], config)[0]
