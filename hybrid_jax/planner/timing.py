# SPDX-License-Identifier: MIT
"""Trajectories in time along joint paths (TOPP-RA, arXiv:1707.07239)."""

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import maximum_filter1d

from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels.batching import in_calls, padded_chunks
from hybrid_jax.kernels.kinematics import tool_pose
from hybrid_jax.planner.path_parameterization import BLOCK, fastest_speeds
from hybrid_jax.planner.speed_profile import SpeedProfile, rounded, sample_speeds
from hybrid_jax.runtime.kept_programs import kept
from hybrid_jax.types import Trajectory, Workcell

BETWEEN = 2
"""Smallest number of grid steps between two points of a path."""
PATHS_PER_CALL = 4
"""Number of paths that are timed in one call."""
FINEST = 0.01
"""Largest time between two samples of a motion before it is resampled [s]."""
EVEN = 8e-5
"""Largest deviation of the tool from the motion if joints move evenly between two points [m]."""
WHOLE = 1e-3
"""Motions last whole multiples of this [s]: programs of moves in milliseconds keep their times."""
RAMP = 0.04
"""Time over which the speed along a path is averaged, so that accelerations do not jump [s]."""
WIDER = 0.08, 0.16, 0.32
"""Further such times where the jerk is limited; the one with the shortest motion is used [s]."""
ROUNDS = 4
"""Number of rounds that slow a motion only where it exceeds a limit; then all of it is slowed."""
RESTING = 1e-5
"""Largest extent of a path that counts as rest [rad or m]."""
LEFT = 1.003
"""Largest excess, as a factor on the speed, that needs no further round."""

_NO_CAP = 1e9
"""A speed that no motion reaches; its square is finite in single precision."""


@kept
def _tool_positions(cell: Workcell, q):
    """Positions of the tool `[point, 3]` at configurations `[point, joint]` [m]."""
    return jax.vmap(lambda point: dq.position(tool_pose(cell, point)))(q)


@dataclass(frozen=True)
class TimingConfig:
    """Speed and sampling of trajectories."""

    speed: float = 0.6
    """Share of the velocity limits that a trajectory uses."""
    acceleration: float = 0.4
    """Share of the acceleration limits that a trajectory uses."""
    sample_time: float = 0.01
    """Largest time between two points [s]. A trajectory has no fewer points than its path, and
    enough for a controller that moves the joints evenly between them (see `EVEN`)."""
    jerk: float | None = None
    """Largest jerk of a joint [rad/s^3 or m/s^3]; None leaves it free."""


@dataclass(frozen=True)
class _Limits:
    """Limits that a motion must keep."""

    speed: np.ndarray
    """`[joint]` [rad/s or m/s]."""
    rate: np.ndarray
    """`[joint]` [rad/s^2 or m/s^2]."""
    jerk: float
    """Of each joint [rad/s^3 or m/s^3]."""
    tool_speed: float
    """Of the tool [m/s]."""
    reach: np.ndarray
    """`[joint]` largest motion of the tool for a unit of the joint's [m/rad or m/m]."""


class _Path:
    """A joint path as a spline, a grid along it, and the limits of its speeds on the grid."""

    def __init__(self, q: np.ndarray, sources: np.ndarray, limits: _Limits):
        distinct = np.concatenate([[True], np.abs(np.diff(q, axis=0)).max(axis=1) > 1e-6])
        q, self.sources, self.limits = q[distinct].astype(float), sources[distinct], limits
        lengths = np.linalg.norm(np.diff(q, axis=0), axis=1)
        self.knots = np.concatenate([[0], np.cumsum(lengths)])
        self.usable = len(q) >= 3
        if self.usable:
            self.spline = CubicSpline(self.knots, q)
            steps = len(q) - 1
            between = max(BETWEEN, (BLOCK - 1) // steps)
            places = np.arange(between * steps + 1) / between
            self.grid = np.interp(places, np.arange(len(q)), self.knots)
            self.slope, self.bend = self.spline(self.grid, 1), self.spline(self.grid, 2)
            self.caps = np.full(len(self.grid), np.inf)
            """`[grid]` largest speed along the path."""
            self.slower = np.ones(len(self.grid))
            """`[grid]` factor by which speeds are reduced."""

    def filled(self, values: np.ndarray, size: int) -> np.ndarray:
        """Values `[grid, ...]`, the last one repeated up to `size`."""
        return np.concatenate([values, values[-1:].repeat(size - len(values), axis=0)])

    def cap_tool_speed(self, cell: Workcell) -> None:
        """Limit the speed along the path so that the tool keeps its own limit."""
        if np.isinf(self.limits.tool_speed):
            return
        q = self.spline(self.grid).astype(np.float32)
        run = lambda rows, used: _tool_positions(cell, q[rows])  # noqa: E731
        tool_positions = in_calls(run, len(q), (BLOCK,)).astype(float)
        slope = np.linalg.norm(np.diff(tool_positions, axis=0), axis=1) / np.diff(self.grid)
        steepest = np.maximum(np.append(slope, slope[-1]), np.append(slope[0], slope))
        self.caps = self.limits.tool_speed / np.maximum(steepest, 1e-9)

    def rows(self, size: int) -> tuple[np.ndarray, ...]:
        """Arguments of `fastest_speeds`, each `[size]` or `[size, joint]`."""
        grid, slower = self.filled(self.grid, size), self.filled(self.slower, size)
        caps = np.minimum(self.filled(self.caps, size) / slower, _NO_CAP)
        speed, rate = self.limits.speed / slower[:, None], self.limits.rate / slower[:, None] ** 2
        slope, bend = self.filled(self.slope, size), self.filled(self.bend, size)
        columns = slope, bend, np.diff(grid, append=grid[-1]), speed, rate, caps
        return tuple(a.astype(np.float32) for a in columns)

    def profile(self, squared: np.ndarray, width: float, period: float) -> SpeedProfile | None:
        """The motion with squared speeds `[size]` on the grid; None if it would stand still."""
        squared = squared[: len(self.grid)].astype(float)
        if (squared[1:-1] <= 0).any() or not np.isfinite(squared).all():
            return None
        return rounded(sample_speeds(self.grid, np.sqrt(squared), period), width)

    def derivatives(self, place, speed, acceleration) -> tuple[np.ndarray, np.ndarray]:
        """Velocities and accelerations `[sample, joint]` from those along the path `[sample]`."""
        return _derivatives(self.spline(place, 1), self.spline(place, 2), speed, acceleration)

    def _too_fast(self, velocities, accelerations, speed, caps) -> np.ndarray:
        speed_excess = np.max(np.abs(velocities) / self.limits.speed, axis=1)
        rate_excess = np.sqrt(np.max(np.abs(accelerations) / self.limits.rate, axis=1))
        return np.max([speed_excess, rate_excess, speed / caps], axis=0)

    def excess(self, profile: SpeedProfile) -> np.ndarray:
        """Factor `[sample]` by which a motion is too fast there or just before."""
        caps = np.interp(profile.place, self.grid, self.caps)
        excess = self._too_fast(*self.derivatives(*profile.states), profile.speed, caps)
        # a path may bend sharply between two samples
        speed, acceleration = (
            np.interp(self.grid, profile.place, c) for c in (profile.speed, profile.acceleration)
        )
        between = _derivatives(self.slope, self.bend, speed, acceleration)
        sample = np.searchsorted(profile.place, self.grid).clip(0, len(excess) - 1)
        np.maximum.at(excess, sample, self._too_fast(*between, speed, self.caps))
        return excess

    def slow_down(self, profile: SpeedProfile, width: float) -> bool:
        """Lower the limits where a motion exceeds them; True if it exceeds them by much."""
        excess = self.excess(profile)
        # the speed of a sample is the mean of those around it
        samples = 2 * int(np.ceil(width / profile.period)) + 1
        around = np.interp(self.grid, profile.place, maximum_filter1d(excess, samples))
        self.slower *= np.maximum(1.0, around)
        return bool(excess.max() > LEFT)

    def kept(self, profile: SpeedProfile) -> SpeedProfile:
        """The motion, slowed as a whole so that it keeps all limits."""
        accelerations = np.pad(self.derivatives(*profile.states)[1], ((1, 1), (0, 0)))
        jerk = np.abs(np.diff(accelerations, axis=0)).max() / profile.period
        excesses = float(self.excess(profile).max()), float(np.cbrt(jerk / self.limits.jerk))
        duration = profile.times[-1] * max(1.0, *excesses)
        return profile.slowed(WHOLE * np.ceil(duration / WHOLE - 1e-6) / profile.times[-1])

    def trajectory(self, profile: SpeedProfile, sample_time: float) -> Trajectory:
        """The motion as points in time, see `TimingConfig.sample_time`."""
        tool_accelerations = np.abs(self.derivatives(*profile.states)[1]) @ self.limits.reach
        # even motion over a time h leaves a motion with acceleration a by a h^2 / 8
        sample_time = min(sample_time, np.sqrt(8 * EVEN / max(tool_accelerations.max(), 1e-9)))
        count = max(int(np.ceil(profile.times[-1] / sample_time - 1e-6)) + 1, len(self.knots))
        profile = self.kept(profile.resampled(count))  # limits also hold at the new points
        velocities, accelerations = self.derivatives(*profile.states)
        velocities[[0, -1]] = accelerations[[0, -1]] = 0.0
        positions = self.spline(profile.place)
        positions[[0, -1]] = self.spline(self.knots[[0, -1]])
        points = np.interp(profile.place, self.knots, np.arange(len(self.knots)))
        marks = self.sources[np.round(points).astype(int)]
        return Trajectory(profile.times, positions, velocities, accelerations, marks)


def _derivatives(slope, bend, speed, acceleration) -> tuple[np.ndarray, np.ndarray]:
    """Velocities and accelerations of joints, from first and second derivatives of the path."""
    return slope * speed[:, None], bend * speed[:, None] ** 2 + slope * acceleration[:, None]


def is_resting(q: np.ndarray) -> bool:
    """Does a path `[point, joint]` [rad or m] stay in one place?"""
    return bool(np.ptp(q, axis=0).max() < RESTING)


def resting(cell: Workcell, start: np.ndarray, end: np.ndarray, source: int) -> Trajectory:
    """A trajectory of two points that hardly differ, `start` and `end` `[joint]` [rad or m]."""
    # a cubic between them accelerates by 6 distance / time^2, which must keep the limits
    zeros, distance = np.zeros((2, len(start))), np.abs(np.asarray(end, float) - start)
    count = np.sqrt(np.max(6 * distance / np.asarray(cell.chain.acceleration_limits))) / WHOLE
    times = np.array([0.0, WHOLE * max(1.0, np.ceil(count))])
    ends = np.stack([start, end]).astype(float)
    return Trajectory(times, ends, zeros, zeros.copy(), np.full(2, source, np.uint8))


def _reach(cell: Workcell) -> np.ndarray:
    """`[joint]` bound of the tool's motion for a unit of the joint's: all later offsets in line."""
    offsets = np.asarray(cell.chain.offset, float)[1:, :3], np.asarray(cell.chain.tool, float)[:3]
    lengths = np.linalg.norm(np.vstack(offsets), axis=1)
    slides, limits = np.asarray(cell.chain.hinge) == 0, np.asarray(cell.chain.limits, float)
    # a slide lengthens the arm by its own way from where it adds nothing
    travel = np.abs(limits - np.asarray(cell.chain.reference, float)[:, None]).max(axis=1)
    lengths[:-1] += np.where(slides, travel, 0.0)[1:]
    return np.where(slides, 1.0, np.cumsum(lengths[::-1])[::-1])


def time_parameterize(
    cell: Workcell,
    paths: list[tuple[np.ndarray, np.ndarray]],
    config: TimingConfig,
    tool_speeds: Sequence[float] = (),
) -> list[Trajectory | None]:
    """Fast motions along paths that keep the velocity and acceleration limits.

    They begin and end at rest, with zero acceleration, and accelerations do not jump: a controller
    that interpolates the points reproduces the motion.

    Args:
        cell: the robot, for its limits.
        paths: way points `[point, joint]` [rad or m] and sources `[point]` of each.
        config: shares of the limits, spacing of the result.
        tool_speeds: largest speed of the tool on each path [m/s], inf for none; empty for no limit.

    Returns:
        A trajectory for each path, None where it has fewer than three different points.

    Raises:
        InputError: a limit is so small that a motion would take days.
    """
    speed = config.speed * np.asarray(cell.velocity_limits, float)
    rate = config.acceleration * np.asarray(cell.chain.acceleration_limits, float)
    caps, reach = tool_speeds or [np.inf] * len(paths), _reach(cell)
    jerk = np.inf if config.jerk is None else config.jerk
    splines = [
        _Path(q, sources, _Limits(speed, rate, jerk, fastest, reach))
        for (q, sources), fastest in zip(paths, caps, strict=True)
    ]
    rows = [i for i, path in enumerate(splines) if path.usable]
    trajectories: list[Trajectory | None] = [None] * len(paths)
    # a program for one path would take longer to load than it saves
    for index, count in padded_chunks(len(rows), PATHS_PER_CALL, single=False):
        motions = _time_together(cell, [splines[rows[i]] for i in index], config)
        for i, motion in zip(index[:count], motions[:count], strict=True):
            trajectories[rows[i]] = motion
    return trajectories


def _time_together(
    cell: Workcell, paths: list[_Path], config: TimingConfig
) -> list[Trajectory | None]:
    """Motions along the paths of one call of the kernel; a path may occur several times."""
    size = max(len(path.grid) for path in paths)
    path_of = {id(path): path for path in paths}
    for path in path_of.values():
        path.cap_tool_speed(cell)
    fastest = {}
    for width in (RAMP,) if config.jerk is None else (RAMP, *WIDER):
        for name, profile in _profiles(paths, size, width, min(FINEST, config.sample_time)).items():
            motion = path_of[name].kept(profile)
            if name not in fastest or motion.times[-1] < fastest[name].times[-1]:
                fastest[name] = motion
    return [
        path.trajectory(fastest[id(path)], config.sample_time) if id(path) in fastest else None
        for path in paths
    ]


def _profiles(
    paths: list[_Path], size: int, width: float, period: float
) -> dict[int, SpeedProfile]:
    """Motions of paths, by the path's `id`, slowed in the places where they exceed a limit.

    The limits hold on the grid, but may be exceeded between its points and by the averaging.
    """
    pending, profiles = {id(path): path for path in paths}, {}
    for path in pending.values():
        path.slower[:] = 1.0
    for _ in range(ROUNDS):
        rows = {id(path): path.rows(size) for path in paths}
        block = [np.stack(a) for a in zip(*(rows[id(path)] for path in paths), strict=True)]
        squared = dict(zip(map(id, paths), fastest_speeds(*block), strict=True))
        for name, path in list(pending.items()):
            profile = path.profile(squared[name], width, period)
            if profile is not None:
                profiles[name] = profile
            if profile is None or not path.slow_down(profile, width):
                del pending[name]
        if not pending:
            break
    return profiles
