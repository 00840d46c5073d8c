# SPDX-License-Identifier: MIT
"""Features of demonstrations and tasks, and the distance of two features (paper, `beta`)."""

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels import vec3


def features(poses: Float[Array, "point 8"]) -> Float[Array, "step 8"]:
    """Features `delta_i = D_{i-1}* D_n`: the goal seen from each pose but the last.

    Args:
        poses: `[point, 8]` unit dual quaternions.

    Returns:
        `[point - 1, 8]` unit dual quaternions (paper, eq. of `delta`).
    """
    return dq.mul(dq.conj(poses[:-1]), jnp.broadcast_to(poses[-1], poses[:-1].shape))


def beta(a: Float[Array, " 8 *a"], b: Float[Array, " 8 *b"], length: float = 0.3) -> Array:
    """Distance of features: the weighted norm of the screw between them [m].

    The screw's translational part, `V^-1 t` of arXiv:1812.01537 (Appendix D), keeps what `t` has
    along the axis of a rotation by `2 h`, and stretches the rest by `h / sin(h)`.

    Args:
        a, b: `[8, ...]` features as unit dual quaternions, components first; their shapes are
            broadcast.
        length: metres that count as one radian.

    Returns:
        `[...]` distances [m], the same for both signs of a feature.
    """
    turn = vec3.quat_mul(b[:4], vec3.quat_conj(a[:4]))
    offset = vec3.sub(vec3.position(b), vec3.position(a))
    sine_squared = vec3.dot(turn[1:], turn[1:])
    half = jnp.arctan2(jnp.sqrt(sine_squared), jnp.abs(turn[0]))
    # without a rotation there is no axis: `safe` keeps the branch that is not taken finite
    is_small = sine_squared < 1e-10
    safe = jnp.where(is_small, 1.0, sine_squared)
    stretch = jnp.where(is_small, 1.0, half * half / safe)
    axial = jnp.where(is_small, 0.0, jnp.square(vec3.dot(turn[1:], offset)) / safe)
    square = stretch * vec3.dot(offset, offset) + (1 - stretch) * axial + (2 * length * half) ** 2
    return jnp.sqrt(jnp.maximum(square, 1e-20))


def beta_euclidean(
    a: Float[Array, " 8 *a"], b: Float[Array, " 8 *b"], length: float = 0.3
) -> Array:
    """The paper's distance: Euclidean on the eight components, the smaller of both signs.

    It depends on the unit of length; here that is the metre.

    Args:
        a, b: `[8, ...]` features as unit dual quaternions, components first; their shapes are
            broadcast.
        length: not used; all distances in `BETAS` take it.

    Returns:
        `[...]` distances.
    """
    # a dual quaternion and its negative are the same pose
    del length
    minus, plus = (sum(jnp.square(a[k] + sign * b[k]) for k in range(8)) for sign in (-1, 1))
    return jnp.sqrt(jnp.minimum(minus, plus))


BETAS = {"screw": beta, "euclidean": beta_euclidean}
"""Distances by their names in configurations; all take the components first."""
