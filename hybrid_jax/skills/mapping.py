# SPDX-License-Identifier: MIT
"""Map a demonstrated skill to a new start and a new goal pose.

All maps work on dual quaternions, so they do not depend on the choice of the world frame. Pieces
of notation: `D` the demonstration, `D1'`, `Dn'` the new ends, `S = D1' D_1* D` the demonstration
carried to the new start, `G = Dn' D_n* D` to the new goal.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from hybrid_jax.kernels import dualquat as dq

LENGTH_SCALE = 0.1
"""Metres that count as one radian in the arc length of a path."""


LATE = 0.75
"""Share of the way from which on `late_exact` repeats the demonstration."""


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


def _pure(vector: Float[Array, "3"]) -> Float[Array, "4"]:
    """The quaternion without a real part."""
    return jnp.concatenate([jnp.zeros_like(vector[:1]), vector])


def _midpoint(a: Float[Array, "8"], b: Float[Array, "8"]) -> Float[Array, "8"]:
    """Half way along the shorter screw from a to b: linear blending is exact there."""
    near = jnp.where(jnp.sum(a[:4] * b[:4]) < 0, -b, b)
    return dq.normalize(a + near)


def _residual(have: Float[Array, "4"], want: Float[Array, "4"]) -> Float[Array, "4"]:
    """Rotation that turns `have` into `want` from the right, the shorter way."""
    q = dq.quat_mul(dq.quat_conj(have), want)
    return jnp.where(q[0] < 0, -q, q)


def _between(first: Float[Array, "4"], last: Float[Array, "4"]) -> tuple[Array, Array]:
    """Half the angle from one rotation to another, and its axis as a pure quaternion."""
    turn = _residual(first, last)
    size = jnp.sqrt(jnp.maximum(jnp.sum(turn[1:] ** 2), jnp.finfo(turn.dtype).tiny))
    return jnp.arctan2(size, turn[0]), _pure(turn[1:] / size)


_UNIT_ROWS = np.array([[0, 1, 2, 3], [1, 0, 3, 2], [2, 3, 0, 1], [3, 2, 1, 0]], np.int32)
_UNIT_SIGNS = np.array([[1, 1, 1, 1], [-1, 1, -1, 1], [-1, 1, 1, -1], [-1, -1, 1, 1]])
"""Component and sign of `e_k q`, a row for each unit quaternion `e_k`."""


def _product_matrix(left: Float[Array, "4"], right: Float[Array, "4"]) -> Float[Array, "4 4"]:
    """Rows k: the product `left e_k right`, so that `x @ m` is `left x right`."""
    rows = right[_UNIT_ROWS] * jnp.asarray(_UNIT_SIGNS, right.dtype)
    return dq.quat_mul(jnp.broadcast_to(left, (4, 4)), rows)


def _combine(terms: Float[Array, "point k"], matrix: Float[Array, "k 8"]) -> Array:
    """`terms @ matrix`, spelled out: batched products of small matrices are slow on a CPU."""
    return sum(terms[:, k, None] * matrix[k] for k in range(matrix.shape[0]))


def _coefficients(
    turn: Float[Array, "4"], h: Float[Array, "4"], offset: Float[Array, "4"], drift: Array
) -> Float[Array, "12 8"]:
    """Matrix from (dual, real, s real) of a demonstration to `turn D h`, then moved.

    Args:
        turn, h: what multiplies the demonstration from the left and the right.
        offset, drift: it is moved by `offset + s drift`, pure quaternions [m].
    """
    real = _product_matrix(turn, h)
    moved = (dq.quat_mul(jnp.broadcast_to(0.5 * t, (4, 4)), real) for t in (offset, drift))
    none = jnp.zeros_like(real)
    return jnp.concatenate(
        [jnp.concatenate([none, real, none]), jnp.concatenate([real, *moved])], axis=1
    )


def aligned(poses: Array, start: Array, goal: Array) -> Float[Array, "point 8"]:
    """Move the whole demonstration rigidly between its ends, then spread what is left over.

    Meets both ends, returns the demonstration on its own ends, and moves along with a rigid
    motion of both ends. The rest is spread by arc length s, position and rotation apart:

    `E = T D`, `T` half way between `D1' D1*` and `Dn' Dn*`;
    position `p(E) + (1 - s) (p1' - p(E1)) + s (pn' - p(En))`;
    rotation `q(E) slerp(q(E1)* q1', q(En)* qn'; s)`.

    The slerp is `cos(s h) f + sin(s h) g`, so every component of the result is linear in those of
    the demonstration: one small matrix a pair of ends, applied to all points.
    """
    poses = align_signs(poses)
    move = _midpoint(dq.mul(start, dq.conj(poses[0])), dq.mul(goal, dq.conj(poses[-1])))
    return _spread(poses, start, goal, move, arc_phase(poses))


def late_exact(poses: Array, start: Array, goal: Array) -> Float[Array, "point 8"]:
    """Like `aligned`, but the last quarter of the way is the demonstration's, seen from the goal.

    So an approach from above stays one. The demonstration is carried to the goal, and what is left
    over at the start is spread over the first three quarters.
    """
    poses = align_signs(poses)
    move = dq.mul(goal, dq.conj(poses[-1]))
    return _spread(poses, start, goal, move, jnp.minimum(1.0, arc_phase(poses) / LATE))


def _spread(poses: Array, start: Array, goal: Array, move: Array, s: Array) -> Array:
    """`move` applied to a demonstration, and what is left over at its ends spread by `s`."""
    here, first, last = move[:4], dq.mul(move, poses[0]), dq.mul(move, poses[-1])
    f = _residual(first[:4], start[:4])
    half, axis = _between(f, _residual(last[:4], goal[:4]))
    offset, last_offset = (
        _pure(dq.position(want) - dq.quat_rotate(here, dq.position(demo)))
        for want, demo in ((start, poses[0]), (goal, poses[-1]))
    )
    s = s[:, None]
    terms = jnp.concatenate([poses[:, 4:], poses[:, :4], s * poses[:, :4]], axis=1)
    waves = ((jnp.cos(s * half), f), (jnp.sin(s * half), dq.quat_mul(f, axis)))
    return sum(
        wave * _combine(terms, _coefficients(here, h, offset, last_offset - offset))
        for wave, h in waves
    )


MAPS = {"aligned": aligned, "late_exact": late_exact, "ugp_blend": ugp_blend, "ugp_goal": ugp_goal}
"""Maps by the name used in configurations."""


def resample(poses: Float[Array, "point 8"], count: int) -> Float[Array, "count 8"]:
    """`count` poses evenly spaced along the path's arc length, ScLERP in between."""
    phase = arc_phase(poses)
    wanted = jnp.linspace(0.0, 1.0, count)
    right = jnp.clip(jnp.searchsorted(phase, wanted, side="left"), 1, len(poses) - 1)
    span = phase[right] - phase[right - 1]
    s = jnp.where(span > 0, (wanted - phase[right - 1]) / jnp.where(span > 0, span, 1.0), 0.0)
    return align_signs(dq.sclerp(poses[right - 1], poses[right], jnp.clip(s, 0, 1)))


def map_skills(
    skills: Float[Array, "skill point 8"],
    starts: Float[Array, "segment 8"],
    goals: Float[Array, "segment 8"],
    mapping: str = "aligned",
) -> Float[Array, "skill segment point 8"]:
    """Map every skill to every segment's start and goal."""
    one_skill = jax.vmap(MAPS[mapping], (None, 0, 0))
    return jax.vmap(one_skill, (0, None, None))(skills, starts, goals)
