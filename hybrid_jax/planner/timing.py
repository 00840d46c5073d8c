# SPDX-License-Identifier: MIT
"""From joint paths to trajectories in time (TOPP-RA, arXiv:1707.07239)."""

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import numpy as np
from scipy.interpolate import CubicSpline

from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels.batching import padded_chunks
from hybrid_jax.kernels.kinematics import tool_pose
from hybrid_jax.kernels.pathspeed import fastest_speeds
from hybrid_jax.types import Trajectory, Workcell

BENDS = 2.0
"""Between two points of a path one of which bends so many times as much as most do, TOPP-RA's grid
has a point in the middle."""
LEAST_GRID = 256
"""Points of the smallest grid; twice as many, and so on, where a path has more: few traces."""
TOGETHER = 4
"""Paths that are timed in one call."""

ROUNDINGS = 0.0, 0.02, 0.04, 0.08, 0.16, 0.32
"""Times over which the speed along a path is averaged where the jerk is limited [s]: the one that
gives the shortest motion is used."""

_tool_positions = jax.jit(jax.vmap(lambda cell, q: dq.position(tool_pose(cell, q)), (None, 0)))
_speeds = jax.jit(jax.vmap(fastest_speeds, (0, 0, 0, None, None)))


@dataclass(frozen=True)
class TimingConfig:
    """How fast."""

    speed: float = 0.6
    """Share of the velocity limits that a trajectory uses."""
    acceleration: float = 0.4
    """Share of the acceleration limits."""
    sample_time: float = 0.01
    """Spacing of the returned points [s]."""
    jerk: float | None = None
    """Largest jerk of a joint [rad/s^3]; None leaves it free."""


class _Path:
    """A joint path as a spline, and the grid on which its limits are kept."""

    def __init__(self, q: np.ndarray, sources: np.ndarray):
        moved = np.concatenate([[True], np.abs(np.diff(q, axis=0)).max(axis=1) > 1e-6])
        q, self.sources = q[moved].astype(float), sources[moved]
        way = np.linalg.norm(np.diff(q, axis=0), axis=1)
        self.knots = np.concatenate([[0], np.cumsum(way)])
        self.usable = len(q) >= 3
        if self.usable:
            self.spline = CubicSpline(self.knots, q)
            self.grid = _grid(self.knots, np.abs(self.spline(self.knots, 2)).max(axis=1))

    def rows(self, size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Slope, bend `[size, joint]` and step `[size]` on the grid; its last point is repeated."""
        grid = np.concatenate([self.grid, self.grid[-1:].repeat(size - len(self.grid))])
        return self.spline(grid, 1), self.spline(grid, 2), np.diff(grid, append=grid[-1])

    def sample(self, squared: np.ndarray, config: TimingConfig, limits) -> Trajectory | None:
        """The motion with these squared speeds on the grid; None if it would stand still."""
        squared = squared[: len(self.grid)].astype(float)
        if (squared[1:-1] <= 0).any() or not np.isfinite(squared).all():
            return None
        samples = _sample(self.grid, np.sqrt(squared), config.sample_time)
        if config.jerk is None:
            return self._within_limits(*samples, limits, np.inf)
        rounded = (_rounded(*samples, width) for width in ROUNDINGS)
        found = [self._within_limits(*one, limits, config.jerk) for one in rounded]
        return min(found, key=lambda motion: motion.times[-1])

    def _within_limits(self, times, s, speed_s, rate_s, limits, jerk: float) -> Trajectory:
        """The motion at places on the path, the whole of it as much slower as the limits ask for.

        They hold on the grid, but may be exceeded between its points.
        """
        slope, bend = self.spline(s, 1), self.spline(s, 2)
        velocities = slope * speed_s[:, None]
        accelerations = bend * speed_s[:, None] ** 2 + slope * rate_s[:, None]
        rest = np.zeros((1, slope.shape[1]))  # before and after the motion
        change = np.diff(np.concatenate([rest, accelerations, rest]), axis=0)
        change = np.abs(change).max() / (times[1] - times[0])
        speed, rate = limits
        slower = max(
            1.0, np.max(np.abs(velocities) / speed),
            np.sqrt(np.max(np.abs(accelerations) / rate)), np.cbrt(change / jerk),
        )  # fmt: skip
        at = np.interp(s, self.knots, np.arange(len(self.knots)))
        return Trajectory(
            times * slower, self.spline(s), velocities / slower, accelerations / slower**2,
            self.sources[np.round(at).astype(int)],
        )  # fmt: skip


def time_parameterize(
    cell: Workcell,
    paths: list[tuple[np.ndarray, np.ndarray]],
    config: TimingConfig,
    tool_speeds: Sequence[float] = (),
) -> list[Trajectory | None]:
    """Fastest motions along paths under the velocity and acceleration limits.

    Where the tool would exceed its own limit, the whole motion is as much slower.

    Args:
        cell: limits.
        paths: of each, `[point, joint]` configurations and `[point]` where they came from.
        config: shares of the limits, spacing of the result.
        tool_speeds: most that the tool may move on each path [m/s], inf for no limit; none for
            none anywhere.

    Returns:
        A trajectory for each path, None where it has fewer than three different points.
    """
    limits = (
        config.speed * np.asarray(cell.velocity_limits, float),
        config.acceleration * np.asarray(cell.chain.acceleration_limits, float),
    )
    splines = [_Path(q, sources) for q, sources in paths]
    rows = [i for i, path in enumerate(splines) if path.usable]
    found: list[Trajectory | None] = [None] * len(paths)
    for index, count in padded_chunks(len(rows), TOGETHER):
        some = [splines[rows[i]] for i in index]
        size = LEAST_GRID
        while size < max(len(path.grid) for path in some):
            size *= 2
        block = [np.stack(a) for a in zip(*(path.rows(size) for path in some), strict=True)]
        squared = np.asarray(_speeds(*(a.astype(np.float32) for a in (*block, *limits))))
        for i, path, one in zip(index[:count], some[:count], squared[:count], strict=True):
            most = tool_speeds[rows[i]] if tool_speeds else np.inf
            slower = _share_of_speed(cell, path, one, most)
            found[rows[i]] = path.sample(slower**2 * one, config, limits)
    return found


def _share_of_speed(cell: Workcell, path: _Path, squared: np.ndarray, most: float) -> float:
    """How much of its speed a motion may keep so that the tool stays below a limit [m/s]."""
    if np.isinf(most):
        return 1.0
    size, count = len(squared), len(path.grid)
    grid = np.concatenate([path.grid, path.grid[-1:].repeat(size - count)])
    tool = np.asarray(_tool_positions(cell, path.spline(grid).astype(np.float32)))[:count]
    speed = np.sqrt(np.maximum(squared[:count], 0.0))
    way = np.linalg.norm(np.diff(tool, axis=0), axis=1) / np.diff(path.grid)
    return min(1.0, most / max(1e-9, float(np.max(way * np.maximum(speed[1:], speed[:-1])))))


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


def _rounded(times, places, speed, rate, width: float):
    """The same samples with the speed along the path averaged over a time; it lasts as much longer.

    What was a jump of the acceleration becomes a ramp.
    """
    period = times[1] - times[0]
    count = int(round(width / period))
    if count < 2:
        return times, places, speed, rate
    mean = np.convolve(speed, np.full(count, 1 / count))
    way = np.concatenate([[0.0], np.cumsum((mean[1:] + mean[:-1]) / 2 * period)])
    stretch = (places[-1] - places[0]) / way[-1]
    mean *= stretch
    return (
        period * np.arange(len(mean)), places[0] + way * stretch, mean, np.gradient(mean, period)
    )
