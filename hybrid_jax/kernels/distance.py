# SPDX-License-Identifier: MIT
"""Signed distance of two primitives: positive apart, negative the depth of penetration [m].

Each function treats one pair; callers vmap. A capsule is a segment with a radius, a sphere a
capsule of length zero. Boxes are given in their own frame where that saves a rotation.

The functions work on components (`x`, `y`, `z` as separate scalars): batched, every operation is
then one long contiguous loop, which XLA's CPU back end runs some thirty times faster than the
same arithmetic on small vectors.
"""

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

FAR = 1e3
"""Distance reported for an empty slot [m]: finite, so that gradients stay finite."""

_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
_EDGES = np.array([(i, i | bit) for bit in (1, 2, 4) for i in range(8) if not i & bit])


def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def sub(a, b):
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def _cross(a, b):
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


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


def segment_segment(a: Float[Array, "2 3"], b: Float[Array, "2 3"]) -> Float[Array, ""]:
    """Distance of two segments (Ericson, "Real-Time Collision Detection", section 5.1.9)."""
    along_a, along_b, r = sub(a[1], a[0]), sub(b[1], b[0]), sub(a[0], b[0])
    aa, bb, ab = dot(along_a, along_a), dot(along_b, along_b), dot(along_a, along_b)
    ar, br = dot(along_a, r), dot(along_b, r)
    det = aa * bb - ab * ab
    det = jnp.where(det > 1e-6 * aa * bb, det, 0.0)
    s = jnp.clip(_ratio(ab * br - ar * bb, det), 0.0, 1.0)
    t = jnp.clip(_ratio(ab * s + br, bb), 0.0, 1.0)
    s = jnp.clip(_ratio(ab * t - ar, aa), 0.0, 1.0)
    gap = tuple(r[i] + s * along_a[i] - t * along_b[i] for i in range(3))
    return _sqrt(dot(gap, gap))


def capsule_capsule(a: Array, radius_a: Array, b: Array, radius_b: Array) -> Float[Array, ""]:
    """Signed distance of two capsules given by their end points `[2, 3]` and radii."""
    return segment_segment(a, b) - radius_a - radius_b


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


def capsule_plane(ends: Float[Array, "2 3"], radius: Array, plane: Float[Array, "4"]) -> Array:
    """Signed distance of a capsule and a half-space `n.p <= offset`."""
    return jnp.minimum(dot(ends[0], plane), dot(ends[1], plane)) - plane[3] - radius


def box_plane(centre: Array, rotation: Array, half: Array, plane: Float[Array, "4"]) -> Array:
    """Signed distance of a box and a half-space `n.p <= offset`."""
    reach = sum(half[i] * jnp.abs(dot(plane, rotation[:, i])) for i in range(3))
    return dot(centre, plane) - plane[3] - reach


def _point_box(point: Float[Array, "3"], half: Float[Array, "3"]) -> Float[Array, ""]:
    gap = tuple(_outside(point[i], half[i]) for i in range(3))
    return _sqrt(dot(gap, gap))


def _box_separation(centre, rotation, half_a: Array, half_b: Array) -> Array:
    """Largest separation over the 15 axes of two boxes (A in B's frame); negative: the depth."""
    axes_a = [tuple(rotation[j][i] for j in range(3)) for i in range(3)]
    axes_b = [tuple(float(i == j) for j in range(3)) for i in range(3)]
    best = -jnp.inf
    for axis in axes_a + axes_b + [_cross(b, a) for b in axes_b for a in axes_a]:
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
        centre: three components [m].
        rotation: nested, `rotation[i][j]` is component i of axis j of A.
        half_a, half_b: half extents `[3]` [m].
    """
    corners = _CORNERS * half_a  # [8, 3]
    in_b = [centre[i] + sum(rotation[i][j] * corners[:, j] for j in range(3)) for i in range(3)]
    edges = [[in_b[i][_EDGES[:, end]] for i in range(3)] for end in (0, 1)]
    offset = [_CORNERS[:, i] * half_b[i] - centre[i] for i in range(3)]
    in_a = [sum(rotation[i][j] * offset[i] for i in range(3)) for j in range(3)]
    gap = jnp.minimum(jnp.min(segment_box(edges, half_b)), jnp.min(_point_box(in_a, half_a)))
    separation = _box_separation(centre, rotation, half_a, half_b)
    return jnp.where(separation > 0, gap, separation)
