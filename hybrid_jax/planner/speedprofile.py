# SPDX-License-Identifier: MIT
"""Motion along a path in time: sampled from speeds on a grid, and its jumps of acceleration taken.

Controllers interpolate between the points of a trajectory by a cubic or a quintic. That gives back
the motion only where its acceleration has no jumps, and begins and ends at zero.
"""

from dataclasses import dataclass

import numpy as np

from hybrid_jax.errors import InputError

MOST_POINTS = 2_000_000
"""Of one trajectory: more are a mistake in the limits."""
LEAST_SAMPLES = 16
"""Of one motion, however short."""


@dataclass(frozen=True)
class SpeedProfile:
    """Samples of the motion along a path, evenly spaced in time, from rest to rest."""

    period: float
    """Time between two samples [s]."""
    place: np.ndarray
    """`[sample]` length of the path behind [rad]."""
    speed: np.ndarray
    """`[sample]` its first ..."""
    acceleration: np.ndarray
    """`[sample]` ... and second derivative."""

    @property
    def times(self) -> np.ndarray:
        """`[sample]` [s]."""
        return self.period * np.arange(len(self.place))

    @property
    def states(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Place, speed and acceleration of each sample."""
        return self.place, self.speed, self.acceleration

    def slowed(self, factor: float) -> "SpeedProfile":
        """The same motion in so many times the time."""
        return SpeedProfile(
            self.period * factor, self.place, self.speed / factor, self.acceleration / factor**2
        )

    def resampled(self, count: int) -> "SpeedProfile":
        """The same motion with so many samples; the acceleration grows evenly between two."""
        times = np.linspace(0.0, self.times[-1], count)
        part = np.clip((times / self.period).astype(int), 0, len(self.place) - 2)
        since = times - self.period * part
        place, speed, acceleration = (a[part] for a in self.states)
        jerk = np.diff(self.acceleration)[part] / self.period
        return SpeedProfile(
            times[1],
            place + speed * since + acceleration * since**2 / 2 + jerk * since**3 / 6,
            speed + acceleration * since + jerk * since**2 / 2,
            acceleration + jerk * since,
        )


def sample_speeds(grid: np.ndarray, speed: np.ndarray, period: float) -> SpeedProfile:
    """The motion with these speeds on a grid; in between, the acceleration is constant.

    Args:
        grid: `[point]` places along the path.
        speed: `[point]` there; zero at both ends alone.
        period: most time between two samples [s].

    Raises:
        InputError: the motion would take more than `MOST_POINTS` samples.
    """
    step = np.diff(grid)
    rate = (speed[1:] ** 2 - speed[:-1] ** 2) / (2 * step)
    ends = np.concatenate([[0.0], np.cumsum(2 * step / np.maximum(speed[1:] + speed[:-1], 1e-12))])
    if not ends[-1] / period < MOST_POINTS:
        raise InputError(
            f"a motion would last {ends[-1]:.3g} s, more than {MOST_POINTS} points {period:g} s "
            "apart: the velocity or acceleration limits of a joint are too small"
        )
    times = np.linspace(0.0, ends[-1], max(LEAST_SAMPLES, int(np.ceil(ends[-1] / period)) + 1))
    part = np.clip(np.searchsorted(ends, times, side="right") - 1, 0, len(step) - 1)
    since = times - ends[part]
    place = grid[part] + speed[part] * since + rate[part] * since**2 / 2
    found = speed[part] + rate[part] * since
    found[[0, -1]] = 0.0
    return SpeedProfile(times[1], np.clip(place, grid[0], grid[-1]), found, rate[part])


def rounded(profile: SpeedProfile, width: float) -> SpeedProfile:
    """The motion with its speed averaged over a time, which it lasts longer by.

    What was a jump of the acceleration becomes a ramp; at both ends the acceleration is zero.

    Args:
        profile: from `sample_speeds`.
        width: the time [s]; two periods at least.
    """
    count, period = max(2, int(round(width / profile.period))), profile.period
    weights = np.full(count + 1, 1 / count)
    weights[[0, -1]] /= 2  # the mean of what is linear between the samples
    speed = np.convolve(profile.speed, weights)
    before = np.pad(profile.speed, (count, 0))
    acceleration = (np.pad(profile.speed, (0, count)) - before) / (count * period)
    # exact for a speed that is a parabola between two samples
    ways = period * (speed[1:] + speed[:-1]) / 2
    ways += period**2 / 12 * (acceleration[:-1] - acceleration[1:])
    way = np.concatenate([[0.0], np.cumsum(ways)])
    stretch = (profile.place[-1] - profile.place[0]) / way[-1]
    place = np.minimum(profile.place[0] + way * stretch, profile.place[-1])
    return SpeedProfile(period, place, speed * stretch, acceleration * stretch)
