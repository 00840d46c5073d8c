# SPDX-License-Identifier: MIT
"""From a recording to the even path of poses that a skill keeps."""

import jax
import jax.numpy as jnp
import numpy as np
from scipy.signal import butter, sosfiltfilt

from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.skills.demonstration import Demonstration
from hybrid_jax.skills.mapping import resample

POINTS = 101
"""Poses that a skill keeps of a demonstration."""
CUTOFF = 4.0
"""Hand motion lies below this frequency [Hz], tremor (8 to 12 Hz) and sensor noise above."""
_SAMPLES = 512
"""Samples that a recording is brought to before it is spaced by arc length: one trace for all."""

_resample = jax.jit(resample, static_argnames="count")


def continuous_signs(poses: np.ndarray) -> np.ndarray:
    """Poses `[sample, 7]` whose quaternions do not jump to their negative."""
    flips = np.sum(poses[1:, 3:] * poses[:-1, 3:], axis=1) < 0
    signs = np.concatenate([[1.0], np.cumprod(np.where(flips, -1.0, 1.0))])
    return np.concatenate([poses[:, :3], poses[:, 3:] * signs[:, None]], axis=1)


def low_pass(times: np.ndarray, poses: np.ndarray, cutoff: float = CUTOFF) -> np.ndarray:
    """Remove tremor without delay; both ends stay where they are.

    Args:
        times: `[sample]` [s].
        poses: `[sample, 7]`, signs continuous.
        cutoff: frequency from which motion is taken away [Hz].

    Returns:
        `[512, 7]`, evenly spaced in time.
    """
    even = np.linspace(times[0], times[-1], _SAMPLES)
    rate = (_SAMPLES - 1) / (times[-1] - times[0])
    poses = np.stack([np.interp(even, times, column) for column in poses.T], axis=1)
    if cutoff < rate / 2:
        smooth = sosfiltfilt(butter(2, cutoff, fs=rate, output="sos"), poses, axis=0)
        # the filter is free at the ends, where the hand was most careful: put them back
        w = np.linspace(0, 1, _SAMPLES)[:, None]
        poses = smooth + (1 - w) * (poses[0] - smooth[0]) + w * (poses[-1] - smooth[-1])
    poses[:, 3:] /= np.linalg.norm(poses[:, 3:], axis=1, keepdims=True)
    return poses


def to_dual(poses: np.ndarray) -> np.ndarray:
    """`[n, 7]` positions and quaternions to unit dual quaternions `[n, 8]`, float32."""
    rows = jnp.asarray(poses, jnp.float32)
    return np.asarray(dq.from_parts(rows[:, :3], rows[:, 3:]))


def clean(demo: Demonstration, points: int = POINTS) -> np.ndarray:
    """Continuous signs, tremor removed, evenly spaced by arc length; `[points, 8]`."""
    smooth = low_pass(demo.times, continuous_signs(np.asarray(demo.poses, float)))
    return np.asarray(_resample(jnp.asarray(to_dual(smooth)), points))
