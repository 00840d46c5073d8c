# SPDX-License-Identifier: MIT
"""Paths of poses: continuous signs, arc length, even spacing. Poses are unit dual quaternions."""

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from hybrid_jax.kernels import dualquat as dq

LENGTH_SCALE = 0.1
"""Metres that count as one radian in the arc length of a path."""


def align_signs(poses: Float[Array, "point 8"]) -> Float[Array, "point 8"]:
    """Choose the signs of a path's dual quaternions so that they vary continuously.

    Args:
        poses: `[point, 8]` unit dual quaternions of any signs.

    Returns:
        `[point, 8]` the same poses; the first one keeps its sign.
    """
    # q and -q are one pose: a negative product of neighbours is a jump to the other cover
    aligned = jnp.sum(poses[1:, :4] * poses[:-1, :4], axis=-1) >= 0
    signs = jnp.cumprod(jnp.where(aligned, 1.0, -1.0))
    return poses * jnp.concatenate([jnp.ones(1), signs])[:, None]


def arc_phase(poses: Float[Array, "point 8"]) -> Float[Array, " point"]:
    """Share of a path's length that is passed at each point, from 0 to 1.

    Args:
        poses: `[point, 8]` unit dual quaternions.

    Returns:
        `[point]` shares; a radian of rotation counts as `LENGTH_SCALE` metres.
    """
    step = dq.log(dq.mul(dq.conj(poses[:-1]), poses[1:]))
    length = jnp.sqrt(
        jnp.sum(step[:, :3] ** 2, -1) / LENGTH_SCALE**2 + jnp.sum(step[:, 3:] ** 2, -1)
    )
    total = jnp.concatenate([jnp.zeros(1), jnp.cumsum(length)])
    return total / jnp.maximum(total[-1], 1e-9)


def resample(poses: Float[Array, "point 8"], count: int) -> Float[Array, "count 8"]:
    """Space poses evenly along a path's arc length, by ScLERP between its points.

    Args:
        poses: `[point, 8]` unit dual quaternions, at least two.
        count: poses to return.

    Returns:
        `[count, 8]` poses with continuous signs; the first and last are those of the path.
    """
    phase = arc_phase(poses)
    targets = jnp.linspace(0.0, 1.0, count)
    upper = jnp.clip(jnp.searchsorted(phase, targets, side="left"), 1, len(poses) - 1)
    # a repeated pose spans no length: the first of the two is taken
    span = phase[upper] - phase[upper - 1]
    s = jnp.where(span > 0, (targets - phase[upper - 1]) / jnp.where(span > 0, span, 1.0), 0.0)
    return align_signs(dq.sclerp(poses[upper - 1], poses[upper], jnp.clip(s, 0, 1)))
