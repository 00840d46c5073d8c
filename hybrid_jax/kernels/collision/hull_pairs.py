# SPDX-License-Identifier: MIT
"""Nearest pairs of a cell with convex hulls: many searches at once, and no more than they need.

Best first: of each configuration the pair with the least lower bound takes some steps, which raise
it, until that of a pair whose distance is known is the least. A search takes a few steps or many,
and lanes that run in step would wait for the slowest: so after some steps the configurations that
are undecided are gathered into full lanes.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from hybrid_jax.kernels.batching import by_backend, in_chunks
from hybrid_jax.kernels.collision.broad_phase import groups_of, row_bounds
from hybrid_jax.kernels.collision.distance import FAR
from hybrid_jax.kernels.collision.gjk import RECORD, pair_of, some_steps
from hybrid_jax.kernels.collision.narrow_phase import promising_pairs
from hybrid_jax.kernels.collision.nearest_pair import Nearest, no_pair
from hybrid_jax.kernels.collision.rounded_boxes import (
    RoundedBoxes,
    cover,
    robot_rows,
    split_blocks,
    world_boxes,
)
from hybrid_jax.types import ConvexHulls, Workcell

_ROWS = 16
"""Rows with the least bounds whose pairs are looked at."""
_PAIRS = 8
"""Pairs of these, of each configuration, that may be measured: more make it certain more often."""
_STEPS = (1, 1, 3, 2)
"""Steps between such choices; the last number is that of all that follow."""
_LANES = 256
"""Pairs that run in step on a CPU: what a step needs of them fits a cache."""
_ACCELERATOR_LANES = 65536
"""The same on an accelerator."""
CONFIGURATIONS = 2048
"""Configurations at once on a CPU: enough that the undecided pairs fill their lanes."""


class _Search(NamedTuple):
    """What is known of some pairs of each configuration, those with the least bounds."""

    bound: Array
    """`[k, b]` lower bounds [m]."""
    done: Array
    """`[k, b]` Is the bound the distance?"""
    record: Array
    """`[k * b, RECORD]` where the searches stand."""


def nearest_pairs(cell: Workcell, q: Array, enough: Array, *, against: str) -> Nearest:
    """Nearest pairs `[b]`; uncertain where more pairs than `_PAIRS` would have to be measured.

    Args:
        cell: leaves `[1 or b, ...]`.
        q: `[b, joint]` [rad or m].
        enough: `[1 or b]` distance beyond which nothing is told apart [m].
        against: `all`, `world` or `own`.
    """
    promising = in_chunks(functools.partial(_promising, against=against), cell, q)
    bound, row, column, rest, rows = promising
    if not bound.shape[1]:
        return no_pair(q.shape[0])
    records, one, other = _bodies(cell, rows, row, column, against)
    hulls = jax.tree.map(lambda a: a[0], cell.hulls)
    limit = jnp.broadcast_to(jnp.minimum(enough, FAR / 2), q.shape[:1])
    found = _measure(hulls, records, (one.T.ravel(), other.T.ravel()), bound.T, limit)
    number = jnp.argmin(found, axis=0)[:, None]
    take = lambda a: jnp.take_along_axis(a, number, 1)[:, 0]  # noqa: E731
    return Nearest(jnp.min(found, axis=0), take(row), take(column), rest)


def _bodies(
    cell: Workcell, rows: Array, row: Array, column: Array, against: str
) -> tuple[Array, Array, Array]:
    """All bodies as records `[n, _]`, and the numbers there of rows and columns `[b, k]`.

    `rows` are the records `[b, row, _]` of the robot; columns are those of `groups_of`.
    """
    configuration = jnp.arange(rows.shape[0], dtype=jnp.int32)[:, None]
    first_row, tables = configuration * rows.shape[1], [rows.reshape(-1, rows.shape[-1])]
    other, offset, first = first_row, len(tables[0]), 0
    for shapes in (cell.fixtures, cell.scene.objects):
        if against == "own" or not shapes.count:
            continue
        table = _records(world_boxes(cell, shapes))
        scene = configuration if len(table) > 1 else 0
        place = offset + scene * shapes.count + column - first
        other = jnp.where(column >= first, place, other)
        tables.append(table.reshape(-1, table.shape[-1]))
        offset, first = offset + len(tables[-1]), first + shapes.count
    own_rows = cover(cell).astype(jnp.int32)
    if against != "world" and own_rows.size:
        # the robot's own columns are some of its rows
        place = first_row + jnp.take(own_rows, column - first, mode="clip")
        other = jnp.where(column >= first, place, other)
    return jnp.concatenate(tables), first_row + row, other


def _promising(cell: Workcell, q: Array, *, against: str) -> tuple[Array, ...]:
    """The pairs with the least bounds, see `promising_pairs`, and the robot's records.

    Returns:
        Bounds [m], rows and columns `[b, k]`, bounds `[b]` of the rest, and records `[b, row, _]`.
    """
    rows, blocks = robot_rows(cell, q)
    cover_blocks, ((span, own, _),) = split_blocks(cell, blocks)
    assert own is not None  # in a cell with hulls every row is read as a block
    groups = groups_of(cell, cover_blocks, against)
    if not groups:
        none = jnp.zeros((q.shape[0], 0), jnp.int32)
        return none.astype(q.dtype), none, none, jnp.full(q.shape[0], FAR), _records(own)
    bounds = None
    if span.stop > _ROWS:
        bounds = jnp.full(rows.centre.shape[1:], FAR)
        for obstacles, pairing in groups:
            bounds = row_bounds(rows, obstacles, pairing, bounds)
    row, column, bound, rest = promising_pairs(rows, own, groups, span, bounds, _ROWS, _PAIRS)
    return bound.T, row.T, column.T, rest, _records(own)


def _records(blocks: RoundedBoxes) -> Array:
    """What a search reads of blocks `[..., n, 1 or b]`, one after the other: `[1 or b, n, _]`."""
    parts = [*blocks.centre, *(c for row in blocks.rotation for c in row)]
    assert blocks.scale is not None and blocks.hull is not None
    parts = jnp.broadcast_arrays(*parts, *blocks.scale, blocks.radius, blocks.hull)
    return jnp.moveaxis(jnp.stack(parts), (0, 2), (2, 0))


def _block(records: Array, number: Array) -> RoundedBoxes:
    """The blocks `[lane]` of records `[n, _]` by their numbers."""
    parts = records.at[number].get(mode="promise_in_bounds")
    c = [parts[:, i] for i in range(parts.shape[1])]
    rotation = [c[3:6], c[6:9], c[9:12]]
    return RoundedBoxes(c[:3], rotation, (), (), c[15], hull=c[16], scale=c[12:15])


def _measure(
    hulls: ConvexHulls, records: Array, pairs: tuple[Array, Array], bound: Array, limit: Array
) -> Array:
    """Bounds `[k, b]` of pairs, of which the least of each configuration is its distance [m].

    Args:
        hulls: tables of the hulls.
        records: bodies, see `_records`.
        pairs: `[k * b]` numbers of the records of either body.
        bound: `[k, b]` lower bounds to start from [m].
        limit: `[b]` distances beyond which nothing is told apart [m].
    """
    lanes = min(by_backend(_LANES, _ACCELERATOR_LANES), len(limit))
    steps = jnp.array(_STEPS)

    def go_on(state):
        number, matters, search, choices = state
        places, used = _places(matters, lanes)

        def block(k, search):
            owner = jax.lax.dynamic_slice_in_dim(places, k * lanes, lanes)
            item = number[owner] * len(limit) + owner
            pair = pair_of(*(_block(records, numbers[item]) for numbers in pairs))
            found = some_steps(hulls, pair, search.record[item], limit[owner], steps[choices])
            return _store(search, item, *found)

        search = jax.lax.fori_loop(0, -(-used // lanes), block, search)
        return *_choose(search, limit), search, jnp.minimum(choices + 1, len(steps) - 1)

    search = _Search(bound, jnp.zeros(bound.shape, bool), jnp.zeros((bound.size, RECORD)))
    state = *_choose(search, limit), search, jnp.int32(0)
    return jax.lax.while_loop(lambda state: jnp.any(state[1]), go_on, state)[2].bound


def _choose(search: _Search, limit: Array) -> tuple[Array, Array]:
    """The pair `[b]` with the least bound, and whether it must be measured, see `_measure`."""
    number = jnp.argmin(search.bound, axis=0).astype(jnp.int32)
    least, done = (jnp.take_along_axis(a, number[None], 0)[0] for a in (search.bound, search.done))
    return number, ~done & (least < limit)


def _store(search: _Search, item: Array, record: Array, bound: Array, done: Array) -> _Search:
    """What is known after some steps of the pairs `item` `[lane]`, some of them twice the same."""
    put = lambda a, new: a.ravel().at[item].set(new).reshape(a.shape)  # noqa: E731
    bound = jnp.maximum(bound, search.bound.ravel()[item])
    record = search.record.at[item].set(record)
    return _Search(put(search.bound, bound), put(search.done, done), record)


def _places(flags: Array, multiple: int) -> tuple[Array, Array]:
    """Where flags `[n]` are set, and the last place again up to a multiple; and how many are."""
    size = -(-len(flags) // multiple) * multiple
    rank = jnp.cumsum(flags, dtype=jnp.int32)
    place = jnp.where(flags, rank - 1, size)
    places = jnp.full(size, len(flags) - 1, jnp.int32)
    number = jnp.arange(len(flags), dtype=jnp.int32)
    return places.at[place].set(number, mode="drop", unique_indices=True), rank[-1]
