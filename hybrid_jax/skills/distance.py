# SPDX-License-Identifier: MIT
"""Features of demonstrations and tasks, and how far two of them are apart (paper, `beta`)."""

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from hybrid_jax.kernels import dualquat as dq


def features(poses: Float[Array, "point 8"]) -> Float[Array, "step 8"]:
    """`delta_i = D_{i-1}* D_n`, the goal as each pose but the last sees it (paper, eq. delta)."""
    return dq.mul(dq.conj(poses[:-1]), jnp.broadcast_to(poses[-1], poses[:-1].shape))


def beta(a: Float[Array, "8"], b: Float[Array, "8"], length: float = 0.3) -> Float[Array, ""]:
    """Distance of two features: weighted norm of the screw between them [m].

    Args:
        a, b: features, unit dual quaternions.
        length: metres that count as one radian.
    """
    twist = dq.log(dq.mul(dq.conj(a), b))
    sq = jnp.sum(twist[:3] ** 2) + length**2 * jnp.sum(twist[3:] ** 2)
    return jnp.sqrt(jnp.maximum(sq, 1e-20))


def beta_euclidean(a: Float[Array, "8"], b: Float[Array, "8"], length: float = 0.3) -> Array:
    """The paper's distance: Euclidean on the eight components, over both signs."""
    del length
    return jnp.minimum(jnp.linalg.norm(a - b), jnp.linalg.norm(a + b))


BETAS = {"screw": beta, "euclidean": beta_euclidean}
"""Distances by the name used in configurations."""
