# SPDX-License-Identifier: MIT
"""Unit dual quaternions: the one representation of rigid poses between stages.

A pose is `[..., 8]`: real part `(w, x, y, z)` (rotation), then dual part `t r / 2` (metres), as in
the paper's section "Dual Quaternion". `q` and `-q` are the same pose: compare poses, not
components. All functions take equal leading axes `*b`.

Near the identity, where sines over angles are 0 / 0, series take over. Both branches of such a
`jnp.where` are finite: the gradient of the one not taken would be NaN otherwise.
"""

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

IDENTITY = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_SERIES = 0.01
"""Squared angle below which differences that cancel are written as series [rad^2]."""


def quat_mul(a: Float[Array, "*#b 4"], b: Float[Array, "*#b 4"]) -> Float[Array, "*b 4"]:
    """Hamilton product `[*b, 4]` of two quaternions `(w, x, y, z)`."""
    aw, ax, ay, az = (a[..., i] for i in range(4))
    bw, bx, by, bz = (b[..., i] for i in range(4))
    return jnp.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=-1,
    )


def quat_conj(q: Float[Array, "*b 4"]) -> Float[Array, "*b 4"]:
    """Conjugate `[*b, 4]`: the inverse of a unit quaternion."""
    return q * jnp.array([1.0, -1.0, -1.0, -1.0], q.dtype)


def quat_rotate(q: Float[Array, "*#b 4"], v: Float[Array, "*#b 3"]) -> Float[Array, "*b 3"]:
    """Vectors `[*b, 3]`, of any unit, rotated by unit quaternions `[*b, 4]`."""
    w, u = q[..., :1], q[..., 1:]
    t = 2 * jnp.cross(u, v)
    return v + w * t + jnp.cross(u, t)


def quat_matrix(q: Float[Array, "*b 4"]) -> Float[Array, "*b 3 3"]:
    """Rotation matrix `[*b, 3, 3]` of a unit quaternion; its columns are the rotated axes."""
    w, x, y, z = (q[..., i] for i in range(4))
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)


def quat_exp(rotation: Float[Array, "*b 3"]) -> Float[Array, "*b 4"]:
    """Unit quaternion `[*b, 4]` of a rotation vector `[*b, 3]` [rad]."""
    sq = jnp.sum(rotation * rotation, axis=-1, keepdims=True)
    # below this the first term left out, of order sq^2, is smaller than the rounding error
    is_small = sq < jnp.finfo(rotation.dtype).eps ** 0.5
    angle = jnp.sqrt(jnp.where(is_small, 1.0, sq))
    scale = jnp.where(is_small, 0.5 - sq / 48, jnp.sin(angle / 2) / angle)
    return jnp.concatenate(
        [jnp.where(is_small, 1 - sq / 8, jnp.cos(angle / 2)), scale * rotation], -1
    )


def quat_log(q: Float[Array, "*b 4"]) -> Float[Array, "*b 3"]:
    """Rotation vector `[*b, 3]` [rad] of a unit quaternion; inverse of `quat_exp`.

    Along the shorter arc: the angle is at most pi.
    """
    q = jnp.where(q[..., :1] < 0, -q, q)
    w, u = q[..., :1], q[..., 1:]
    sq = jnp.sum(u * u, axis=-1, keepdims=True)
    is_small = sq < jnp.finfo(q.dtype).eps ** 0.5
    # atan2: near the identity acos(w) loses half of the digits
    norm = jnp.sqrt(jnp.where(is_small, 1.0, sq))
    scale = jnp.where(is_small, (2 - 2 * sq / (3 * w * w)) / w, 2 * jnp.arctan2(norm, w) / norm)
    return scale * u


def from_parts(
    position: Float[Array, "*#b 3"], quat: Float[Array, "*#b 4"]
) -> Float[Array, "*b 8"]:
    """Pose `[*b, 8]` from a position [m] and a unit quaternion (paper, eq. `r + eps t r / 2`)."""
    pure = jnp.concatenate([jnp.zeros_like(position[..., :1]), position], axis=-1)
    return jnp.concatenate([quat, 0.5 * quat_mul(pure, quat)], axis=-1)


def position(q: Float[Array, "*b 8"]) -> Float[Array, "*b 3"]:
    """Translation `[*b, 3]` [m] of a pose: `2 d r*`."""
    return 2 * quat_mul(q[..., 4:], quat_conj(q[..., :4]))[..., 1:]


def to_matrix(q: Float[Array, "*b 8"]) -> Float[Array, "*b 4 4"]:
    """Homogeneous matrix `[*b, 4, 4]` of a pose, its translation in metres."""
    top = jnp.concatenate([quat_matrix(q[..., :4]), position(q)[..., None]], axis=-1)
    bottom = jnp.broadcast_to(jnp.array([0.0, 0.0, 0.0, 1.0], q.dtype), (*q.shape[:-1], 1, 4))
    return jnp.concatenate([top, bottom], axis=-2)


def mul(a: Float[Array, "*#b 8"], b: Float[Array, "*#b 8"]) -> Float[Array, "*b 8"]:
    """Composition `[*b, 8]`: the matrix of the product is the product of the matrices."""
    real = quat_mul(a[..., :4], b[..., :4])
    dual = quat_mul(a[..., :4], b[..., 4:]) + quat_mul(a[..., 4:], b[..., :4])
    return jnp.concatenate([real, dual], axis=-1)


def conj(q: Float[Array, "*b 8"]) -> Float[Array, "*b 8"]:
    """Inverse `[*b, 8]` of a unit dual quaternion: the quaternion conjugate of both parts."""
    return q * jnp.array([1.0, -1.0, -1.0, -1.0, 1.0, -1.0, -1.0, -1.0], q.dtype)


def normalize(q: Float[Array, "*b 8"]) -> Float[Array, "*b 8"]:
    """Nearest unit dual quaternion `[*b, 8]`: `|r| = 1` and `r . d = 0`."""
    norm = jnp.linalg.norm(q[..., :4], axis=-1, keepdims=True)
    real, dual = q[..., :4] / norm, q[..., 4:] / norm
    return jnp.concatenate([real, dual - jnp.sum(real * dual, -1, keepdims=True) * real], -1)


def act(q: Float[Array, "*#b 8"], point: Float[Array, "*#b 3"]) -> Float[Array, "*b 3"]:
    """Points `[*b, 3]` [m] moved by poses `[*b, 8]`: rotation, then translation."""
    return quat_rotate(q[..., :4], point) + position(q)


def exp(twist: Float[Array, "*b 6"]) -> Float[Array, "*b 8"]:
    """Pose reached by following a constant twist for unit time.

    Args:
        twist: `[*b, 6]` `(v, w)`, linear part [m], then rotation vector [rad], in the base frame.

    Returns:
        `[*b, 8]` unit dual quaternion.

    Reference: Solà, Deray, Atchuthan, "A micro Lie theory", arXiv:1812.01537, Appendix D.
    """
    v, w = twist[..., :3], twist[..., 3:]
    sq = jnp.sum(w * w, axis=-1, keepdims=True)
    is_small = sq < jnp.finfo(twist.dtype).eps ** 0.5
    sq_safe = jnp.where(is_small, 1.0, sq)
    angle = jnp.sqrt(sq_safe)
    half_sinc = jnp.where(is_small, 0.5 - sq / 48, jnp.sin(angle / 2) / angle)
    cos_half = jnp.where(is_small, 1 - sq / 8, jnp.cos(angle / 2))
    b = 2 * half_sinc * half_sinc
    # (angle - sin angle) / angle^3, its series where it cancels
    series = 1 / 6 - sq * (1 / 120 - sq * (1 / 5040 - sq / 362880))
    c = jnp.where(sq < _SERIES, series, (1 - 2 * half_sinc * cos_half) / sq_safe)
    wv = jnp.cross(w, v)
    translation = v + b * wv + c * jnp.cross(w, wv)
    return from_parts(translation, jnp.concatenate([cos_half, half_sinc * w], axis=-1))


def log(q: Float[Array, "*b 8"]) -> Float[Array, "*b 6"]:
    """Twist `[*b, 6]` `(v [m], w [rad])` whose `exp` is the pose, along the shorter rotation.

    Reference: the inverse of `exp`; `V^-1` as in arXiv:1812.01537, Appendix D.
    """
    w = quat_log(q[..., :4])
    translation = position(q)
    sq = jnp.sum(w * w, axis=-1, keepdims=True)
    is_small = sq < _SERIES
    sq_safe = jnp.where(is_small, 1.0, sq)
    half = jnp.sqrt(sq_safe) / 2
    series = 1 / 12 + sq * (1 / 720 + sq * (1 / 30240 + sq / 1209600))
    d = jnp.where(is_small, series, (1 - half / jnp.tan(half)) / sq_safe)
    wt = jnp.cross(w, translation)
    return jnp.concatenate([translation - 0.5 * wt + d * jnp.cross(w, wt), w], axis=-1)


def sclerp(a: Float[Array, "*#b 8"], b: Float[Array, "*#b 8"], s: Float[Array, "*#b"]):
    """Screw linear interpolation (ScLERP) `a (a* b)^s`, along the shorter arc.

    Args:
        a, b: `[*b, 8]` poses at the ends.
        s: `[*b]` share of the screw, from 0 at a to 1 at b.

    Returns:
        `[*b, 8]` unit dual quaternions.
    """
    return mul(a, exp(s[..., None] * log(mul(conj(a), b))))
