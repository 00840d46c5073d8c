# SPDX-License-Identifier: MIT
"""Signed distance of two primitives: positive apart, negative the depth of penetration [m].

Each function treats one pair; callers vmap. A capsule is a segment with a radius, a sphere a
capsule of length zero. Boxes are given in their own frame where that saves a rotation.

The functions work on components (see `kernels.components`): scalars, or arrays of one shape.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from hybrid_jax.kernels.components import cross, dot, sub, turn_back

FAR = 1e3
"""Distance reported for an empty slot [m]: finite, so that gradients stay finite."""

_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
_EDGES = np.array([(i, i | bit) for bit in (4, 2, 1) for i in range(8) if not i & bit])
"""Corners that each of the twelve edges joins, four along each axis."""


def _sqrt(sq: Array) -> Array:
    """Square root whose gradient is 0, not NaN, at zero."""
    positive = sq > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, sq, 1.0)), 0.0)


def _ratio(a, b):
    """`a / b`, and 0 where `b` is 0."""
    usable = b != 0
    return jnp.where(usable, a / jnp.where(usable, b, 1.0), 0.0)


def _outside(x, half):
    """How far a coordinate lies outside an interval, signed."""
    return x - jnp.clip(x, -half, half)


def _least(values: Array) -> Array:
    """Minimum along the first axis.

    By a loop: XLA's CPU back end merges `jnp.min` with what computes the values, which then does
    not vectorise.
    """

    def step(k, best):
        return jnp.minimum(best, jax.lax.dynamic_index_in_dim(values, k, keepdims=False))

    return jax.lax.fori_loop(1, values.shape[0], step, values[0])


def segment_box(ends: Float[Array, "2 3"], half: Float[Array, "3"]) -> Float[Array, ""]:
    """Distance of a segment and a solid box in the box's frame; 0 where they meet.

    The squared distance along the segment is convex and piecewise quadratic, with kinks where a
    coordinate crosses a face: bracket the root of its slope between kinks, then solve that piece.
    """
    start, along = ends[0], sub(ends[1], ends[0])

    def slope(t):
        return sum(along[i] * _outside(start[i] + t * along[i], half[i]) for i in range(3))

    t_low, t_high = jnp.zeros_like(along[0]), jnp.ones_like(along[0])
    g_low, g_high = slope(t_low), slope(t_high)
    for i in range(3):
        for face in (-half[i], half[i]):
            t = jnp.clip(_ratio(face - start[i], along[i]), 0.0, 1.0)
            g = slope(t)
            low, high = (g <= 0) & (t >= t_low), (g >= 0) & (t <= t_high)
            t_low, g_low = jnp.where(low, t, t_low), jnp.where(low, g, g_low)
            t_high, g_high = jnp.where(high, t, t_high), jnp.where(high, g, g_high)
    root = t_low - g_low * _ratio(t_high - t_low, g_high - g_low)
    t = jnp.where(g_low >= 0, t_low, jnp.where(g_high <= 0, t_high, root))
    gap = tuple(_outside(start[i] + t * along[i], half[i]) for i in range(3))
    return _sqrt(dot(gap, gap))


def _segment_box_separation(ends: Float[Array, "2 3"], half: Float[Array, "3"]) -> Float[Array, ""]:
    """Largest separation over the separating axes of a segment and a box; negative: the depth."""
    centre = tuple(0.5 * (ends[0][i] + ends[1][i]) for i in range(3))
    extent = tuple(0.5 * (ends[1][i] - ends[0][i]) for i in range(3))
    best = -jnp.inf
    for i in range(3):
        best = jnp.maximum(best, jnp.abs(centre[i]) - half[i] - jnp.abs(extent[i]))
    for i in range(3):
        # axis e_i x extent: the segment projects to a point on it
        j, k = (i + 1) % 3, (i + 2) % 3
        gap = jnp.abs(centre[j] * extent[k] - centre[k] * extent[j])
        reach = half[j] * jnp.abs(extent[k]) + half[k] * jnp.abs(extent[j])
        sq = extent[j] * extent[j] + extent[k] * extent[k]
        usable = sq > 1e-12
        edge = (gap - reach) / jnp.sqrt(jnp.where(usable, sq, 1.0))
        best = jnp.maximum(best, jnp.where(usable, edge, -jnp.inf))
    return best


def capsule_box(
    ends: Float[Array, "2 3"], radius: Array, half: Float[Array, "3"]
) -> Float[Array, ""]:
    """Signed distance of a capsule and a box of half extents `half`, in the box's frame."""
    gap = segment_box(ends, half)
    depth = jnp.minimum(_segment_box_separation(ends, half), 0.0)
    return jnp.where(gap > 0, gap, depth) - radius


def _point_box(point: Float[Array, "3"], half: Float[Array, "3"]) -> Float[Array, ""]:
    gap = tuple(_outside(point[i], half[i]) for i in range(3))
    return _sqrt(dot(gap, gap))


def _box_separation(centre, rotation, half_a: Array, half_b: Array) -> Array:
    """Largest separation over the 15 axes of two boxes (A in B's frame); negative: the depth."""
    axes_a = [tuple(rotation[j][i] for j in range(3)) for i in range(3)]
    axes_b = [tuple(float(i == j) for j in range(3)) for i in range(3)]
    best = -jnp.inf
    for axis in axes_a + axes_b + [cross(b, a) for b in axes_b for a in axes_a]:
        sq = dot(axis, axis)
        usable = sq > 1e-8
        reach = sum(half_a[i] * jnp.abs(dot(axes_a[i], axis)) for i in range(3))
        reach += sum(half_b[i] * jnp.abs(axis[i]) for i in range(3))
        gap = (jnp.abs(dot(centre, axis)) - reach) / jnp.sqrt(jnp.where(usable, sq, 1.0))
        best = jnp.maximum(best, jnp.where(usable, gap, -jnp.inf))
    return best


def box_box(centre, rotation, half_a: Array, half_b: Array) -> Float[Array, ""]:
    """Signed distance of box A, at `centre`, `rotation` in the frame of box B, and box B.

    Apart: the closest points lie on an edge of A or on a corner of B, so the twelve edges of A
    against B and the corners of B against A are all there is. Overlapping: the separating axes.

    Args:
        centre: components [m].
        rotation: nested, `rotation[i][j]` is component i of axis j of A.
        half_a, half_b: half extents by components [m].
    """
    ones = (1,) * jnp.ndim(centre[0])
    corners = _CORNERS.T.reshape(3, 8, *ones)
    first, second = (_CORNERS[_EDGES[:, end]].T.reshape(3, 12, *ones) for end in (0, 1))
    start, end = (
        [centre[i] + dot(rotation[i], [signs[j] * half_a[j] for j in range(3)]) for i in range(3)]
        for signs in (first, second)
    )
    in_a = turn_back(rotation, [corners[i] * half_b[i] - centre[i] for i in range(3)])
    gap = jnp.minimum(_least(segment_box([start, end], half_b)), _least(_point_box(in_a, half_a)))
    separation = _box_separation(centre, rotation, half_a, half_b)
    return jnp.where(separation > 0, gap, separation)


def ball_ball(centre, radius, ball) -> Array:
    """Signed distance of a ball and another one, which is a block without extent."""
    away = sub(centre, ball.centre)
    return jnp.sqrt(dot(away, away)) - radius - ball.radius


def ball_block(centre, radius, block) -> Array:
    """Signed distance of a ball and a block (a box swept by a ball, `primitives.Blocks`)."""
    middle = turn_back(block.rotation, sub(centre, block.centre))
    gaps = [jnp.abs(middle[i]) - block.half[i] for i in range(3)]
    outside = tuple(jnp.maximum(gap, 0.0) for gap in gaps)
    inside = jnp.minimum(jnp.maximum(jnp.maximum(gaps[0], gaps[1]), gaps[2]), 0.0)
    return jnp.sqrt(dot(outside, outside)) + inside - radius - block.radius


def swept_capsule(centre, axis, radius, block) -> Array:
    """Signed distance of a capsule and a block (a box swept by a ball, `primitives.Blocks`).

    Args:
        centre, axis: components of its centre and of half its axis in the world [m].
        radius: of the capsule [m].
    """
    middle = turn_back(block.rotation, sub(centre, block.centre))
    along = turn_back(block.rotation, axis)
    ends = [sub(middle, along), [middle[i] + along[i] for i in range(3)]]
    return capsule_box(ends, radius, block.half) - block.radius


def swept_blocks(a, b) -> Array:
    """Signed distance of two blocks."""
    rotation = [turn_back(b.rotation, [a.rotation[i][k] for i in range(3)]) for k in range(3)]
    in_b = [[rotation[k][i] for k in range(3)] for i in range(3)]
    centre = turn_back(b.rotation, sub(a.centre, b.centre))
    return box_box(centre, in_b, a.half, b.half) - a.radius - b.radius
