# SPDX-License-Identifier: MIT
"""Broad phase: cheap bounds of the distances of many rows (robot) and columns (obstacles).

The distance of enclosing boxes along the world's axes is never larger than the distance itself.
Components first, batch last, throughout: `b` is the batch, or 1 for what it shares. Loops stand
where a value has several uses: their operands are computed once, while XLA's CPU back end repeats
a fused expression for each use.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from hybrid_jax.errors import InputError
from hybrid_jax.kernels import vec3
from hybrid_jax.kernels.collision.distance import FAR
from hybrid_jax.kernels.collision.rounded_boxes import RoundedBoxes, Rows, world_boxes
from hybrid_jax.types import Workcell

_MANY = 16
"""Number of columns from which the rough bound pays: the fixtures have more, the robot less."""


class Pairing(NamedTuple):
    """Which rows and columns count as a pair."""

    allowed: Array
    """`[row, column]` 1 or 0."""
    payload: Array
    """`[row]` 1 for the payload's slots."""
    support: Array
    """`[column, b]` 0 where the payload may touch."""


def _gaps(centre, extent, obstacles) -> list[Array]:
    """Gaps [m] of the enclosing boxes along the world's three axes, without the balls."""
    return [
        jnp.abs(centre[i] - obstacles.centre[i]) - extent[i] - obstacles.extent[i] for i in range(3)
    ]


def _worst(gaps: list[Array]) -> Array:
    """Largest of the three gaps: by it alone the boxes are this far apart, or overlap this deep."""
    return jnp.maximum(jnp.maximum(gaps[0], gaps[1]), gaps[2])


def pair_bound(centre, extent, radius, other) -> Array:
    """Lower bound of the signed distance [m]: that of the enclosing boxes, less the radii.

    Args:
        centre, extent: three components `[row, b]` of `Rows` [m].
        radius: `[row, b]` [m].
        other: obstacles, `RoundedBoxes` whose components broadcast against those.

    Returns:
        Bounds of the broadcast shape [m]: `[row, b]` for one column, `[column, row, b]` for all.
    """
    gaps = _gaps(centre, extent, other)
    outside = jnp.sqrt(sum(jnp.square(jnp.maximum(g, 0.0)) for g in gaps))
    return outside + jnp.minimum(_worst(gaps), 0.0) - radius - other.radius


def box_bound(own: RoundedBoxes, other: RoundedBoxes) -> Array:
    """Lower bound of the signed distance [m]: separation along the faces' normals of the boxes.

    Args:
        own, other: blocks whose components broadcast; `half_extents` are those of a box around.
    """
    offset = vec3.sub(other.centre, own.centre)
    axes, other_axes = (
        [[block.rotation[i][k] for i in range(3)] for k in range(3)] for block in (own, other)
    )
    cosines = [[jnp.abs(vec3.dot(a, b)) for b in other_axes] for a in axes]
    best = jnp.full_like(offset[0], -FAR)
    for k in range(3):
        reach = own.half_extents[k] + vec3.dot(cosines[k], other.half_extents)
        best = jnp.maximum(best, jnp.abs(vec3.dot(axes[k], offset)) - reach)
        reach = other.half_extents[k] + vec3.dot([c[k] for c in cosines], own.half_extents)
        best = jnp.maximum(best, jnp.abs(vec3.dot(other_axes[k], offset)) - reach)
    return best - own.radius - other.radius


def _rough_bound(centre, extent, radius, obstacles) -> Array:
    """Bound along the worst axis alone: cheaper than `pair_bound`, without a root, and looser."""
    return _worst(_gaps(centre, extent, obstacles)) - radius - obstacles.radius


def column_of(record, index: Array):
    """Slice one block or row out of a record.

    Component by component: sliced as one array they vectorise badly on a CPU.

    Args:
        record: `RoundedBoxes` or `Rows` of n, leaves `[..., n, b]`.
        index: `[]` which of them.

    Returns:
        A record of the same kind: nested lists of components `[b]`.
    """

    def split(a):
        if a.ndim > 2:
            return [split(part) for part in a]
        return jax.lax.dynamic_index_in_dim(a, index, keepdims=False)

    return jax.tree.map(split, record)


def pair_flags(pairing: Pairing) -> Array:
    """Flags `[column, row, 1 or b]`: 1 where a pair counts, else 0."""
    # the payload alone is spared a contact, and only with what supports it
    exempt = pairing.payload[:, None] * (1 - pairing.support[:, None])
    return pairing.allowed.T[:, :, None] * (1 - exempt)


def row_bounds(rows: Rows, blocks: RoundedBoxes, pairing: Pairing, best: Array) -> Array:
    """Smallest lower bound of each row's distance over all columns.

    A pair that does not count is put `FAR` away by a sum: what the payload may touch can differ
    within a batch, and a table of all pairs for all of it would not fit a cache.

    Args:
        rows: the robot's primitives.
        blocks: obstacles, the columns.
        pairing: which pairs count.
        best: `[row, b]` bounds to start from, of other columns or `FAR` [m].

    Returns:
        `[row, b]` [m].
    """
    count = blocks.radius.shape[0]
    bound = _rough_bound if count >= _MANY else pair_bound
    barred_offset, support_offset = FAR * (1 - pairing.allowed.T), FAR * (1 - pairing.support)

    def step(i, best):
        column_bound = bound(rows.centre, rows.extent, rows.radius, column_of(blocks, i))
        barred_column, support_column = (
            jax.lax.dynamic_index_in_dim(a, i, keepdims=False)
            for a in (barred_offset, support_offset)
        )
        return jnp.minimum(
            best, column_bound + barred_column[:, None] + pairing.payload[:, None] * support_column
        )

    return over_columns(count, step, best)


def over_columns(count: int, step: Callable, state):
    """`lax.fori_loop` over columns, four of them in one pass over the rows.

    The last pass may go on beyond the last column. Indices are cut off there, so `step` sees that
    column again; it must not mind.
    """
    # at least two passes: unrolled altogether, the loop would be none
    unroll = min(4, -(-count // 2))
    passes = -(-count // max(unroll, 1))
    return jax.lax.fori_loop(0, passes * unroll, step, state, unroll=unroll or None)


def groups_of(
    cell: Workcell, own: RoundedBoxes, against: str
) -> list[tuple[RoundedBoxes, Pairing]]:
    """Obstacles and which of them count for which row: fixtures, objects, the robot itself.

    Fixtures stand apart from objects because they are the same for a whole batch. `own` are the
    robot's primitives `ContactPairs.cover`; `against` is `all`, `world` or `own`.
    """
    pairs, scene, fixtures = cell.pairs, cell.scene, cell.fixtures
    if pairs.world.shape[0] != 1:
        raise InputError("a batch of cells must share its contact pairs: vmap over scenes only")
    payload, count = pairs.payload[0], fixtures.count
    groups = []
    if against != "own":
        object_support = jnp.ones((scene.objects.count, 1))
        fixed, movable = pairs.world[0, :, :count], pairs.world[0, :, count:]
        groups = [
            (world_boxes(cell, fixtures), Pairing(fixed, payload, scene.support_on.T)),
            (world_boxes(cell, scene.objects), Pairing(movable, payload, object_support)),
        ]
    if against != "world":
        own_support = jnp.ones((own.radius.shape[0], 1))
        groups.append((own, Pairing(pairs.own[0], payload, own_support)))
    return [(blocks, pairing) for blocks, pairing in groups if blocks.radius.shape[0]]
