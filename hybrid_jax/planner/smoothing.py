# SPDX-License-Identifier: MIT
"""Make joint paths shorter and smoother, and leave alone what was demonstrated."""

import functools
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.ndimage import gaussian_filter1d

from hybrid_jax.kernels.collision import clearance_up_to, points_between
from hybrid_jax.kernels.edges import path_clearance, split_counts
from hybrid_jax.types import Scene, Workcell

LEAST_GAIN = 1e-3
"""Way that a shortcut must save [rad]."""


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


@functools.partial(jax.jit, static_argnames="samples")
def _edges_are_free(cell: Workcell, scene: Scene, starts, ends, margin, samples: int) -> Array:
    inside = cell.replace(scene=scene)
    check = jax.vmap(lambda q: clearance_up_to(inside, q, margin))
    points = jax.vmap(lambda a, b: points_between(a, b, samples))(starts, ends)
    return jnp.all(jax.vmap(check)(points) >= margin, axis=1)


def _best_shortcut(cell, q: np.ndarray, pairs: np.ndarray, margin: float, config) -> int | None:
    """Which pair of points saves most by the free edge between them; None if none does."""
    starts, ends = (q[column].astype(np.float32) for column in pairs.T)
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(q, axis=0), axis=1))])
    gain = length[pairs[:, 1]] - length[pairs[:, 0]] - np.linalg.norm(ends - starts, axis=1)
    best = np.argsort(-gain, kind="stable")[: config.checked]
    if gain[best[0]] <= LEAST_GAIN:
        return None
    free = _edges_are_free(
        cell, cell.scene, starts[best], ends[best], np.float32(margin), config.fine
    )
    kept = np.flatnonzero(np.asarray(free) & (gain[best] > LEAST_GAIN))
    return int(best[kept[0]]) if kept.size else None


def shortcut(
    cell: Workcell, q: np.ndarray, margin: float, config: SmoothingConfig, seed: int = 0
) -> np.ndarray:
    """Replace detours of a polyline by straight edges that keep the margin."""
    rng = np.random.default_rng(seed)
    q = densify(q, config.spacing)
    for _ in range(config.shortcut_rounds):
        if len(q) < 3:
            break
        pairs = np.sort(rng.integers(0, len(q), (config.shortcuts, 2)), axis=1)
        best = _best_shortcut(cell, q, pairs, margin, config)
        if best is not None:
            a, b = pairs[best]
            q = densify(np.concatenate([q[: a + 1], q[b:]]), config.spacing)
    return q


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
    margin, point = np.full(len(gap), config.margin), np.arange(len(gap))
    for end, away in ((gap[0], point), (gap[-1], point[::-1])):
        margin[away < config.beside] = min(config.margin, 0.9 * max(end, 0.0))
    return margin


def smooth(
    cell: Workcell, q: np.ndarray, sources: np.ndarray, config: SmoothingConfig
) -> tuple[np.ndarray, np.ndarray] | None:
    """Round the corners of a path as far as the margin allows.

    Args:
        cell: in the scene of the path.
        q: `[point, joint]`.
        sources: `[point]` 0 for what was demonstrated: there, the filter is narrow.
        config: widths and margin.

    Returns:
        The path `[n, joint]` in small steps and the source of each point; None if no width keeps
        the margin. The ends stay exactly where they are.
    """
    moved = np.concatenate([[True], np.abs(np.diff(q, axis=0)).max(axis=1) > 1e-5])
    moved[-1] = True
    q, sources = q[moved], sources[moved]
    places = refine(q, min(config.spacing, max(1e-4, np.abs(np.diff(q, axis=0)).max() / 4)))
    dense, sources = at_places(q, places), sources[np.round(places).astype(int)]
    free = gaussian_filter1d((sources > 0).astype(float), config.blend)
    free = np.clip(2 * free, 0, 1)[:, None]
    for width in config.widths:
        kept = _filtered(dense, min(width, config.kept))
        path = kept + free * (_filtered(dense, width) - kept)
        path[0], path[-1] = dense[0], dense[-1]
        gap = path_clearance(cell, densify(path, config.spacing / 2), config.margin)
        if (gap >= _required(gap, config)).all():
            return path, sources
    return None
