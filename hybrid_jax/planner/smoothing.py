# SPDX-License-Identifier: MIT
"""Make joint paths shorter and smoother, and leave alone what was demonstrated."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from hybrid_jax.kernels.edges import Measure, measure_here, split_counts
from hybrid_jax.types import Workcell

MarkedPath = tuple[np.ndarray, np.ndarray]
"""A joint path `[point, joint]` and the source of each of its points `[point]`."""

LEAST_GAIN = 1e-3
"""Way that a shortcut must save [rad]."""
FEW = 4
"""One point of so many of an edge is looked at before the others."""


@dataclass(frozen=True)
class SmoothingConfig:
    """How smooth."""

    spacing: float = 0.05
    """Distance of way points before smoothing [rad]."""
    widths: tuple[float, ...] = (8.0, 4.0, 2.0, 1.0, 0.0)
    """Widths of the smoothing filter, tried in turn, in way points."""
    kept: float = 0.7
    """Width of the filter on what was demonstrated: its corners alone are rounded."""
    blend: float = 3.0
    """Way points over which the two widths blend."""
    margin: float = 0.002
    """Clearance that a smoothed path keeps [m], ..."""
    beside: int = 12
    """... but for so many half steps beside an end that has less."""
    shortcuts: int = 16
    """Pairs of points drawn in each of `shortcut_rounds`; ..."""
    shortcut_rounds: int = 2
    checked: int = 8
    """... the edges of so many of them, which would save most, are checked ..."""
    fine: int = 32
    """... at so many points."""


def refine(q: np.ndarray, spacing: float) -> np.ndarray:
    """Places `[n]`, in points of a polyline, no two of them further apart than `spacing` [rad]."""
    size = np.abs(np.diff(q, axis=0)).max(axis=1)
    counts = np.maximum(1, np.ceil(size / spacing).astype(int))
    edge, number = split_counts(counts)
    return np.append(edge + number / counts[edge], len(q) - 1.0)


def at_places(q: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Points of a polyline `[point, column]` at places `[n]`."""
    q, low = np.asarray(q, float), np.clip(places.astype(int), 0, max(0, len(q) - 2))
    share = (places - low)[:, None]
    return q[low] + share * (q[np.minimum(low + 1, len(q) - 1)] - q[low])


def densify(q: np.ndarray, spacing: float) -> np.ndarray:
    """Points along a polyline, no two neighbours further apart than `spacing` [rad]."""
    return at_places(q, refine(q, spacing))


def _promising(q: np.ndarray, rng, config: SmoothingConfig) -> np.ndarray:
    """Pairs of points `[pair, 2]` between which an edge would be shorter, what saves most first."""
    pairs = np.sort(rng.integers(0, len(q), (config.shortcuts, 2)), axis=1)
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(q, axis=0), axis=1))])
    starts, ends = pairs.T
    gain = length[ends] - length[starts] - np.linalg.norm(q[ends] - q[starts], axis=1)
    best = np.argsort(-gain, kind="stable")[: config.checked]
    return pairs[best[gain[best] > LEAST_GAIN]]


def _first_free(
    measure: Measure, owner: np.ndarray, edges: np.ndarray, margin: float, fine: int
) -> np.ndarray:
    """Numbers of the first edge of each path that keeps a margin at `fine` points, where one does.

    Most of the edges that would save much are blocked, and few points show it.

    Args:
        measure: clearances on the paths.
        owner: `[edge]` the path that each belongs to.
        edges: `[edge, 2, joint]` those of a path in their order.
        margin: to be kept [m].
        fine: points of an edge.
    """

    def keeps(some: np.ndarray, share: np.ndarray) -> np.ndarray:
        starts, ends = edges[some, :1], edges[some, 1:]
        points = (starts + share[:, None] * (ends - starts)).reshape(-1, edges.shape[2])
        gaps = measure(np.repeat(owner[some], len(share)), points, margin)
        return (gaps.reshape(len(some), len(share)) >= np.float32(margin)).all(axis=1)

    share = np.arange(1, fine + 1) / fine
    few = np.arange(fine) % FEW == FEW - 1
    left = np.flatnonzero(keeps(np.arange(len(edges)), share[few]))
    found = []
    while len(left):
        firsts = left[np.unique(owner[left], return_index=True)[1]]
        good = keeps(firsts, share[~few])
        found.append(firsts[good])
        left = left[~np.isin(left, firsts) & ~np.isin(owner[left], owner[firsts[good]])]
    return np.concatenate(found) if found else np.zeros(0, int)


def shortcut_paths(
    measure: Measure, paths: list[np.ndarray], margin: float, config: SmoothingConfig, seed: int = 0
) -> list[np.ndarray]:
    """Replace detours of polylines by straight edges that keep the margin, all of them together.

    Args:
        measure: clearances on them.
        paths: `[point, joint]` each.
        margin: at the points of the edges [m].
        config: how many edges are tried, how finely.
        seed: of the draws, the same for each path.
    """
    rngs = [np.random.default_rng(seed) for _ in paths]
    paths = [densify(q, config.spacing) for q in paths]
    for _ in range(config.shortcut_rounds):
        pairs = [_promising(q, rng, config) for q, rng in zip(paths, rngs, strict=True)]
        counts = np.array([len(some) for some in pairs], int)
        if not counts.any():
            continue
        owner = np.repeat(np.arange(len(paths)), counts)
        edges = np.concatenate([q[some] for q, some in zip(paths, pairs, strict=True)])
        pairs = np.concatenate(pairs)
        for edge in _first_free(measure, owner, edges, margin, config.fine):
            q, (a, b) = paths[owner[edge]], pairs[edge]
            paths[owner[edge]] = densify(np.concatenate([q[: a + 1], q[b:]]), config.spacing)
    return paths


def shortcut(
    cell: Workcell, q: np.ndarray, margin: float, config: SmoothingConfig
) -> np.ndarray:
    """`shortcut_paths` of one path, in the scene of the cell."""
    return shortcut_paths(measure_here(cell), [q], margin, config)[0]


def _filtered(q: np.ndarray, width: float) -> np.ndarray:
    """A path with rounded corners; its ends stay where they are."""
    if not width:
        return q
    # what is filtered is the deviation from the straight line between the ends
    line = q[0] + np.linspace(0, 1, len(q))[:, None] * (q[-1] - q[0])
    bent = np.concatenate([-(q - line)[::-1], q - line, -(q - line)[::-1]])
    return line + gaussian_filter1d(bent, width, axis=0)[len(q) : 2 * len(q)]


def _required(gap: np.ndarray, config: SmoothingConfig) -> np.ndarray:
    """Clearance to keep at each point `[point]`: beside an end that has less, what it has [m]."""
    # clearances end at the margin as float32: it may be less than the margin itself
    most, point = np.float32(config.margin), np.arange(len(gap))
    margin = np.full(len(gap), most, np.float32)
    for end, away in ((gap[0], point), (gap[-1], point[::-1])):
        margin[away < config.beside] = min(most, 0.9 * max(end, 0.0))
    return margin


def _resampled(q: np.ndarray, sources: np.ndarray, config: SmoothingConfig) -> MarkedPath:
    """The path in small, even steps.

    The way between a point of the skill and one of another source is the other's: a bridge begins
    and ends on the skill.
    """
    moved = np.concatenate([[True], np.abs(np.diff(q, axis=0)).max(axis=1) > 1e-5])
    moved[-1] = True
    q, sources = q[moved], sources[moved]
    steps = np.abs(np.diff(q, axis=0)).max(axis=1)
    # a way of a hair's breadth has some steps too: a spline needs them
    places = refine(q, min(config.spacing, max(1e-4, steps.max() / 4), max(steps.sum() / 4, 1e-9)))
    before = np.minimum(places.astype(int), len(q) - 2)
    return at_places(q, places), np.maximum(sources[before], sources[before + 1])


def _rounded(q: np.ndarray, sources: np.ndarray, width: float, config: SmoothingConfig):
    """The path with its corners rounded: widely, but narrowly what was demonstrated."""
    free = gaussian_filter1d((sources > 0).astype(float), config.blend)
    free = np.clip(2 * free, 0, 1)[:, None]
    kept = _filtered(q, min(width, config.kept))
    path = kept + free * (_filtered(q, width) - kept)
    path[0], path[-1] = q[0], q[-1]
    return path


def smooth_paths(
    measure: Measure, paths: list[MarkedPath], config: SmoothingConfig
) -> list[MarkedPath | None]:
    """Round the corners of paths as far as the margin allows, all of them together.

    Args:
        measure: clearances on them.
        paths: with source 0 for what was demonstrated: there, the filter is narrow.
        config: widths and margin.

    Returns:
        Each path in small steps and the source of each point; None if no width keeps the margin.
        The ends stay exactly where they are.
    """
    dense = [_resampled(q, sources, config) for q, sources in paths]
    found: list[MarkedPath | None] = [None] * len(paths)
    going = list(range(len(paths)))
    for width in config.widths:
        if not going:
            break
        tried = [_rounded(*dense[i], width, config) for i in going]
        points = [densify(q, config.spacing / 2) for q in tried]
        sizes = [len(q) for q in points]
        gaps = measure(np.repeat(going, sizes), np.concatenate(points), config.margin)
        for i, q, gap in zip(going, tried, np.split(gaps, np.cumsum(sizes)[:-1]), strict=True):
            if (gap >= _required(gap, config)).all():
                found[i] = q, dense[i][1]
        going = [i for i in going if found[i] is None]
    return found


def smooth(
    cell: Workcell, q: np.ndarray, sources: np.ndarray, config: SmoothingConfig
) -> MarkedPath | None:
    """`smooth_paths` of one path, in the scene of the cell."""
    return smooth_paths(measure_here(cell), [(q, sources)], config)[0]
