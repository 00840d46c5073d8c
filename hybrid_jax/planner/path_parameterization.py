# SPDX-License-Identifier: MIT
"""Fastest speeds along paths of any length (TOPP-RA), by programs of one size."""

import jax
import numpy as np

from hybrid_jax.kernels.toppra import controllable_speeds, greatest_speeds
from hybrid_jax.runtime.kept_programs import kept

BLOCK = 512
"""Number of points that one call takes; a path is one block or several."""


@kept
def _controllable(slope, bend, step, speed, rate, cap, after):
    """`controllable_speeds` of several paths: its arguments `[path, ...]`, to `[path, point]`."""
    return jax.vmap(controllable_speeds)(slope, bend, step, speed, rate, cap, after)


@kept
def _greatest(slope, bend, step, rate, controllable, here):
    """`greatest_speeds` of several paths: its arguments `[path, ...]`, to `[path, point]`."""
    return jax.vmap(greatest_speeds)(slope, bend, step, rate, controllable, here)


def fastest_speeds(
    slope: np.ndarray,
    bend: np.ndarray,
    step: np.ndarray,
    speed: np.ndarray,
    rate: np.ndarray,
    cap: np.ndarray,
) -> np.ndarray:
    """Squared speeds along several paths, from rest to rest, on the host.

    Args:
        slope, bend, speed, rate: `[path, point, joint]`, as for `controllable_speeds`.
        step, cap: `[path, point]`, as for `controllable_speeds`; a path ends where `step` is zero.

    Returns:
        `[path, point]` squared speed of the path's parameter [1/s^2].
    """
    count, size = step.shape
    blocks = max(1, -(-(size - 1) // BLOCK))
    full = blocks * BLOCK + 1  # neighbours share a point
    slope, bend, step, speed, rate, cap = (
        np.concatenate([a, a[:, -1:].repeat(full - size, axis=1)], axis=1)
        for a in (slope, bend, step, speed, rate, cap)
    )
    controllable, squared = np.zeros((2, count, full), np.float32)
    spans = [slice(k * BLOCK, (k + 1) * BLOCK + 1) for k in range(blocks)]
    for span in reversed(spans):
        limits = (a[:, span] for a in (slope, bend, step, speed, rate, cap))
        controllable[:, span] = _controllable(*limits, controllable[:, span.stop - 1])
    for span in spans:
        rows = (a[:, span] for a in (slope, bend, step, rate, controllable))
        squared[:, span] = _greatest(*rows, squared[:, span.start])
    return squared[:, :size]
