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


class Pair(NamedTuple):
    """Two bodies in the frame of the second one. All `[...]`."""

    offset: Vector
    """From the centre of the second body to that of the first [m]."""
    rotation: Vector
    """Of the first body, component before axis."""
    scale: tuple[Vector, Vector]
    """Scales of both hulls along their axes."""
    hull: tuple[Array, Array]
    """Their numbers."""
    radius: Array
    """Of both balls together [m]."""


def pair_of(a, b) -> Pair:
    """Two bodies, `rounded_boxes.RoundedBoxes` whose components broadcast, as a pair."""
    axes = [turn_back(b.rotation, [a.rotation[i][k] for i in range(3)]) for k in range(3)]
    rotation = [[axes[k][i] for k in range(3)] for i in range(3)]
    offset = turn_back(b.rotation, sub(a.centre, b.centre))
    hull = a.hull.astype(jnp.int32), b.hull.astype(jnp.int32)
    return Pair(offset, rotation, (a.scale, b.scale), hull, a.radius + b.radius)


class _State(NamedTuple):
    """A triangle of the difference of the bodies, and what is known. All `[...]`."""

    step: Array
    """Number of steps so far: before the first there are no points, and `nearest` is a guess."""
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
    """Is the bound as good as it gets, or enough?"""
    old_here: Vector
    """The points of the first body, from its centre, that `old` is made of [m]; empty if unused."""
    new_here: Vector
    """The same of `new`."""


def _support(hulls: ConvexHulls, hull: Array, scales: Vector, direction: Vector) -> Vector:
    """Point of a body without its ball that is farthest along a direction, in its own frame [m]."""
    # of a hull that is scaled along its axes, along the direction that is scaled as well
    scaled = [c * s for c, s in zip(direction, scales, strict=True)]
    vertex = farthest_vertex(hulls, hull, scaled)
    return tuple(c * s for c, s in zip(vertex, scales, strict=True))


def _pick(points: Vector, number: Array) -> Vector:
    """One of three points, components `[3, ...]`, by its number."""
    return tuple(jnp.where(number == 0, c[0], jnp.where(number == 1, c[1], c[2])) for c in points)


def _closest(
    new: Vector, old: Vector, overlap: Array, may_overlap: Array, is_first: Array
) -> tuple:
    """What of three old points, components `[3, ...]`, and a new one is nearest to the origin.

    Only edges and faces with the new point can be nearer than before. It stands alone where it
    `is_first`: old points that equal it but for rounding would make a face of any direction.

    Returns:
        `nearest`, `second`, `third` and `overlap` of `_State`.
    """
    following = [jnp.roll(component, -1, axis=0) for component in old]
    edge, next_edge = sub(old, new), sub(following, new)
    length = dot(edge, edge)
    share = jnp.clip(-dot(new, edge) / jnp.where(length > 0, length, 1.0), 0.0, 1.0)
    foot = add(new, scale(edge, jnp.where(is_first, 0.0, share)))
    normal = cross(edge, next_edge)
    area = dot(normal, normal)
    sides = [cross(new, old), cross(old, following), cross(following, new)]
    has_area = ~is_first & (area > _FLAT * length * dot(next_edge, next_edge))
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
    overlap = overlap | (encloses & may_overlap & ~is_first)
    # from within, on through the nearest of the three faces that have the new point
    points = [jnp.where(is_face | overlap, a, b) for a, b in zip(on_plane, foot, strict=True)]
    squared = jnp.where(overlap & ~has_area, jnp.inf, dot(points, points))
    second = jnp.argmin(squared, axis=0).astype(jnp.int32)
    is_triangle = _pick([is_face | overlap], second)[0]
    third = jnp.where(is_triangle, (second + 1) % 3, second)
    nearest = _pick(points, second)
    sign = jnp.where(overlap, -1.0, 1.0)
    return scale(nearest, sign), second, third, overlap


def convex_distance(hulls: ConvexHulls, a, b, enough: Array | float = jnp.inf) -> Array:
    """Signed distance `[...]` of two convex bodies [m], see the module.

    Args:
        hulls: tables of the hulls that they are.
        a, b: `rounded_boxes.RoundedBoxes` whose components broadcast.
        enough: of what is farther apart some bound is returned that is as large [m].
    """
    pair = pair_of(a, b)
    return _search(hulls, pair, enough).bound - pair.radius


class Progress(NamedTuple):
    """What some steps have shown of a pair. All `[...]`."""

    bound: Array
    """Lower bound of the signed distance [m]."""
    reach: Array
    """Upper bound of it [m]."""
    direction: Vector
    """Where to go on: from the second body to the first one, in the frame of the second [m]."""
    done: Array
    """Is the bound the distance, or enough?"""


def some_steps(
    hulls: ConvexHulls, pair: Pair, direction: Vector, enough: Array, steps: Array
) -> Progress:
    """Search for the distance for at most `steps` `[]` steps, from a direction; see `Pair`."""
    state = _search(hulls, pair, enough, direction, steps)
    reach = jnp.where(state.overlap, 0.0, jnp.sqrt(dot(state.nearest, state.nearest)))
    # a search that was started again does not leave a direction in which bodies overlap
    back = jnp.where(state.overlap, -1.0, 1.0)
    return Progress(
        state.bound - pair.radius, reach - pair.radius, scale(state.nearest, back), state.done
    )


def nearest_points(hulls: ConvexHulls, a, b) -> tuple[Vector, Vector, Vector]:
    """Where two convex bodies are nearest, or overlap deepest; see `convex_distance`.

    Returns:
        The unit direction from the second body to the first, and the points of both without their
        balls, from their centres in their own frames [m].
    """
    pair = pair_of(a, b)
    state = _search(hulls, pair, with_witness=True)
    places = state.second, state.third
    corners = [state.new, *(_pick(state.old, place) for place in places)]
    here = [state.new_here, *(_pick(state.old_here, place) for place in places)]
    target = scale(state.nearest, jnp.where(state.overlap, -1.0, 1.0))
    shares = _shares(corners, target)
    on_a = tuple(sum(w * p[i] for w, p in zip(shares, here, strict=True)) for i in range(3))
    on_b = sub(add(on_a, pair.offset), target)
    norm = jnp.maximum(jnp.sqrt(dot(state.nearest, state.nearest)), 1e-9)
    direction = turn(b.rotation, scale(state.nearest, 1.0 / norm))
    return direction, turn_back(pair.rotation, on_a), on_b


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


def _search(
    hulls: ConvexHulls,
    pair: Pair,
    enough: Array | float = jnp.inf,
    direction: Vector | None = None,
    steps: Array | int = STEPS,
    *,
    with_witness: bool = False,
) -> _State:
    """Go to the nearest point of the difference of two bodies.

    Args:
        hulls: tables of the hulls that they are.
        pair: the bodies, `[...]`.
        enough: signed distance at which a search may end [m].
        direction: the first one to look along, else that of the centres [m].
        steps: most steps.
        with_witness: keep the points of the first body?
    """
    shape = jnp.broadcast_shapes(*(jnp.shape(c) for c in (*pair.offset, *pair.hull)))
    limit = enough + pair.radius

    def going(state):
        return (jnp.max(jnp.where(state.done, 0, state.step)) < steps) & ~jnp.all(state.done)

    def advance(state):
        after = _advance(hulls, pair, limit, state, with_witness)
        if not with_witness:
            return after
        # the last step only proves what the one before it found
        keep = after.done & (state.step > 0)
        kept = jax.tree.map(lambda a, b: jnp.where(keep, a, b), state, after)
        return kept._replace(step=after.step, bound=after.bound, done=after.done)

    zero, none = jnp.zeros(shape, jnp.int32), tuple(jnp.zeros((3, *shape)) for _ in range(3))
    nearest = pair.offset if direction is None else direction
    nearest = tuple(jnp.broadcast_to(c, shape) for c in nearest)
    start = _State(
        step=zero,
        old=none,
        new=nearest,
        second=zero,
        third=zero,
        nearest=nearest,
        bound=jnp.full(shape, -jnp.inf),
        overlap=jnp.zeros(shape, bool),
        done=jnp.zeros(shape, bool),
        old_here=none if with_witness else (),
        new_here=nearest if with_witness else (),
    )
    return jax.lax.while_loop(going, advance, start)


def _advance(
    hulls: ConvexHulls, pair: Pair, limit: Array, state: _State, with_witness: bool
) -> _State:
    """One step: the point that is farthest back, and what is nearest to the origin with it."""
    nearest = state.nearest
    forward = turn_back(pair.rotation, scale(nearest, -1.0))
    here = turn(pair.rotation, _support(hulls, pair.hull[0], pair.scale[0], forward))
    new = add(pair.offset, sub(here, _support(hulls, pair.hull[1], pair.scale[1], nearest)))
    is_first = state.step == 0
    old = _corners(state.old, state.new, state)
    norm, away = jnp.sqrt(dot(nearest, nearest)), jnp.sqrt(dot(new, new))
    # along no direction at all the origin is no deeper than this point, which is on the surface
    apart = jnp.where(norm > 1e-9, dot(nearest, new) / jnp.maximum(norm, 1e-9), -away)
    bound = jnp.where(state.done, state.bound, jnp.maximum(state.bound, apart))
    gap = jnp.where(is_first, jnp.inf, jnp.where(state.overlap, -norm, norm))
    # on the way out a step that does not help is the last one
    done = state.done | (gap - bound <= TOLERANCE) | (state.overlap & (bound <= state.bound))
    done |= (bound >= limit) | (state.step >= STEPS)
    nearest, second, third, overlap = _closest(new, old, state.overlap, bound <= 0, is_first)
    old_here = _corners(state.old_here, state.new_here, state) if with_witness else ()
    return _State(
        step=state.step + 1,
        old=tuple(jnp.where(is_first, a, b) for a, b in zip(new, old, strict=True)),
        new=new,
        second=second,
        third=third,
        nearest=nearest,
        bound=bound,
        overlap=overlap,
        done=done,
        old_here=tuple(jnp.where(is_first, a, b) for a, b in zip(here, old_here, strict=False)),
        new_here=here if with_witness else (),
    )


def _corners(old: Vector, new: Vector, state: _State) -> Vector:
    """The corners of the triangle that is left, components `[3, ...]`."""
    corners = [new, _pick(old, state.second), _pick(old, state.third)]
    return tuple(jnp.stack([corner[i] for corner in corners]) for i in range(3))
