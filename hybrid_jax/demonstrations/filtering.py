# SPDX-License-Identifier: MIT
"""Filter a recording, and space its poses evenly, as a skill keeps them."""

import numpy as np

from hybrid_jax.demonstrations.demonstration import Demonstration
from hybrid_jax.kernels.pose_paths import resample
from hybrid_jax.runtime.kept_programs import kept
from hybrid_jax.workcell.poses import dual_quats

POINTS = 101
"""Number of poses that a skill keeps of a demonstration."""
CUTOFF = 4.0
"""Frequency [Hz] between a hand's motion and its tremor (8 to 12 Hz) or the sensor's noise."""
_SAMPLES = 512
"""Samples of every recording before it is spaced by arc length: so one trace serves all."""

_resample = kept(resample, static=("count",))


def continuous_signs(poses: np.ndarray) -> np.ndarray:
    """Poses whose quaternions do not jump to their negatives, which are the same rotations.

    Args:
        poses: `[sample, 7]` position [m] and unit quaternion.

    Returns:
        The same poses `[sample, 7]`; the sign of the first quaternion stays.
    """
    flips = np.sum(poses[1:, 3:] * poses[:-1, 3:], axis=1) < 0
    signs = np.concatenate([[1.0], np.cumprod(np.where(flips, -1.0, 1.0))])
    return np.concatenate([poses[:, :3], poses[:, 3:] * signs[:, None]], axis=1)


def low_pass(times: np.ndarray, poses: np.ndarray, cutoff: float = CUTOFF) -> np.ndarray:
    """Remove tremor without delay; both ends stay where they are.

    Args:
        times: `[sample]` increasing [s].
        poses: `[sample, 7]` position [m] and unit quaternion, signs continuous.
        cutoff: frequency above which motion is removed [Hz].

    Returns:
        `[512, 7]` position [m] and unit quaternion, evenly spaced in time.
    """
    even = np.linspace(times[0], times[-1], _SAMPLES)
    rate = (_SAMPLES - 1) / (times[-1] - times[0])
    poses = np.stack([np.interp(even, times, column) for column in poses.T], axis=1)
    if cutoff < rate / 2:  # a filter's frequency lies below half the rate of the samples
        # imported where it is needed: that takes longer than all the rest of a planner's start
        from scipy.signal import butter, sosfiltfilt

        smooth = sosfiltfilt(butter(2, cutoff, fs=rate, output="sos"), poses, axis=0)
        # the filter is free at the ends, where the hand was most careful: put them back
        w = np.linspace(0, 1, _SAMPLES)[:, None]
        poses = smooth + (1 - w) * (poses[0] - smooth[0]) + w * (poses[-1] - smooth[-1])
    poses[:, 3:] /= np.linalg.norm(poses[:, 3:], axis=1, keepdims=True)
    return poses


def clean(demo: Demonstration, points: int = POINTS) -> np.ndarray:
    """Poses of a demonstration without tremor, evenly spaced by arc length.

    Args:
        demo: with poses `[sample, 7]`.
        points: how many poses to return.

    Returns:
        `[points, 8]` unit dual quaternions with continuous signs.
    """
    smooth = low_pass(demo.times, continuous_signs(np.asarray(demo.poses, float)))
    return np.asarray(_resample(dual_quats(smooth), points))
