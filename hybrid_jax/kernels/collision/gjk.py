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

from hybrid_jax.kernels.collision.simplex import (
    candidates,
    closest,
    computed_once,
    pick,
    shares,
)
from hybrid_jax.kernels.collision.support_map import farthest_vertex
from hybrid_jax.kernels.vec3 import Vector, add, dot, scale, sub, turn, turn_back
from hybrid_jax.types import ConvexHulls

TOLERANCE = 2e-5
"""Gap of both bounds at which a search ends [m]; rounding may end one a little earlier."""
STEPS = 24
"""Most steps."""


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


def convex_distance(hulls: ConvexHulls, a, b, enough: Array | float = jnp.inf) -> Array:
    """Signed distance `[...]` of two convex bodies [m], see the module.

    Args:
        hulls: tables of the hulls that they are.
        a, b: `rounded_boxes.RoundedBoxes` whose components broadcast.
        enough: of what is farther apart some bound is returned that is as large [m].
    """
    pair = pair_of(a, b)
    return _search(hulls, pair, enough).bound - pair.radius


RECORD = 16
"""Numbers that a search is kept as between its steps."""


def some_steps(
    hulls: ConvexHulls, pair: Pair, record: Array, enough: Array, steps: Array
) -> tuple[Array, Array, Array]:
    """Go on with searches for at most `steps` `[]` steps.

    Args:
        hulls: tables of the hulls.
        pair: the bodies, `[lane]`.
        record: `[lane, RECORD]` where the searches stand; zeros where one begins.
        enough: `[1 or lane]` signed distance at which a search may end [m].
        steps: of each.

    Returns:
        Records after these steps, lower bounds `[lane]` of the signed distances [m], and whether
        they are the distances, or enough.
    """
    parts = [record[:, i] for i in range(RECORD)]
    step, zero = parts[13].astype(jnp.int32), jnp.zeros(record.shape[0], jnp.int32)
    corners = [parts[3 * k : 3 * k + 3] for k in range(3)]
    nearest = [jnp.where(step == 0, a, b) for a, b in zip(pair.offset, parts[9:12], strict=True)]
    state = _State(
        step=step,
        # the corners of the triangle, so that the first step takes the last two along
        old=tuple(jnp.stack([corner[i] for corner in corners]) for i in range(3)),
        new=tuple(corners[0]),
        second=zero + 1,
        third=zero + 2,
        nearest=tuple(nearest),
        bound=jnp.where(step == 0, -jnp.inf, parts[12]),
        overlap=parts[14] > 0.5,
        done=parts[15] > 0.5,
        old_here=(),
        new_here=(),
    )
    state = _search(hulls, pair, enough, state, steps)
    corners = [state.new, pick(state.old, state.second), pick(state.old, state.third)]
    flags = [a.astype(jnp.float32) for a in (state.step, state.overlap, state.done)]
    parts = [*(c for p in corners for c in p), *state.nearest, state.bound, *flags]
    return jnp.stack(parts, axis=-1), state.bound - pair.radius, state.done


def nearest_points(hulls: ConvexHulls, a, b) -> tuple[Vector, Vector, Vector]:
    """Where two convex bodies are nearest, or overlap deepest; see `convex_distance`.

    Returns:
        The unit direction from the second body to the first, and the points of both without their
        balls, from their centres in their own frames [m].
    """
    pair = pair_of(a, b)
    state = _search(hulls, pair, with_witness=True)
    places = state.second, state.third
    corners = [state.new, *(pick(state.old, place) for place in places)]
    here = [state.new_here, *(pick(state.old_here, place) for place in places)]
    target = scale(state.nearest, jnp.where(state.overlap, -1.0, 1.0))
    weights = shares(corners, target)
    on_a = tuple(sum(w * p[i] for w, p in zip(weights, here, strict=True)) for i in range(3))
    on_b = sub(add(on_a, pair.offset), target)
    norm = jnp.maximum(jnp.sqrt(dot(state.nearest, state.nearest)), 1e-9)
    direction = turn(b.rotation, scale(state.nearest, 1.0 / norm))
    return direction, turn_back(pair.rotation, on_a), on_b


def _search(
    hulls: ConvexHulls,
    pair: Pair,
    enough: Array | float = jnp.inf,
    state: _State | None = None,
    steps: Array | int = STEPS,
    *,
    with_witness: bool = False,
) -> _State:
    """Go to the nearest point of the difference of two bodies.

    It ends at a signed distance of `enough` [m], and after so many steps from `state`, or from the
    beginning. With witness it keeps the points of the first body.
    """
    shape = jnp.broadcast_shapes(*(jnp.shape(c) for c in (*pair.offset, *pair.hull)))
    limit = enough + pair.radius

    def going(counted):
        state, count = counted
        return (count < steps) & ~jnp.all(state.done)

    def advance(counted):
        state, count = counted
        return step(state, count >= 0), count + 1

    def step(state, always):
        after = _advance(hulls, pair, limit, state, always, with_witness)
        if not with_witness:
            return after
        # the last step only proves what the one before it found
        keep = after.done & (state.step > 0)
        kept = jax.tree.map(lambda a, b: jnp.where(keep, a, b), state, after)
        return kept._replace(step=after.step, bound=after.bound, done=after.done)

    if state is None:
        state = _beginning(pair, shape, with_witness)
    return jax.lax.while_loop(going, advance, (state, jnp.int32(0)))[0]


def _beginning(pair: Pair, shape: tuple[int, ...], with_witness: bool) -> _State:
    """The state before the first step, which looks along the line of the centres."""
    zero, none = jnp.zeros(shape, jnp.int32), tuple(jnp.zeros((3, *shape)) for _ in range(3))
    nearest = tuple(jnp.broadcast_to(c, shape) for c in pair.offset)
    return _State(
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


def _advance(
    hulls: ConvexHulls, pair: Pair, limit: Array, state: _State, always: Array, with_witness: bool
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
    operands = new, old, state.overlap, bound <= 0, is_first
    nearest, second, third, overlap = closest(computed_once(candidates, always, *operands))
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
    corners = [new, pick(old, state.second), pick(old, state.third)]
    return tuple(jnp.stack([corner[i] for corner in corners]) for i in range(3))
