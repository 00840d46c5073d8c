# SPDX-License-Identifier: MIT
"""Motion along a path in time, sampled from speeds on a grid and without jumps of acceleration.

Controllers interpolate between the points of a trajectory by a cubic or a quintic. That reproduces
the motion only if its acceleration has no jumps and is zero at both ends.
"""

from dataclasses import dataclass

import numpy as np

from hybrid_jax.errors import InputError

MOST_POINTS = 2_000_000
"""Largest number of samples of a motion: more mean a mistake in the limits."""
LEAST_SAMPLES = 16
"""Smallest number of samples of a motion, however short."""


@dataclass(frozen=True)
class SpeedProfile:
    """Samples of the motion along a path, evenly spaced in time, from rest to rest."""

    period: float
    """Time between two samples [s]."""
    place: np.ndarray
    """`[sample]` length of the path up to there [rad]."""
    speed: np.ndarray
    """`[sample]` speed along the path [rad/s]."""
    acceleration: np.ndarray
    """`[sample]` acceleration along the path [rad/s^2]."""

    @property
    def times(self) -> np.ndarray:
        """Time of each sample, from the start: `[sample]` [s]."""
        return self.period * np.arange(len(self.place))

    @property
    def states(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Place, speed and acceleration of the samples, each `[sample]`."""
        return self.place, self.speed, self.acceleration

    def slowed(self, factor: float) -> "SpeedProfile":
        """The same motion, lasting `factor` times as long."""
        return SpeedProfile(
            self.period * factor, self.place, self.speed / factor, self.acceleration / factor**2
        )

    def resampled(self, count: int) -> "SpeedProfile":
        """The same motion with `count` samples; between two, the acceleration is linear in time."""
        times = np.linspace(0.0, self.times[-1], count)
        interval = np.clip((times / self.period).astype(int), 0, len(self.place) - 2)
        elapsed = times - self.period * interval
        place, speed, acceleration = (a[interval] for a in self.states)
        jerk = np.diff(self.acceleration)[interval] / self.period
        return SpeedProfile(
            times[1],
            place + speed * elapsed + acceleration * elapsed**2 / 2 + jerk * elapsed**3 / 6,
            speed + acceleration * elapsed + jerk * elapsed**2 / 2,
            acceleration + jerk * elapsed,
        )


def sample_speeds(grid: np.ndarray, speed: np.ndarray, period: float) -> SpeedProfile:
    """The motion with given speeds on a grid; in between, the acceleration is constant.

    Args:
        grid: `[point]` places along the path [rad].
        speed: `[point]` speeds there [rad/s]; zero at both ends only.
        period: largest time between two samples [s].

    Returns:
        Samples, evenly spaced in time.

    Raises:
        InputError: the motion would take more than `MOST_POINTS` samples.
    """
    step = np.diff(grid)
    # v^2 changes by 2 a s where the acceleration a is constant over a step s
    rate = (speed[1:] ** 2 - speed[:-1] ** 2) / (2 * step)
    arrival = np.concatenate(
        [[0.0], np.cumsum(2 * step / np.maximum(speed[1:] + speed[:-1], 1e-12))]
    )
    if not arrival[-1] / period < MOST_POINTS:
        raise InputError(
            f"a motion would last {arrival[-1]:.3g} s, more than {MOST_POINTS} points {period:g} s "
            "apart: the velocity or acceleration limits of a joint are too small"
        )
    times = np.linspace(
        0.0, arrival[-1], max(LEAST_SAMPLES, int(np.ceil(arrival[-1] / period)) + 1)
    )
    interval = np.clip(np.searchsorted(arrival, times, side="right") - 1, 0, len(step) - 1)
    elapsed = times - arrival[interval]
    place = grid[interval] + speed[interval] * elapsed + rate[interval] * elapsed**2 / 2
    speeds = speed[interval] + rate[interval] * elapsed
    speeds[[0, -1]] = 0.0
    return SpeedProfile(times[1], np.clip(place, grid[0], grid[-1]), speeds, rate[interval])


def rounded(profile: SpeedProfile, width: float) -> SpeedProfile:
    """The motion with its speed averaged over a time, and longer by that time.

    Jumps of the acceleration become ramps, and the acceleration is zero at both ends.

    Args:
        profile: from `sample_speeds`.
        width: time over which the speed is averaged [s]; raised to two periods if it is less.

    Returns:
        Samples with the same period.
    """
    count, period = max(2, int(round(width / profile.period))), profile.period
    weights = np.full(count + 1, 1 / count)
    weights[[0, -1]] /= 2  # the mean of what is linear between the samples
    speed = np.convolve(profile.speed, weights)
    delayed = np.pad(profile.speed, (count, 0))
    acceleration = (np.pad(profile.speed, (0, count)) - delayed) / (count * period)
    # exact for a speed that is a parabola between two samples
    increments = period * (speed[1:] + speed[:-1]) / 2
    increments += period**2 / 12 * (acceleration[:-1] - acceleration[1:])
    travelled = np.concatenate([[0.0], np.cumsum(increments)])
    stretch = (profile.place[-1] - profile.place[0]) / travelled[-1]
    place = np.minimum(profile.place[0] + travelled * stretch, profile.place[-1])
    return SpeedProfile(period, place, speed * stretch, acceleration * stretch)
