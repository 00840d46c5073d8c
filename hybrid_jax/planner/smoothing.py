# SPDX-License-Identifier: MIT
"""Smoothing of joint paths; what was demonstrated keeps its shape."""

from collections.abc import Sequence
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

SLIGHT = 2e-3
"""Distance of a rounded path from a way point that is left as it is [rad or m]."""


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


def _led_through(path: np.ndarray, q: np.ndarray, places: np.ndarray, width: float) -> np.ndarray:
    """A rounded path moved so that it meets `q` at some places, smoothly around each of them.

    A move ends at the places beside, and at the ends of the path.
    """
    path, number = path.copy(), np.arange(len(q))
    stops = np.unique([0, *places, len(q) - 1])
    for before, place, after in zip(stops, stops[1:], stops[2:], strict=False):
        offset = q[place] - path[place]
        if np.abs(offset).max() > SLIGHT:
            room = np.where(number < place, place - before, after - place)
            away = np.abs(number - place) / np.minimum(room, 3 * (1 + width))
            weight = np.where(away < 1, np.cos(np.pi / 2 * away) ** 2, 0.0)
            path += weight[:, None] * offset
    return path


def _places_of(points: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Places of points `[n, joint]` on a path `[point, joint]`; those beside it are left out."""
    apart = np.abs(points[:, None] - q).max(axis=2)
    return apart.argmin(axis=1)[apart.min(axis=1) < SLIGHT]


def smooth_paths(
    measure: Measure,
    paths: list[MarkedPath],
    config: SmoothingConfig,
    through: Sequence[np.ndarray] = (),
) -> list[MarkedPath | None]:
    """Round the corners of paths as far as the margin allows, all paths together.

    Args:
        measure: clearances on the paths.
        paths: way points `[point, joint]` [rad or m] and sources `[point]` of each. Source 0 is
            what was demonstrated: there the filter is narrow.
        config: widths and margin.
        through: `[n, joint]` way points of each path that it must still meet; none if empty.

    Returns:
        Each path in small steps, `[point, joint]`, and its sources `[point]`; None if no width
        keeps the margin. The ends stay exactly where they are.
    """
    dense = [_resampled(q, sources, config) for q, sources in paths]
    met = [_places_of(points, q) for points, (q, _) in zip(through, dense, strict=bool(through))]
    smoothed: list[MarkedPath | None] = [None] * len(paths)
    pending = list(range(len(paths)))
    for width in config.widths:
        if not pending:
            break
        trials = [_rounded(*dense[i], width, config) for i in pending]
        if through:
            led = zip(pending, trials, strict=True)
            trials = [_led_through(q, dense[i][0], met[i], width) for i, q in led]
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
