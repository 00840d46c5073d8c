# SPDX-License-Identifier: MIT
"""Features of demonstrations and tasks, and how far two of them are apart (paper, `beta`)."""

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from hybrid_jax.kernels import components as co
from hybrid_jax.kernels import dualquat as dq


def features(poses: Float[Array, "point 8"]) -> Float[Array, "step 8"]:
    """`delta_i = D_{i-1}* D_n`, the goal as each pose but the last sees it (paper, eq. delta)."""
    return dq.mul(dq.conj(poses[:-1]), jnp.broadcast_to(poses[-1], poses[:-1].shape))


def beta(a: Float[Array, "8 *b"], b: Float[Array, "8 *b"], length: float = 0.3) -> Array:
    """Distance of features: weighted norm of the screw between them `[*b]` [m].

    The screw's translational part, `V^-1 t` of arXiv:1812.01537 (Appendix D), keeps what `t` has
    along the axis of a rotation by `2 h`, and stretches the rest by `h / sin(h)`.

    Args:
        a, b: features by components, unit dual quaternions; their shapes are broadcast.
        length: metres that count as one radian.
    """
    turn = co.quat_mul(b[:4], co.quat_conj(a[:4]))
    way = co.sub(co.position(b), co.position(a))
    sine_squared = co.dot(turn[1:], turn[1:])
    half = jnp.arctan2(jnp.sqrt(sine_squared), jnp.abs(turn[0]))
    small = sine_squared < 1e-10
    safe = jnp.where(small, 1.0, sine_squared)
    stretch = jnp.where(small, 1.0, half * half / safe)
    along = jnp.where(small, 0.0, jnp.square(co.dot(turn[1:], way)) / safe)
    square = stretch * co.dot(way, way) + (1 - stretch) * along + (2 * length * half) ** 2
    return jnp.sqrt(jnp.maximum(square, 1e-20))


def beta_euclidean(a: Float[Array, "8 *b"], b: Float[Array, "8 *b"], length: float = 0.3) -> Array:
    """The paper's distance: Euclidean on the eight components, over both signs."""
    del length
    apart, other = (sum(jnp.square(a[k] + sign * b[k]) for k in range(8)) for sign in (-1, 1))
    return jnp.sqrt(jnp.minimum(apart, other))


BETAS = {"screw": beta, "euclidean": beta_euclidean}
"""Distances by the name used in configurations; they take components first."""
