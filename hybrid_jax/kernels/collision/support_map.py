# SPDX-License-Identifier: MIT
"""Support map of convex hulls: the vertex that is farthest along a direction, by a table.

Directions are cut into cells, the squares of a cube around the origin. A table holds for each cell
the vertices that can be the farthest there: few, however many the hull has.
"""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from hybrid_jax.kernels.vec3 import Vector
from hybrid_jax.types import ConvexHulls

SQUARES = 12
"""Squares along an edge of the cube. It is even: no cell of a box's table has two corners."""
CELLS = 6 * SQUARES**2
"""Cells of all directions."""
SLICE = 12
"""Candidates that are looked at together: nearly all cells have no more. Of a round rim that lies
across an axis a cell has a quarter, as four cells meet at that axis."""


def cell_corners() -> np.ndarray:
    """Directions `[CELLS, 4, 3]` of the corners of each cell, not normalised: they span its cone.

    Cells are numbered by the axis that a direction is longest along, its sign, and the squares
    along the two axes that follow.
    """
    ticks = np.linspace(-1, 1, SQUARES + 1)
    corners = np.empty((CELLS, 4, 3))
    numbers = itertools.product(range(3), (-1, 1), range(SQUARES), range(SQUARES))
    for cell, (axis, sign, i, j) in enumerate(numbers):
        corners[cell, :, axis] = sign
        corners[cell, :, (axis + 1) % 3] = ticks[[i, i, i + 1, i + 1]]
        corners[cell, :, (axis + 2) % 3] = ticks[[j, j + 1, j, j + 1]]
    return corners


def cell_of(direction: Vector) -> Array:
    """Number `[...]` of the cell that a direction is in; any cell for a direction of no length."""
    size = [jnp.abs(c) for c in direction]
    is_x = (size[0] >= size[1]) & (size[0] >= size[2])
    is_y = ~is_x & (size[1] >= size[2])
    choose = lambda x, y, z: jnp.where(is_x, x, jnp.where(is_y, y, z))  # noqa: E731
    x, y, z = direction
    scale = 0.5 * SQUARES / jnp.maximum(choose(*size), 1e-30)
    square = lambda c: jnp.clip((c * scale + 0.5 * SQUARES).astype(jnp.int32), 0, SQUARES - 1)  # noqa: E731
    side = 2 * choose(0, 1, 2) + (choose(x, y, z) > 0)
    return (side * SQUARES + square(choose(y, z, x))) * SQUARES + square(choose(z, x, y))


def farthest_vertex(hulls: ConvexHulls, hull: Array, direction: Vector) -> Vector:
    """The vertex of a hull that is farthest along a direction, three components `[...]` [m].

    Args:
        hulls: tables of all hulls.
        hull: `[...]` number of the hull.
        direction: three components `[...]` in the hull's frame, of any length.
    """
    cell = hull * CELLS + cell_of(direction)
    first, last = (hulls.first.at[cell + i].get(mode="promise_in_bounds") for i in range(2))

    def seen(number):
        """Candidates `[..., 3, SLICE]` of a slice, and how far they are along the direction.

        One slice for each direction: a CPU copies it far faster than it gathers its numbers.
        """
        vertices = hulls.candidates.at[number].get(mode="promise_in_bounds")
        return vertices, sum(vertices[..., i, :] * direction[i][..., None] for i in range(3))

    def look(number, state):
        farthest, chosen = state
        number = jnp.minimum(first + number, last - 1)
        along = jnp.max(seen(number)[1], axis=-1)
        return jnp.maximum(along, farthest), jnp.where(along > farthest, number, chosen)

    start, slices = (jnp.full_like(direction[0], -jnp.inf), first), jnp.max(last - first)
    chosen = jax.lax.fori_loop(0, jnp.where(slices > 1, slices, 0), look, start)[1]
    vertices, along = seen(chosen)
    # the number first, then the components: chosen one by one, they could come from two vertices
    # that are as far, as XLA rounds a repeated computation differently
    best = jnp.argmax(along, axis=-1)[..., None, None]
    point = jnp.take_along_axis(vertices, best, -1, mode="promise_in_bounds")[..., 0]
    return tuple(point[..., i] for i in range(3))
