# SPDX-License-Identifier: MIT
"""From joint way points to a smooth trajectory in time (TOPP-RA, arXiv:1707.07239)."""

import functools
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import toppra
import toppra.algorithm
import toppra.constraint
from jax import Array
from jaxtyping import Float
from scipy.ndimage import gaussian_filter1d

from hybrid_jax.kernels.collision import clearance, edge_clearance
from hybrid_jax.types import Scene, Trajectory, Workcell

toppra.setup_logging("ERROR")


@dataclass(frozen=True)
class TimingConfig:
    """How fast and how smooth."""

    speed: float = 0.6
    """Share of the velocity limits that a trajectory uses."""
    acceleration: float = 0.4
    """Share of the acceleration limits."""
    spacing: float = 0.04
    """Distance of way points before smoothing [rad]."""
    smoothing: tuple[float, ...] = (8.0, 4.0, 2.0, 1.0, 0.0)
    """Widths of the smoothing filter, tried in turn, in way points."""
    margin: float = 0.002
    """Clearance that a smoothed path keeps [m]."""
    sample_time: float = 0.01
    """Spacing of the returned points [s]."""
    shortcuts: int = 48
    """Pairs tried in each of `shortcut_rounds`."""
    shortcut_rounds: int = 6
    shortcut_samples: int = 24
    """Clearance checks along a shortcut."""


MAX_CHECKED = 1024
"""Configurations that `path_clearance` takes in one call: one trace for all paths."""


@jax.jit
def _batch_clearance(cell: Workcell, scene: Scene, q: Float[Array, "point n"]):
    inside = cell.replace(scene=scene)
    return jax.vmap(clearance, (None, 0))(inside, q)


def path_clearance(cell: Workcell, q: np.ndarray) -> np.ndarray:
    """Clearance at each configuration `[point]` [m]."""
    out = []
    for start in range(0, len(q), MAX_CHECKED):
        part = q[start : start + MAX_CHECKED]
        padded = np.concatenate([part, part[-1:].repeat(MAX_CHECKED - len(part), 0)])
        found = _batch_clearance(cell, cell.scene, jnp.asarray(padded, jnp.float32))
        out.append(np.asarray(found)[: len(part)])
    return np.concatenate(out)


def densify(q: np.ndarray, spacing: float) -> np.ndarray:
    """Points along a polyline, no two neighbours further apart than `spacing` [rad]."""
    size = np.abs(np.diff(q, axis=0)).max(axis=1)
    counts = np.maximum(1, np.ceil(size / spacing).astype(int))
    parts = [
        a + (b - a) * (np.arange(n) / n)[:, None]
        for a, b, n in zip(q[:-1], q[1:], counts, strict=True)
    ]
    return np.concatenate([*parts, q[-1:]])


@functools.partial(jax.jit, static_argnames="samples")
def _edges(cell, scene, starts, ends, samples):
    inside = cell.replace(scene=scene)
    return jax.vmap(lambda a, b: edge_clearance(inside, a, b, samples))(starts, ends)


def shortcut(
    cell: Workcell, q: np.ndarray, margin: float, config: TimingConfig, seed: int = 0
) -> np.ndarray:
    """Replace detours of a polyline by straight edges that keep the margin."""
    rng = np.random.default_rng(seed)
    for _ in range(config.shortcut_rounds):
        if len(q) < 3:
            break
        pairs = np.sort(rng.integers(0, len(q), (config.shortcuts, 2)), axis=1)
        gap = np.asarray(
            _edges(
                cell,
                cell.scene,
                jnp.asarray(q[pairs[:, 0]], jnp.float32),
                jnp.asarray(q[pairs[:, 1]], jnp.float32),
                config.shortcut_samples,
            )
        )
        length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(q, axis=0), axis=1))])
        direct = np.linalg.norm(q[pairs[:, 1]] - q[pairs[:, 0]], axis=1)
        gain = length[pairs[:, 1]] - length[pairs[:, 0]] - direct
        gain = np.where((gap >= margin) & (pairs[:, 1] > pairs[:, 0] + 1), gain, 0.0)
        best = int(np.argmax(gain))
        if gain[best] <= 1e-3:
            continue
        a, b = pairs[best]
        q = densify(np.concatenate([q[: a + 1], q[b:]]), config.spacing)
    return q


def smooth(cell: Workcell, q: np.ndarray, config: TimingConfig) -> np.ndarray | None:
    """Round the corners of a path as far as the margin allows; None if even the path fails.

    The ends stay exactly where they are. A path that starts or ends closer to something than the
    margin may stay that close there, not closer.
    """
    dense = densify(q, config.spacing)
    dense = dense[np.concatenate([[True], np.abs(np.diff(dense, axis=0)).max(axis=1) > 1e-6])]
    if len(dense) < 4:
        dense = densify(dense, max(1e-4, np.abs(np.diff(dense, axis=0)).max() / 4))
    for width in config.smoothing:
        # Filter the deviation from the straight line between the ends: they stay fixed.
        phase = np.linspace(0, 1, len(dense))[:, None]
        line = dense[0] + phase * (dense[-1] - dense[0])
        bent = np.concatenate([-(dense - line)[::-1], dense - line, -(dense - line)[::-1]])
        even = (
            gaussian_filter1d(bent, width, axis=0)[len(dense) : 2 * len(dense)]
            if width
            else (dense - line)
        )
        path = line + even
        path[0], path[-1] = dense[0], dense[-1]
        if path_clearance(cell, densify(path, config.spacing / 2)).min() >= config.margin:
            return path
    return None


def time_parameterize(
    cell: Workcell, q: np.ndarray, sources: np.ndarray, config: TimingConfig
) -> Trajectory | None:
    """Fastest motion along a path under the velocity and acceleration limits; None if none.

    Args:
        cell: limits.
        q: `[point, joint]` path.
        sources: `[point]` where each point came from.
        config: shares of the limits, spacing of the result.
    """
    moved = np.concatenate([[True], np.abs(np.diff(q, axis=0)).max(axis=1) > 1e-6])
    q, sources = q[moved].astype(float), sources[moved]
    if len(q) < 3:
        return None
    knots = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(q, axis=0), axis=1))])
    path = toppra.SplineInterpolator(knots, q)
    speed = config.speed * np.asarray(cell.velocity_limits, float)
    rate = config.acceleration * np.asarray(cell.chain.acceleration_limits, float)
    limits = [
        toppra.constraint.JointVelocityConstraint(np.stack([-speed, speed], 1)),
        toppra.constraint.JointAccelerationConstraint(np.stack([-rate, rate], 1)),
    ]
    grid = np.linspace(0, knots[-1], max(100, 2 * len(q)))
    timed = toppra.algorithm.TOPPRA(limits, path, gridpoints=grid).compute_trajectory(0, 0)
    if timed is None:
        return None
    count = max(2, int(np.ceil(timed.duration / config.sample_time)) + 1)
    times = np.linspace(0, timed.duration, count)
    positions = timed(times)
    nearest = np.abs(positions[:, None] - q[None]).max(axis=2).argmin(axis=1)
    return Trajectory(times, positions, timed(times, 1), timed(times, 2), sources[nearest])
