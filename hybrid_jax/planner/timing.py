# SPDX-License-Identifier: MIT
"""From a joint path to a trajectory in time (TOPP-RA, arXiv:1707.07239)."""

from dataclasses import dataclass

import numpy as np
import toppra
import toppra.algorithm
import toppra.constraint

from hybrid_jax.types import Trajectory, Workcell

toppra.setup_logging("ERROR")

BENDS = 2.0
"""Between two points of a path one of which bends so many times as much as most do, TOPP-RA's grid
has a point in the middle."""


@dataclass(frozen=True)
class TimingConfig:
    """How fast."""

    speed: float = 0.6
    """Share of the velocity limits that a trajectory uses."""
    acceleration: float = 0.4
    """Share of the acceleration limits."""
    sample_time: float = 0.01
    """Spacing of the returned points [s]."""


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
    grid = _grid(knots, np.abs(path(knots, 2)).max(axis=1))
    found = toppra.algorithm.TOPPRA(limits, path, gridpoints=grid).compute_parameterization(0, 0)
    if found is None or found[1] is None or not np.isfinite(found[1]).all():
        return None
    times, s, speed_s, rate_s = _sample(grid, np.asarray(found[1]), config.sample_time)
    slope, bend = path(s, 1), path(s, 2)
    velocities = slope * speed_s[:, None]
    accelerations = bend * speed_s[:, None] ** 2 + slope * rate_s[:, None]
    # the limits hold on the grid; what exceeds them between its points slows the whole motion
    slower = max(
        1.0, np.max(np.abs(velocities) / speed), np.sqrt(np.max(np.abs(accelerations) / rate))
    )
    source = sources[np.round(np.interp(s, knots, np.arange(len(q)))).astype(int)]
    return Trajectory(
        times * slower, path(s), velocities / slower, accelerations / slower**2, source
    )


def _grid(knots: np.ndarray, bend: np.ndarray) -> np.ndarray:
    """Points on the path at which the limits are kept: a cubic spline bends most at its knots."""
    sharp = bend > BENDS * np.median(bend)
    middle = (knots[1:] + knots[:-1]) / 2
    return np.sort(np.concatenate([knots, middle[sharp[1:] | sharp[:-1]]]))


def _sample(
    grid: np.ndarray, speed: np.ndarray, period: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Times, places on the path, their speeds and accelerations, evenly spaced in time.

    Between two points of the grid the acceleration along the path is constant.
    """
    step = np.diff(grid)
    rate = (speed[1:] ** 2 - speed[:-1] ** 2) / (2 * step)
    lasts = 2 * step / np.maximum(speed[1:] + speed[:-1], 1e-9)
    ends = np.concatenate([[0.0], np.cumsum(lasts)])
    times = np.linspace(0.0, ends[-1], max(2, int(np.ceil(ends[-1] / period)) + 1))
    part = np.clip(np.searchsorted(ends, times, side="right") - 1, 0, len(step) - 1)
    since = times - ends[part]
    places = grid[part] + speed[part] * since + rate[part] * since**2 / 2
    return times, np.clip(places, grid[0], grid[-1]), speed[part] + rate[part] * since, rate[part]
