# SPDX-License-Identifier: MIT
"""From joint paths to trajectories in time (TOPP-RA, arXiv:1707.07239)."""

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import maximum_filter1d

from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels.batching import padded_chunks
from hybrid_jax.kernels.kinematics import tool_pose
from hybrid_jax.kernels.pathspeed import fastest_speeds
from hybrid_jax.planner.speedprofile import SpeedProfile, rounded, sample_speeds
from hybrid_jax.types import Trajectory, Workcell

LEAST_GRID = 512
"""Points of the smallest grid; twice as many, and so on, where a path has more: few traces."""
BETWEEN = 2
"""Steps of the grid from one point of a path to the next, at least."""
TOGETHER = 4
"""Paths that are timed in one call."""
FINEST = 0.01
"""Motions are made of points at most so far apart, and thinned out then [s]."""
EVEN = 8e-5
"""Most by which even motion of the joints between two points leaves a motion, at the tool [m]."""
WHOLE = 1e-3
"""Motions last whole multiples of this [s]: programs of moves in milliseconds keep their times."""
RAMP = 0.04
"""Time over which the speed along a path is averaged [s]: accelerations do not jump."""
WIDER = 0.08, 0.16, 0.32
"""Further ones where the jerk is limited; that of the shortest motion is used."""
ROUNDS = 4
"""Times that a motion is slowed where it exceeds a limit; what is left slows the whole of it."""
RESTING = 1e-5
"""A path that leads no further takes no time [rad or m]."""
LEFT = 1.003
"""An excess that is not worth another round."""

_NO_CAP = 1e9
"""A speed along a path that nothing reaches; its square is finite in single precision."""

_tool_positions = jax.jit(jax.vmap(lambda cell, q: dq.position(tool_pose(cell, q)), (None, 0)))
_speeds = jax.jit(jax.vmap(fastest_speeds))


@dataclass(frozen=True)
class TimingConfig:
    """How fast."""

    speed: float = 0.6
    """Share of the velocity limits that a trajectory uses."""
    acceleration: float = 0.4
    """Share of the acceleration limits."""
    sample_time: float = 0.01
    """Spacing of the returned points, at most [s]. There are no fewer than the path has, and so
    many that a controller which moves the joints evenly from one to the next keeps the tool within
    `EVEN` of the motion."""
    jerk: float | None = None
    """Largest jerk of a joint [rad/s^3 or m/s^3]; None leaves it free."""


@dataclass(frozen=True)
class _Limits:
    """What a motion must keep."""

    speed: np.ndarray
    """`[joint]` [rad/s or m/s]."""
    rate: np.ndarray
    """`[joint]` [rad/s^2 or m/s^2]."""
    jerk: float
    tool_speed: float
    """[m/s]."""
    reach: np.ndarray
    """`[joint]` most that the tool moves where the joint does by 1 [m/rad or 1]."""


class _Path:
    """A joint path as a spline, the grid on which its speeds are found, and their limits there."""

    def __init__(self, q: np.ndarray, sources: np.ndarray, limits: _Limits):
        moved = np.concatenate([[True], np.abs(np.diff(q, axis=0)).max(axis=1) > 1e-6])
        q, self.sources, self.limits = q[moved].astype(float), sources[moved], limits
        way = np.linalg.norm(np.diff(q, axis=0), axis=1)
        self.knots = np.concatenate([[0], np.cumsum(way)])
        self.usable = len(q) >= 3
        if self.usable:
            self.spline = CubicSpline(self.knots, q)
            steps = len(q) - 1
            between = max(BETWEEN, (LEAST_GRID - 1) // steps)
            places = np.arange(between * steps + 1) / between
            self.grid = np.interp(places, np.arange(len(q)), self.knots)
            self.slope, self.bend = self.spline(self.grid, 1), self.spline(self.grid, 2)
            self.caps = np.full(len(self.grid), np.inf)
            """`[grid]` largest speed along the path."""
            self.slower = np.ones(len(self.grid))
            """`[grid]` what speeds are divided by."""

    def filled(self, values: np.ndarray, size: int) -> np.ndarray:
        """Values on the grid; the last one is repeated."""
        return np.concatenate([values, values[-1:].repeat(size - len(values), axis=0)])

    def cap_tool_speed(self, cell: Workcell, size: int) -> None:
        """Let the tool keep its limit everywhere on the grid."""
        if np.isinf(self.limits.tool_speed):
            return
        q = self.spline(self.filled(self.grid, size)).astype(np.float32)
        tool = np.asarray(_tool_positions(cell, q), float)[: len(self.grid)]
        way = np.linalg.norm(np.diff(tool, axis=0), axis=1) / np.diff(self.grid)
        steepest = np.maximum(np.append(way, way[-1]), np.append(way[0], way))
        self.caps = self.limits.tool_speed / np.maximum(steepest, 1e-9)

    def rows(self, size: int) -> tuple[np.ndarray, ...]:
        """What `fastest_speeds` asks for, on the grid."""
        grid, slower = self.filled(self.grid, size), self.filled(self.slower, size)
        caps = np.minimum(self.filled(self.caps, size) / slower, _NO_CAP)
        speed, rate = self.limits.speed / slower[:, None], self.limits.rate / slower[:, None] ** 2
        slope, bend = self.filled(self.slope, size), self.filled(self.bend, size)
        found = slope, bend, np.diff(grid, append=grid[-1]), speed, rate, caps
        return tuple(a.astype(np.float32) for a in found)

    def profile(self, squared: np.ndarray, width: float, period: float) -> SpeedProfile | None:
        """The motion with these squared speeds on the grid; None if it would stand still."""
        squared = squared[: len(self.grid)].astype(float)
        if (squared[1:-1] <= 0).any() or not np.isfinite(squared).all():
            return None
        return rounded(sample_speeds(self.grid, np.sqrt(squared), period), width)

    def derivatives(self, place, speed, acceleration) -> tuple[np.ndarray, np.ndarray]:
        """Velocities and accelerations `[sample, joint]` of a motion that passes places so fast."""
        return _derivatives(self.spline(place, 1), self.spline(place, 2), speed, acceleration)

    def _too_fast(self, velocities, accelerations, speed, caps) -> np.ndarray:
        faster = np.max(np.abs(velocities) / self.limits.speed, axis=1)
        harder = np.sqrt(np.max(np.abs(accelerations) / self.limits.rate, axis=1))
        return np.max([faster, harder, speed / caps], axis=0)

    def excess(self, profile: SpeedProfile) -> np.ndarray:
        """`[sample]` by how much a motion is too fast there or just before, as a factor on its
        speed."""
        caps = np.interp(profile.place, self.grid, self.caps)
        found = self._too_fast(*self.derivatives(*profile.states), profile.speed, caps)
        # a path may bend sharply between two samples
        speed, acceleration = (
            np.interp(self.grid, profile.place, c) for c in (profile.speed, profile.acceleration)
        )
        between = _derivatives(self.slope, self.bend, speed, acceleration)
        after = np.searchsorted(profile.place, self.grid).clip(0, len(found) - 1)
        np.maximum.at(found, after, self._too_fast(*between, speed, self.caps))
        return found

    def slow_down(self, profile: SpeedProfile, width: float) -> bool:
        """Lower the limits where a motion exceeds them; did it by much?"""
        excess = self.excess(profile)
        # the speed of a sample is the mean of those around it
        samples = 2 * int(np.ceil(width / profile.period)) + 1
        around = np.interp(self.grid, profile.place, maximum_filter1d(excess, samples))
        self.slower *= np.maximum(1.0, around)
        return bool(excess.max() > LEFT)

    def kept(self, profile: SpeedProfile) -> SpeedProfile:
        """The motion, the whole of it as much slower as the limits still ask for."""
        accelerations = np.pad(self.derivatives(*profile.states)[1], ((1, 1), (0, 0)))
        jerk = np.abs(np.diff(accelerations, axis=0)).max() / profile.period
        asked = float(self.excess(profile).max()), float(np.cbrt(jerk / self.limits.jerk))
        lasts = profile.times[-1] * max(1.0, *asked)
        return profile.slowed(WHOLE * np.ceil(lasts / WHOLE - 1e-6) / profile.times[-1])

    def trajectory(self, profile: SpeedProfile, sample_time: float) -> Trajectory:
        """The motion as points in time, `TimingConfig.sample_time`."""
        bends = np.abs(self.derivatives(*profile.states)[1]) @ self.limits.reach
        sample_time = min(sample_time, np.sqrt(8 * EVEN / max(bends.max(), 1e-9)))
        count = max(int(np.ceil(profile.times[-1] / sample_time - 1e-6)) + 1, len(self.knots))
        profile = self.kept(profile.resampled(count))  # at its own points too
        velocities, accelerations = self.derivatives(*profile.states)
        velocities[[0, -1]] = accelerations[[0, -1]] = 0.0
        positions = self.spline(profile.place)
        positions[[0, -1]] = self.spline(self.knots[[0, -1]])
        at = np.interp(profile.place, self.knots, np.arange(len(self.knots)))
        marks = self.sources[np.round(at).astype(int)]
        return Trajectory(profile.times, positions, velocities, accelerations, marks)


def _derivatives(slope, bend, speed, acceleration) -> tuple[np.ndarray, np.ndarray]:
    """Velocities and accelerations where a path has a slope and a bend `[sample, joint]`."""
    return slope * speed[:, None], bend * speed[:, None] ** 2 + slope * acceleration[:, None]


def is_resting(q: np.ndarray) -> bool:
    """Is there nothing to do along a path `[point, joint]`?"""
    return bool(np.ptp(q, axis=0).max() < RESTING)


def resting(cell: Workcell, start: np.ndarray, end: np.ndarray, source: int) -> Trajectory:
    """A trajectory at rest, both ends being one; a cubic (6 way / time^2) keeps the limits."""
    still, way = np.zeros((2, len(start))), np.abs(np.asarray(end, float) - start)
    least = np.sqrt(np.max(6 * way / np.asarray(cell.chain.acceleration_limits))) / WHOLE
    times = np.array([0.0, WHOLE * max(1.0, np.ceil(least))])
    ends = np.stack([start, end]).astype(float)
    return Trajectory(times, ends, still, still.copy(), np.full(2, source, np.uint8))


def _reach(cell: Workcell) -> np.ndarray:
    """`[joint]` bound of the way of the tool for a joint's: all offsets after it, stretched out."""
    offsets = np.asarray(cell.chain.offset, float)[1:, :3], np.asarray(cell.chain.tool, float)[:3]
    lengths = np.linalg.norm(np.vstack(offsets), axis=1)
    slides, limits = np.asarray(cell.chain.hinge) == 0, np.asarray(cell.chain.limits, float)
    # a slide lengthens the arm by its own way
    lengths[:-1] += np.where(slides, np.abs(limits).max(axis=1), 0.0)[1:]
    return np.where(slides, 1.0, np.cumsum(lengths[::-1])[::-1])


def time_parameterize(
    cell: Workcell,
    paths: list[tuple[np.ndarray, np.ndarray]],
    config: TimingConfig,
    tool_speeds: Sequence[float] = (),
) -> list[Trajectory | None]:
    """Fastest motions along paths under the velocity and acceleration limits.

    They begin and end at rest, with accelerations of zero there and without jumps between: a
    controller that interpolates the points gives back the motion.

    Args:
        cell: limits.
        paths: of each, `[point, joint]` configurations and `[point]` where they came from.
        config: shares of the limits, spacing of the result.
        tool_speeds: most that the tool may move on each path [m/s], inf for no limit; none for
            none anywhere.

    Returns:
        A trajectory for each path, None where it has fewer than three different points.

    Raises:
        InputError: a limit is so small that a motion would take days.
    """
    speed = config.speed * np.asarray(cell.velocity_limits, float)
    rate = config.acceleration * np.asarray(cell.chain.acceleration_limits, float)
    most, reach = tool_speeds or [np.inf] * len(paths), _reach(cell)
    jerk = np.inf if config.jerk is None else config.jerk
    splines = [
        _Path(q, sources, _Limits(speed, rate, jerk, fastest, reach))
        for (q, sources), fastest in zip(paths, most, strict=True)
    ]
    rows = [i for i, path in enumerate(splines) if path.usable]
    found: list[Trajectory | None] = [None] * len(paths)
    for index, count in padded_chunks(len(rows), TOGETHER):
        motions = _time_together(cell, [splines[rows[i]] for i in index], config)
        for i, motion in zip(index[:count], motions[:count], strict=True):
            found[rows[i]] = motion
    return found


def _time_together(
    cell: Workcell, paths: list[_Path], config: TimingConfig
) -> list[Trajectory | None]:
    """Motions along paths that fill one call of the kernel; a path may stand there repeatedly."""
    size = LEAST_GRID
    while size < max(len(path.grid) for path in paths):
        size *= 2
    own = {id(path): path for path in paths}
    for path in own.values():
        path.cap_tool_speed(cell, size)
    found = {}
    for width in (RAMP,) if config.jerk is None else (RAMP, *WIDER):
        for name, profile in _profiles(paths, size, width, min(FINEST, config.sample_time)).items():
            kept = own[name].kept(profile)
            if name not in found or kept.times[-1] < found[name].times[-1]:
                found[name] = kept
    return [
        path.trajectory(found[id(path)], config.sample_time) if id(path) in found else None
        for path in paths
    ]


def _profiles(
    paths: list[_Path], size: int, width: float, period: float
) -> dict[int, SpeedProfile]:
    """Motions of paths by their `id`; where limits are exceeded they are slowed, there alone.

    The limits hold on the grid, but may be exceeded between its points and by the averaging.
    """
    going, found = {id(path): path for path in paths}, {}
    for path in going.values():
        path.slower[:] = 1.0
    for _ in range(ROUNDS):
        rows = {id(path): path.rows(size) for path in paths}
        block = [np.stack(a) for a in zip(*(rows[id(path)] for path in paths), strict=True)]
        squared = dict(zip(map(id, paths), np.asarray(_speeds(*block)), strict=True))
        for name, path in list(going.items()):
            profile = path.profile(squared[name], width, period)
            if profile is not None:
                found[name] = profile
            if profile is None or not path.slow_down(profile, width):
                del going[name]
        if not going:
            break
    return found
