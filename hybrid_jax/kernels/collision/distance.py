# SPDX-License-Identifier: MIT
"""Signed distance of two primitives: positive apart, negative the depth of penetration [m].

A capsule is a segment with a radius, a sphere a capsule of length zero. Boxes are given in their
own frame where that saves a rotation.

The functions work on components (see `kernels.vec3`): scalars for one pair, or arrays `[...]` that
broadcast. A vector is three of them, an end of a segment a vector. Distances have that shape.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from hybrid_jax.kernels.vec3 import Vector, cross, dot, sub, turn_back

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
    """Signed distance of a coordinate to the interval from `-half` to `half`; 0 inside."""
    return x - jnp.clip(x, -half, half)


def _least(values: Array) -> Array:
    """Minimum along the first axis.

    By a loop: XLA's CPU back end merges `jnp.min` with what computes the values, which then does
    not vectorise.
    """

    def step(k, best):
        return jnp.minimum(best, jax.lax.dynamic_index_in_dim(values, k, keepdims=False))

    return jax.lax.fori_loop(1, values.shape[0], step, values[0])


def segment_box(ends: Vector, half: Vector) -> Array:
    """Distance of a segment and a solid box in the box's frame; 0 where they meet.

    The squared distance along the segment is convex and piecewise quadratic, with kinks where a
    coordinate crosses a face: bracket the root of its slope between kinks, then solve that piece.

    Args:
        ends: two ends of three components `[...]` [m].
        half: half extents by components [m].

    Returns:
        `[...]` [m].
    """
    start, direction = ends[0], sub(ends[1], ends[0])

    def slope(t):
        return sum(direction[i] * _outside(start[i] + t * direction[i], half[i]) for i in range(3))

    t_low, t_high = jnp.zeros_like(direction[0]), jnp.ones_like(direction[0])
    g_low, g_high = slope(t_low), slope(t_high)
    for i in range(3):
        for face in (-half[i], half[i]):
            # along a face there is no crossing: t = 0, an end that is in the bracket anyway
            t = jnp.clip(_ratio(face - start[i], direction[i]), 0.0, 1.0)
            g = slope(t)
            low, high = (g <= 0) & (t >= t_low), (g >= 0) & (t <= t_high)
            t_low, g_low = jnp.where(low, t, t_low), jnp.where(low, g, g_low)
            t_high, g_high = jnp.where(high, t, t_high), jnp.where(high, g, g_high)
    root = t_low - g_low * _ratio(t_high - t_low, g_high - g_low)
    t = jnp.where(g_low >= 0, t_low, jnp.where(g_high <= 0, t_high, root))
    gap = tuple(_outside(start[i] + t * direction[i], half[i]) for i in range(3))
    return _sqrt(dot(gap, gap))


def _segment_box_separation(ends: Vector, half: Vector) -> Array:
    """Largest separation over the separating axes of a segment and a box; negative: the depth."""
    centre = tuple(0.5 * (ends[0][i] + ends[1][i]) for i in range(3))
    extent = tuple(0.5 * (ends[1][i] - ends[0][i]) for i in range(3))
    best: Any = -jnp.inf
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


def capsule_box(ends: Vector, radius: ArrayLike, half: Vector) -> Array:
    """Signed distance of a capsule and a box, in the box's frame.

    Args:
        ends: two ends of the capsule's axis, of three components `[...]` [m].
        radius: of the capsule [m].
        half: half extents of the box by components [m].

    Returns:
        `[...]` [m]; negative: the depth of penetration.
    """
    gap = segment_box(ends, half)
    # where the axis itself is in the box its distance is 0: separating axes give the depth
    depth = jnp.minimum(_segment_box_separation(ends, half), 0.0)
    return jnp.where(gap > 0, gap, depth) - radius


def _point_box(point: Vector, half: Vector) -> Array:
    """Distance of a point and a solid box in the box's frame; 0 inside."""
    gap = tuple(_outside(point[i], half[i]) for i in range(3))
    return _sqrt(dot(gap, gap))


def _box_separation(centre, rotation, half_a: Vector, half_b: Vector) -> Array:
    """Largest separation over the 15 axes of two boxes (A in B's frame); negative: the depth."""
    axes_a = [tuple(rotation[j][i] for j in range(3)) for i in range(3)]
    axes_b = [tuple(float(i == j) for j in range(3)) for i in range(3)]
    best: Any = -jnp.inf
    for axis in axes_a + axes_b + [cross(b, a) for b in axes_b for a in axes_a]:
        # parallel edges have no common normal: their axis says nothing
        sq = dot(axis, axis)
        usable = sq > 1e-8
        reach = sum(half_a[i] * jnp.abs(dot(axes_a[i], axis)) for i in range(3))
        reach += sum(half_b[i] * jnp.abs(axis[i]) for i in range(3))
        gap = (jnp.abs(dot(centre, axis)) - reach) / jnp.sqrt(jnp.where(usable, sq, 1.0))
        best = jnp.maximum(best, jnp.where(usable, gap, -jnp.inf))
    return best


def box_box(centre: Vector, rotation, half_a: Vector, half_b: Vector) -> Array:
    """Signed distance of box A, at `centre`, `rotation` in the frame of box B, and box B.

    Apart: the closest points lie on an edge of A or on a corner of B, so the twelve edges of A
    against B and the corners of B against A are all there is. Overlapping: the separating axes.

    Args:
        centre: of A, three components `[...]` [m].
        rotation: nested components `[...]`, `rotation[i][j]` is component i of axis j of A.
        half_a, half_b: half extents by components [m].

    Returns:
        `[...]` [m]; negative: the depth of penetration.
    """
    item_axes = (1,) * jnp.ndim(centre[0])
    corners = _CORNERS.T.reshape(3, 8, *item_axes)
    start_corners, end_corners = (
        _CORNERS[_EDGES[:, end]].T.reshape(3, 12, *item_axes) for end in (0, 1)
    )
    start, end = (
        [centre[i] + dot(rotation[i], [signs[j] * half_a[j] for j in range(3)]) for i in range(3)]
        for signs in (start_corners, end_corners)
    )
    corners_in_a = turn_back(rotation, [corners[i] * half_b[i] - centre[i] for i in range(3)])
    gap = jnp.minimum(
        _least(segment_box([start, end], half_b)), _least(_point_box(corners_in_a, half_a))
    )
    separation = _box_separation(centre, rotation, half_a, half_b)
    return jnp.where(separation > 0, gap, separation)


def sphere_sphere(centre, radius, ball) -> Array:
    """Signed distance `[...]` of two balls [m].

    Args:
        centre: of the first, three components [m].
        radius: of the first [m].
        ball: the second, `rounded_boxes.RoundedBoxes` without extent.
    """
    offset = sub(centre, ball.centre)
    return jnp.sqrt(dot(offset, offset)) - radius - ball.radius


def sphere_rounded_box(centre, radius, block) -> Array:
    """Signed distance `[...]` of a ball and a box swept by another ball [m].

    Args:
        centre: of the ball, three components in the world [m].
        radius: of the ball [m].
        block: the box, `rounded_boxes.RoundedBoxes`.
    """
    centre_in_block = turn_back(block.rotation, sub(centre, block.centre))
    gaps = [jnp.abs(centre_in_block[i]) - block.half_extents[i] for i in range(3)]
    outside = tuple(jnp.maximum(gap, 0.0) for gap in gaps)
    inside = jnp.minimum(jnp.maximum(jnp.maximum(gaps[0], gaps[1]), gaps[2]), 0.0)
    return jnp.sqrt(dot(outside, outside)) + inside - radius - block.radius


def capsule_rounded_box(centre, axis, radius, block) -> Array:
    """Signed distance `[...]` of a capsule and a box swept by a ball [m].

    Args:
        centre, axis: three components of the capsule's centre and of half its axis, from the
            centre to an end, in the world [m].
        radius: of the capsule [m].
        block: the box, `rounded_boxes.RoundedBoxes`.
    """
    centre_in_block = turn_back(block.rotation, sub(centre, block.centre))
    axis_in_block = turn_back(block.rotation, axis)
    ends = [
        sub(centre_in_block, axis_in_block),
        [centre_in_block[i] + axis_in_block[i] for i in range(3)],
    ]
    return capsule_box(ends, radius, block.half_extents) - block.radius


def rounded_box_rounded_box(a, b) -> Array:
    """Signed distance `[...]` of two boxes swept by balls, `rounded_boxes.RoundedBoxes` [m]."""
    # the columns of A's rotation seen from B; then by rows, as `box_box` reads them
    rotation = [turn_back(b.rotation, [a.rotation[i][k] for i in range(3)]) for k in range(3)]
    rotation_in_b = [[rotation[k][i] for k in range(3)] for i in range(3)]
    centre_in_b = turn_back(b.rotation, sub(a.centre, b.centre))
    return box_box(centre_in_b, rotation_in_b, a.half_extents, b.half_extents) - a.radius - b.radius
