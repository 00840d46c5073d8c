# SPDX-License-Identifier: MIT
"""Signed distance of two convex bodies by their support points (Gilbert, Johnson, Keerthi 1988).

A body is a convex hull, scaled along its axes and swept by a ball: a box is a cube so scaled, a
capsule a cube without width. The answer never exceeds the true signed distance: any direction in
which two bodies are apart bounds their distance from below, and the best of those that were tried
is the answer. Where the bodies are apart it is exact to 0.1 mm. Where they overlap its sign is
right, and the depth is that along the best direction tried: at least the true one.

A decision that several components depend on is a whole number in the state of the loop: XLA would
compute it anew for each component, round differently, and near a tie mix two points into a third.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from hybrid_jax.kernels.collision.support_map import farthest_vertex
from hybrid_jax.kernels.vec3 import Vector, add, cross, dot, scale, sub, turn, turn_back
from hybrid_jax.types import ConvexHulls

TOLERANCE = 2e-5
"""Gap of both bounds at which a search ends [m]; rounding may end one a little earlier."""
STEPS = 24
"""Most steps."""
_FLAT = 1e-9
"""Share of the square of an area or a volume, of what its edges could span, that is rounding."""


class _State(NamedTuple):
    """A triangle of the difference of the bodies, and what is known. All `[...]` but `step`."""

    step: Array
    """`[]` number of steps so far."""
    old: Vector
    """Three components `[3, ...]` of the points that the last step had [m]."""
    new: Vector
    """The point that it found [m]."""
    second: Array
    """Number in `old` of the corner of the triangle that follows on `new`."""
    third: Array
    """The same of its last corner: that of `second` where the triangle is an edge."""
    nearest: Vector
    """Point of the triangle that is nearest to the origin [m]."""
    bound: Array
    """Best lower bound of the distance so far [m]."""
    overlap: Array
    """Did four points enclose the origin? Then `nearest` is a direction to leave it, reversed."""
    done: Array
    """Is the bound as good as it gets?"""
    old_here: Vector
    """The points of the first body, from its centre, that `old` is made of [m]; empty if unused."""
    new_here: Vector
    """The same of `new`."""


def _support(hulls: ConvexHulls, body, direction: Vector) -> Vector:
    """Point of a body without its ball, from its centre, that is farthest along a direction [m]."""
    # of a hull that is scaled along its axes, along the direction that is scaled as well
    scaled = [c * s for c, s in zip(turn_back(body.rotation, direction), body.scale, strict=True)]
    vertex = farthest_vertex(hulls, body.hull.astype(jnp.int32), scaled)
    return turn(body.rotation, [c * s for c, s in zip(vertex, body.scale, strict=True)])


def _pick(points: Vector, number: Array) -> Vector:
    """One of three points, components `[3, ...]`, by its number."""
    return tuple(jnp.where(number == 0, c[0], jnp.where(number == 1, c[1], c[2])) for c in points)


def _closest(new: Vector, old: Vector, overlap: Array, may_overlap: Array) -> tuple:
    """What of three old points, components `[3, ...]`, and a new one is nearest to the origin.

    Only edges and faces with the new point can be nearer than before.

    Returns:
        `nearest`, `second`, `third` and `overlap` of `_State`.
    """
    following = [jnp.roll(component, -1, axis=0) for component in old]
    edge, next_edge = sub(old, new), sub(following, new)
    length = dot(edge, edge)
    share = jnp.clip(-dot(new, edge) / jnp.where(length > 0, length, 1.0), 0.0, 1.0)
    foot = add(new, scale(edge, share))
    normal = cross(edge, next_edge)
    area = dot(normal, normal)
    sides = [cross(new, old), cross(old, following), cross(following, new)]
    has_area = area > _FLAT * length * dot(next_edge, next_edge)
    on_plane = scale(normal, dot(normal, new) / jnp.where(has_area, area, 1.0))
    is_face = has_area
    for side in sides:
        is_face &= dot(side, normal) >= 0
    # four points enclose the origin where it sees all four faces from the same side
    parts, base = -dot(sides[1], new), dot([c[0] for c in sides[1]], [c[2] for c in old])
    volume = base + jnp.sum(parts, axis=0)
    encloses = jnp.all(parts * volume >= 0, axis=0) & (base * volume >= 0)
    encloses &= jnp.square(volume) > _FLAT * jnp.prod(length, axis=0)
    # of bodies that are proven to be apart four points enclose nothing: it is rounding
    overlap = overlap | (encloses & may_overlap)
    # from within, on through the nearest of the three faces that have the new point
    points = [jnp.where(is_face | overlap, a, b) for a, b in zip(on_plane, foot, strict=True)]
    squared = jnp.where(overlap & ~has_area, jnp.inf, dot(points, points))
    second = jnp.argmin(squared, axis=0).astype(jnp.int32)
    is_triangle = _pick([is_face | overlap], second)[0]
    third = jnp.where(is_triangle, (second + 1) % 3, second)
    nearest = _pick(points, second)
    sign = jnp.where(overlap, -1.0, 1.0)
    return scale(nearest, sign), second, third, overlap


def convex_distance(hulls: ConvexHulls, a, b) -> Array:
    """Signed distance `[...]` of two convex bodies [m], see the module.

    Args:
        hulls: tables of the hulls that they are.
        a, b: `rounded_boxes.RoundedBoxes` whose components broadcast.
    """
    return _search(hulls, a, b, with_witness=False).bound - a.radius - b.radius


def nearest_points(hulls: ConvexHulls, a, b) -> tuple[Vector, Vector, Vector]:
    """Where two convex bodies are nearest, or overlap deepest; see `convex_distance`.

    Returns:
        The unit direction from the second body to the first, and the points of both without their
        balls, from their centres in their own frames [m].
    """
    state = _search(hulls, a, b, with_witness=True)
    places = state.second, state.third
    corners = [state.new, *(_pick(state.old, place) for place in places)]
    here = [state.new_here, *(_pick(state.old_here, place) for place in places)]
    target = scale(state.nearest, jnp.where(state.overlap, -1.0, 1.0))
    shares = _shares(corners, target)
    on_a = tuple(sum(w * p[i] for w, p in zip(shares, here, strict=True)) for i in range(3))
    on_b = sub(add(on_a, sub(a.centre, b.centre)), target)
    norm = jnp.maximum(jnp.sqrt(dot(state.nearest, state.nearest)), 1e-9)
    direction = scale(state.nearest, 1.0 / norm)
    return direction, turn_back(a.rotation, on_a), turn_back(b.rotation, on_b)


def _shares(corners: list[Vector], point: Vector) -> list[Array]:
    """Shares of the corners of a triangle, which may be an edge, that a point in it consists of."""
    first, second, offset = (sub(p, corners[0]) for p in (*corners[1:], point))
    # corners that coincide share what they get: a little on the diagonal decides it
    little = 1e-6 * (dot(first, first) + dot(second, second)) + 1e-12
    aa, bb = dot(first, first) + little, dot(second, second) + little
    ab, ap, bp = dot(first, second), dot(first, offset), dot(second, offset)
    area = aa * bb - ab * ab
    u, v = (ap * bb - bp * ab) / area, (bp * aa - ap * ab) / area
    return [1.0 - u - v, u, v]


def _search(hulls: ConvexHulls, a, b, *, with_witness: bool) -> _State:
    """Go to the nearest point of the difference of two bodies."""
    offset = sub(a.centre, b.centre)

    def farthest_back(direction):
        """The point of the difference that is farthest against a direction, and that of `a`."""
        here = _support(hulls, a, scale(direction, -1.0))
        return add(offset, sub(here, _support(hulls, b, direction))), here

    def separation(direction, point):
        """How far the bodies are apart along a direction, at its point `farthest_back`."""
        norm = jnp.sqrt(dot(direction, direction))
        return jnp.where(norm > 1e-9, dot(direction, point) / jnp.maximum(norm, 1e-9), -jnp.inf)

    def going(state):
        return (state.step < STEPS) & ~jnp.all(state.done)

    def advance(state):
        old, nearest = _corners(state.old, state.new, state), state.nearest
        new, here = farthest_back(nearest)
        bound = jnp.maximum(state.bound, separation(nearest, new))
        bound = jnp.where(state.done, state.bound, bound)
        gap = jnp.sqrt(dot(nearest, nearest)) * jnp.where(state.overlap, -1.0, 1.0)
        # on the way out a step that does not help is the last one
        done = state.done | (gap - bound <= TOLERANCE) | (state.overlap & (bound <= state.bound))
        nearest, second, third, overlap = _closest(new, old, state.overlap, bound <= 0)
        old_here = _corners(state.old_here, state.new_here, state) if with_witness else ()
        after = _State(
            step=state.step + 1,
            old=old,
            new=new,
            second=second,
            third=third,
            nearest=nearest,
            bound=bound,
            overlap=overlap,
            done=done,
            old_here=old_here,
            new_here=here if with_witness else (),
        )
        if not with_witness:
            return after
        # the last step only proves what the one before it found
        kept = jax.tree.map(lambda a, b: jnp.where(done, a, b), state, after)
        return kept._replace(step=after.step, bound=bound, done=done)

    shape = jnp.broadcast_shapes(*(jnp.shape(c) for c in offset), a.hull.shape, b.hull.shape)
    offset = tuple(jnp.broadcast_to(c, shape) for c in offset)
    first, here = farthest_back(offset)
    zero, three = jnp.zeros(shape, jnp.int32), lambda p: tuple(jnp.stack([c, c, c]) for c in p)
    start = _State(
        step=jnp.int32(0),
        old=three(first),
        new=first,
        second=zero,
        third=zero,
        nearest=first,
        bound=jnp.maximum(separation(offset, first), -jnp.sqrt(dot(first, first))),
        overlap=jnp.zeros(shape, bool),
        done=jnp.zeros(shape, bool),
        old_here=three(here) if with_witness else (),
        new_here=here if with_witness else (),
    )
    return jax.lax.while_loop(going, advance, start)


def _corners(old: Vector, new: Vector, state: _State) -> Vector:
    """The corners of the triangle that is left, components `[3, ...]`."""
    corners = [new, _pick(old, state.second), _pick(old, state.third)]
    return tuple(jnp.stack([corner[i] for corner in corners]) for i in range(3))
