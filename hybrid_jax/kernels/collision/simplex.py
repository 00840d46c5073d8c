# SPDX-License-Identifier: MIT
"""Triangles of points: what of them is nearest to the origin. See `gjk`."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import Array

from hybrid_jax.kernels.batching import by_backend
from hybrid_jax.kernels.vec3 import Vector, add, cross, dot, scale, sub

_FLAT = 1e-9
"""Share of the square of an area or a volume, of what its edges could span, that is rounding."""


def pick(points: Vector, number: Array) -> Vector:
    """One of three points, components `[3, ...]`, by its number."""
    return tuple(jnp.where(number == 0, c[0], jnp.where(number == 1, c[1], c[2])) for c in points)


def candidates(
    new: Vector, old: Vector, overlap: Array, may_overlap: Array, is_first: Array
) -> tuple[Vector, Array, Array, Array]:
    """What of three old points, components `[3, ...]`, and a new one may be nearest to the origin.

    Only edges and faces with the new point can be nearer than before. It stands alone where it
    `is_first`: old points that equal it but for rounding would make a face of any direction.

    Returns:
        Points `[3, ...]` of three edges or faces, their squared distances, which are faces, and
        `overlap` of `gjk._State`.
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
    return tuple(points), squared, is_face | overlap, overlap


def closest(candidates: tuple[Vector, Array, Array, Array]) -> tuple:
    """`nearest`, `second`, `third` and `overlap` of `gjk._State` of what `candidates` found."""
    points, squared, is_face, overlap = candidates
    is_second = (squared[1] < squared[0]) & (squared[1] <= squared[2])
    is_third = (squared[2] < squared[0]) & (squared[2] < squared[1])
    second = is_second.astype(jnp.int32) + 2 * is_third.astype(jnp.int32)
    third = jnp.where(pick([is_face], second)[0], (second + 1) % 3, second)
    return scale(pick(points, second), jnp.where(overlap, -1.0, 1.0)), second, third, overlap


def computed_once(function: Callable, always: Array, *operands):
    """A function's result, computed once: XLA's CPU back end repeats it for each of its uses.

    It does not look into a branch, here of a condition `[]` that is always met.
    """
    if by_backend(False, True):
        return function(*operands)
    shapes = jax.eval_shape(function, *operands)
    zeros = lambda *_: jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), shapes)  # noqa: E731
    return jax.lax.cond(always, function, zeros, *operands)


def shares(corners: list[Vector], point: Vector) -> list[Array]:
    """Shares of the corners of a triangle, which may be an edge, that a point in it consists of."""
    first, second, offset = (sub(p, corners[0]) for p in (*corners[1:], point))
    # corners that coincide share what they get: a little on the diagonal decides it
    little = 1e-6 * (dot(first, first) + dot(second, second)) + 1e-12
    aa, bb = dot(first, first) + little, dot(second, second) + little
    ab, ap, bp = dot(first, second), dot(first, offset), dot(second, offset)
    area = aa * bb - ab * ab
    u, v = (ap * bb - bp * ab) / area, (bp * aa - ap * ab) / area
    return [1.0 - u - v, u, v]
