# SPDX-License-Identifier: MIT
"""Vectors, quaternions and matrices by components: `x`, `y`, `z` are arrays of one shape.

With the batch as the last axis of every component, each operation is one long contiguous loop,
which XLA's CPU back end runs some thirty times faster than the same arithmetic on short vectors.
A vector is anything whose items are its components: a tuple, or an array with them in front. All
components `[...]` broadcast against each other; results are tuples of components.
"""

from typing import Any

import jax.numpy as jnp

Vector = Any
"""Items are components: a tuple of arrays, or an array with the components in front."""


def dot(a, b):
    """Inner product `[...]` of two vectors of three components."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def add(a, b):
    """Sum of two vectors, three components."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def sub(a, b):
    """Difference of two vectors, three components."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def scale(a, factor):
    """Vector times scalar `[...]`, three components."""
    return (a[0] * factor, a[1] * factor, a[2] * factor)


def cross(a, b):
    """Vector product, three components."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def quat_mul(a, b):
    """Hamilton product of two quaternions `(w, x, y, z)`, four components."""
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


def quat_conj(q):
    """Conjugate of a quaternion, four components: the inverse of a unit one."""
    return (q[0], *scale(q[1:], -1.0))


def position(pose):
    """Position of a unit dual quaternion of eight components: three components [m]."""
    return scale(quat_mul(pose[4:], quat_conj(pose[:4]))[1:], 2.0)


def quat_rotate(q, v):
    """Vector `v` turned by the unit quaternion `q`, three components."""
    # v + 2 w (u x v) + 2 u x (u x v) with q = (w, u)
    twist = scale(cross(q[1:], v), 2.0)
    return add(add(v, scale(twist, q[0])), cross(q[1:], twist))


def quat_matrix(q):
    """Rotation matrix of a unit quaternion: `m[i][j]` `[...]` is component i of axis j."""
    w, x, y, z = q
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def turn(m, v):
    """Matrix `m[i][j]` times vector, three components."""
    return tuple(dot(m[i], v) for i in range(3))


def turn_back(m, v):
    """Transposed matrix times vector: `v` in the frame whose axes are the columns of `m`.

    Returns:
        Three components `[...]`.
    """
    return tuple(m[0][j] * v[0] + m[1][j] * v[1] + m[2][j] * v[2] for j in range(3))


def stack(m):
    """Nested tuples of components `[...]` as one array with them in front: `[3, 3, ...]`, say."""
    return jnp.stack([stack(row) if isinstance(row, tuple | list) else row for row in m])
