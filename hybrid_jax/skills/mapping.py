# SPDX-License-Identifier: MIT
"""Map a demonstrated skill to a new start and a new goal pose.

All maps work on dual quaternions, so they do not depend on the choice of the world frame. Notation:
`D` is the demonstration, `D1'` and `Dn'` are the new start and goal, `*` is the conjugate, and a
prime marks what is mapped.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels.pose_paths import align_signs, arc_phase

LATE = 0.75
"""Share of the path's length from which on `late_exact` repeats the demonstration."""


def _carry(anchor: Array, origin: Array, poses: Array) -> Array:
    """`anchor origin* poses`: the poses `[point, 8]`, moved rigidly with `origin` onto `anchor`."""
    move = dq.mul(anchor, dq.conj(origin))
    return dq.mul(jnp.broadcast_to(move, poses.shape), poses)


def ugp_goal(poses: Array, start: Array, goal: Array) -> Float[Array, "point 8"]:
    """The paper's feature taken literally, `D'_{i-1} = D'_n delta_i*`.

    It meets the goal and ignores the new start.

    Args:
        poses: `[point, 8]` of the demonstration.
        start, goal: `[8]` new end poses.
    """
    del start
    return _carry(goal, poses[-1], poses)


def ugp_blend(poses: Array, start: Array, goal: Array) -> Float[Array, "point 8"]:
    """The literal map with another first quarter: one screw from the new start to its point n/4.

    The map meets both ends. It is the map of the preset `paper`.

    Args:
        poses: `[point, 8]` of the demonstration.
        start, goal: `[8]` new end poses.
    """
    mapped = ugp_goal(poses, start, goal)
    quarter = poses.shape[0] // 4
    lead = jnp.arange(quarter + 1) / quarter
    first, last = (jnp.broadcast_to(p, (quarter + 1, 8)) for p in (start, mapped[quarter]))
    return mapped.at[: quarter + 1].set(dq.sclerp(first, last, lead))


def _pure(vector: Float[Array, "3"]) -> Float[Array, "4"]:
    """The vector as a quaternion without a real part."""
    return jnp.concatenate([jnp.zeros_like(vector[:1]), vector])


def _midpoint(a: Float[Array, "8"], b: Float[Array, "8"]) -> Float[Array, "8"]:
    """Pose half way along the shorter screw from a to b."""
    # half way, the normalised sum of both poses is exactly on the screw
    nearer = jnp.where(jnp.sum(a[:4] * b[:4]) < 0, -b, b)
    return dq.normalize(a + nearer)


def _residual(have: Float[Array, "4"], want: Float[Array, "4"]) -> Float[Array, "4"]:
    """Rotation `r` with `have r = want` up to its sign, by the smaller angle."""
    q = dq.quat_mul(dq.quat_conj(have), want)
    return jnp.where(q[0] < 0, -q, q)


def _between(first: Float[Array, "4"], last: Float[Array, "4"]) -> tuple[Array, Array]:
    """Half the angle [rad] from one rotation to another, and the axis as a pure quaternion."""
    turn = _residual(first, last)
    # equal rotations have no axis: `tiny` keeps the division finite
    size = jnp.sqrt(jnp.maximum(jnp.sum(turn[1:] ** 2), jnp.finfo(turn.dtype).tiny))
    return jnp.arctan2(size, turn[0]), _pure(turn[1:] / size)


_UNIT_ROWS = np.array([[0, 1, 2, 3], [1, 0, 3, 2], [2, 3, 0, 1], [3, 2, 1, 0]], np.int32)
_UNIT_SIGNS = np.array([[1, 1, 1, 1], [-1, 1, -1, 1], [-1, 1, 1, -1], [-1, -1, 1, 1]])
"""Components and signs of `e_k q`, one row for each basis quaternion `e_k` (1, i, j, k)."""


def _product_matrix(left: Float[Array, "4"], right: Float[Array, "4"]) -> Float[Array, "4 4"]:
    """Matrix `m` of rows `left e_k right`, so that `x @ m` is the product `left x right`."""
    rows = right[_UNIT_ROWS] * jnp.asarray(_UNIT_SIGNS, right.dtype)
    return dq.quat_mul(jnp.broadcast_to(left, (4, 4)), rows)


def _combine(terms: Float[Array, "point k"], matrix: Float[Array, "k 8"]) -> Any:
    """`terms @ matrix` `[point, 8]`, written out: batched small products are slow on a CPU."""
    return sum(terms[:, k, None] * matrix[k] for k in range(matrix.shape[0]))


def _coefficients(
    turn: Float[Array, "4"], h: Float[Array, "4"], offset: Float[Array, "4"], drift: Array
) -> Float[Array, "12 8"]:
    """Matrix from (dual, real, s real) of a demonstration to `turn D h`, then moved.

    Args:
        turn, h: rotations that multiply the demonstration from the left and from the right.
        offset, drift: the translation `offset + s drift`, as pure quaternions [m].
    """
    real = _product_matrix(turn, h)
    translations = (dq.quat_mul(jnp.broadcast_to(0.5 * t, (4, 4)), real) for t in (offset, drift))
    zeros = jnp.zeros_like(real)
    return jnp.concatenate(
        [jnp.concatenate([zeros, real, zeros]), jnp.concatenate([real, *translations])], axis=1
    )


def aligned(poses: Array, start: Array, goal: Array) -> Float[Array, "point 8"]:
    """Move the whole demonstration rigidly, then spread the errors at its ends along the path.

    The map meets both ends, returns the demonstration on its own ends, and moves along with a
    rigid motion of both ends. The errors are spread by arc length s, those of position and those
    of rotation separately:

    `E = T D`, with `T` half way between `D1' D1*` and `Dn' Dn*`;
    position `p(E) + (1 - s) (p1' - p(E1)) + s (pn' - p(En))`;
    rotation `q(E) slerp(q(E1)* q1', q(En)* qn'; s)`.

    The slerp is `cos(s h) f + sin(s h) g`, so every component of the result is linear in those of
    the demonstration: each of the two terms is one small matrix, applied to all points.

    Args:
        poses: `[point, 8]` of the demonstration.
        start, goal: `[8]` new end poses.
    """
    poses = align_signs(poses)
    move = _midpoint(dq.mul(start, dq.conj(poses[0])), dq.mul(goal, dq.conj(poses[-1])))
    return _spread(poses, start, goal, move, arc_phase(poses))


def late_exact(poses: Array, start: Array, goal: Array) -> Float[Array, "point 8"]:
    """Like `aligned`, but the last quarter of the path is the demonstration's, seen from the goal.

    So an approach from above stays one. The demonstration is moved rigidly to the new goal, and
    the error at its start is spread over the first three quarters of the path.

    Args:
        poses: `[point, 8]` of the demonstration.
        start, goal: `[8]` new end poses.
    """
    poses = align_signs(poses)
    move = dq.mul(goal, dq.conj(poses[-1]))
    return _spread(poses, start, goal, move, jnp.minimum(1.0, arc_phase(poses) / LATE))


def _spread(poses: Array, start: Array, goal: Array, move: Array, s: Array) -> Any:
    """`move` applied to a demonstration, with the errors at both ends spread by `s` `[point]`."""
    rotation, first, last = move[:4], dq.mul(move, poses[0]), dq.mul(move, poses[-1])
    f = _residual(first[:4], start[:4])
    # `f` and the sine's factor `g = f axis` of the slerp, see `aligned`
    half, axis = _between(f, _residual(last[:4], goal[:4]))
    shift_at_start, shift_at_goal = (
        _pure(dq.position(target) - dq.quat_rotate(rotation, dq.position(demo)))
        for target, demo in ((start, poses[0]), (goal, poses[-1]))
    )
    s = s[:, None]
    terms = jnp.concatenate([poses[:, 4:], poses[:, :4], s * poses[:, :4]], axis=1)
    waves = ((jnp.cos(s * half), f), (jnp.sin(s * half), dq.quat_mul(f, axis)))
    return sum(
        wave
        * _combine(
            terms, _coefficients(rotation, h, shift_at_start, shift_at_goal - shift_at_start)
        )
        for wave, h in waves
    )


MAPS = {"aligned": aligned, "late_exact": late_exact, "ugp_blend": ugp_blend, "ugp_goal": ugp_goal}
"""Maps by their names in configurations."""


def map_skills(
    skills: Float[Array, "skill point 8"],
    starts: Float[Array, "segment 8"],
    goals: Float[Array, "segment 8"],
    mapping: str = "aligned",
) -> Float[Array, "skill segment point 8"]:
    """Map every skill to the start and the goal of every segment.

    Args:
        skills: `[skill, point, 8]` demonstrated poses.
        starts, goals: `[segment, 8]` new end poses.
        mapping: name of the map, a key of `MAPS`.

    Returns:
        `[skill, segment, point, 8]` unit dual quaternions.
    """
    one_skill = jax.vmap(MAPS[mapping], (None, 0, 0))
    return jax.vmap(one_skill, (0, None, None))(skills, starts, goals)
