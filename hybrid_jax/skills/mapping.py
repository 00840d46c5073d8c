# SPDX-License-Identifier: MIT
"""Map a demonstrated skill to a new start and a new goal pose.

All maps work on dual quaternions, so they do not depend on the choice of the world frame. Pieces
of notation: `D` the demonstration, `D1'`, `Dn'` the new ends, `S = D1' D_1* D` the demonstration
carried to the new start, `G = Dn' D_n* D` to the new goal.
"""

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from hybrid_jax.kernels import dualquat as dq

LENGTH_SCALE = 0.1
"""Metres that count as one radian in the arc length of a path."""


def align_signs(poses: Float[Array, "point 8"]) -> Float[Array, "point 8"]:
    """Choose the signs of a path's dual quaternions so that they vary continuously."""
    same = jnp.sum(poses[1:, :4] * poses[:-1, :4], axis=-1) >= 0
    signs = jnp.cumprod(jnp.where(same, 1.0, -1.0))
    return poses * jnp.concatenate([jnp.ones(1), signs])[:, None]


def arc_phase(poses: Float[Array, "point 8"]) -> Float[Array, "point"]:
    """Share of the path's length passed at each point, from 0 to 1."""
    step = dq.log(dq.mul(dq.conj(poses[:-1]), poses[1:]))
    length = jnp.sqrt(
        jnp.sum(step[:, :3] ** 2, -1) / LENGTH_SCALE**2 + jnp.sum(step[:, 3:] ** 2, -1)
    )
    total = jnp.concatenate([jnp.zeros(1), jnp.cumsum(length)])
    return total / jnp.maximum(total[-1], 1e-9)


def _carry(anchor: Array, origin: Array, poses: Array) -> Array:
    """`anchor origin* poses` for every pose."""
    move = dq.mul(anchor, dq.conj(origin))
    return dq.mul(jnp.broadcast_to(move, poses.shape), poses)


def features(poses: Float[Array, "point 8"]) -> Float[Array, "step 8"]:
    """`delta_i = D_{i-1}* D_n`, the goal as each pose but the last sees it (paper, eq. delta)."""
    return dq.mul(dq.conj(poses[:-1]), jnp.broadcast_to(poses[-1], poses[:-1].shape))


def ugp_goal(poses: Array, start: Array, goal: Array) -> Float[Array, "point 8"]:
    """The literal feature `D'_{i-1} = D'_n delta_i*`: meets the goal, ignores the new start."""
    del start
    return _carry(goal, poses[-1], poses)


def ugp_blend(poses: Array, start: Array, goal: Array) -> Float[Array, "point 8"]:
    """The paper's line: straight from the new start to a quarter of the literal map, then on it."""
    mapped = ugp_goal(poses, start, goal)
    quarter = poses.shape[0] // 4
    lead = jnp.arange(quarter + 1) / quarter
    ends = (jnp.broadcast_to(p, (quarter + 1, 8)) for p in (start, mapped[quarter]))
    return mapped.at[: quarter + 1].set(dq.sclerp(*ends, lead))


def aligned(poses: Array, start: Array, goal: Array) -> Float[Array, "point 8"]:
    """Move the whole demonstration rigidly between its ends, then spread what is left over.

    Meets both ends, returns the demonstration on its own ends, and moves along with a rigid
    motion of both ends. The rest is spread by arc length, position and rotation apart.
    """
    move = dq.sclerp(
        dq.mul(start, dq.conj(poses[0])),
        dq.mul(goal, dq.conj(poses[-1])),
        jnp.float32(0.5).astype(poses.dtype),
    )
    moved = dq.mul(jnp.broadcast_to(move, poses.shape), poses)
    w = arc_phase(poses)[:, None]
    position = dq.position(moved)
    position = (
        position
        + (1 - w) * (dq.position(start) - position[0])
        + w * (dq.position(goal) - position[-1])
    )
    first, last = (
        dq.quat_log(dq.quat_mul(dq.quat_conj(moved[i, :4]), end[:4]))
        for i, end in ((0, start), (-1, goal))
    )
    between = dq.quat_log(dq.quat_mul(dq.quat_conj(dq.quat_exp(first)), dq.quat_exp(last)))
    rest = dq.quat_mul(
        jnp.broadcast_to(dq.quat_exp(first), (len(poses), 4)), dq.quat_exp(w * between)
    )
    return align_signs(dq.normalize(dq.from_parts(position, dq.quat_mul(moved[:, :4], rest))))


MAPS = {"aligned": aligned, "ugp_blend": ugp_blend, "ugp_goal": ugp_goal}
"""Maps by the name used in configurations."""


def resample(poses: Float[Array, "point 8"], count: int) -> Float[Array, "count 8"]:
    """`count` poses evenly spaced along the path's arc length, ScLERP in between."""
    phase = arc_phase(poses)
    wanted = jnp.linspace(0.0, 1.0, count)
    right = jnp.clip(jnp.searchsorted(phase, wanted, side="left"), 1, len(poses) - 1)
    span = phase[right] - phase[right - 1]
    s = jnp.where(span > 0, (wanted - phase[right - 1]) / jnp.where(span > 0, span, 1.0), 0.0)
    return align_signs(dq.sclerp(poses[right - 1], poses[right], jnp.clip(s, 0, 1)))


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
