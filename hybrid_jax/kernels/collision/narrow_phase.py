# SPDX-License-Identifier: MIT
"""Narrow phase: exact distances of the pairs that the bounds leave, and the nearest of all.

The most promising pairs are measured first. An answer is certain where no unmeasured pair's bound
is below it. `search` measures a fixed number of pairs, and `clearance` measures in full what is
uncertain then; `refine` goes on until all is certain. Layout and loops as in the broad phase.

A group of obstacles is (blocks, pairing). Columns are numbered through all groups.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from hybrid_jax.kernels.collision.broad_phase import (
    box_bound,
    column_of,
    pair_bound,
)
from hybrid_jax.kernels.collision.distance import FAR
from hybrid_jax.kernels.collision.nearest_pair import Nearest, least_bounds, smallest, take
from hybrid_jax.kernels.collision.rounded_boxes import RoundedBoxes, Rows

_ROWS_AT_ONCE, _PAIRS_AT_ONCE = 5, 3
"""Rows, and pairs of these, that one step of refining takes."""
_HULLS_AT_ONCE, _HULL_PAIRS_AT_ONCE = 16, 2
"""The same where there are hulls: a robot has few of them, and a pair costs much."""
_WORD = 24
"""Flags in one word: float32 counts that far exactly."""


def _take_rows(record, index: Array):
    return jax.tree.map(lambda a: take(a, index), record)


def _row_flags(allowed: Array, row: Array) -> Array:
    """Flags `[column, k, b]` of the rows `[k, b]`, gathered as bit words of 24 columns each."""
    columns = allowed.shape[1]
    words = []
    for first in range(0, columns, _WORD):
        flags = allowed[:, first : first + _WORD]
        packed = (flags @ 2.0 ** jnp.arange(flags.shape[1])).astype(jnp.int32)[:, None]
        shift = jnp.arange(flags.shape[1], dtype=jnp.int32)[:, None, None]
        words.append((take(packed, row)[None] >> shift) & 1)
    return jnp.concatenate(words)


def promising_pairs(
    rows, row_boxes, groups, span: slice, best: Array | None, count: int, pairs: int
) -> tuple[Array, Array, Array, Array]:
    """The pairs with the least bounds, of the rows with the least; see `search`.

    Args:
        rows, row_boxes, groups, span, count, pairs: see `search`.
        best: the same; None where `count` is all rows of `span`.

    Returns:
        Rows, columns and bounds [m] of the pairs `[pair, b]`, and the least bound `[b]` of others.
    """
    columns = sum(blocks.radius.shape[0] for blocks, _ in groups)
    own, batch = row_boxes, rows.centre.shape[-1]
    if best is None:
        count = span.stop - span.start
        row = jnp.broadcast_to(jnp.arange(span.start, span.stop)[:, None], (count, batch))
        promising, other_rows = jax.tree.map(lambda a: a[..., span, :], rows), jnp.full(batch, FAR)
    else:
        _, index, other_rows = smallest(best[span], count)
        row = index + span.start
        promising, own = _take_rows(rows, row), row_boxes and _take_rows(row_boxes, index)
    pairs = min(pairs, count * columns)
    table = _pair_bounds(promising, own, row, groups).reshape(columns * count, -1)
    bound, flat, other_pairs = least_bounds(table, pairs)
    row = jnp.take_along_axis(row, flat % count, 0)
    return row, flat // count, bound, jnp.minimum(other_rows, other_pairs)


def search(
    measure, rows, row_boxes, groups, span: slice, best: Array, count: int, pairs: int
) -> Nearest:
    """Measure the most promising pairs: those with the least bounds, of the rows with the least.

    Args:
        measure: distance of the pair, see `primitive_kinds.PAIRS`.
        rows: the robot's primitives, all of them.
        row_boxes: those of `span` as blocks where their kind is read so, else None.
        groups: (blocks, pairing) of obstacles.
        span: the rows to search, all of one kind.
        best: `[row, b]` bounds of all rows, `row_bounds` over all groups [m].
        count: rows to look at.
        pairs: pairs to measure of these rows.

    Returns:
        The nearest measured pair of each configuration, leaves `[b]`.
    """
    columns = sum(blocks.radius.shape[0] for blocks, _ in groups)
    count = min(count, span.stop - span.start)
    pairs = min(pairs, count * columns)
    _, span_index, other_rows = smallest(best[span], count)
    row = span_index + span.start
    promising = _take_rows(rows, row)
    # a flat list of pairs, column by column: its index is column * count + rank of the row
    own = row_boxes and _take_rows(row_boxes, span_index)
    table = _pair_bounds(promising, own, row, groups).reshape(columns * count, -1)
    bound, flat, other_pairs = smallest(table, pairs)
    column, rank = flat // count, flat % count
    operands = (
        _take_rows(promising, rank),
        own and _take_rows(own, rank),
        _pick([b for b, _ in groups], column),
    )
    distance, nearest = _measure(measure, operands, bound)
    nearest_row = take(take(row, rank), nearest)[0]
    nearest_column = take(column, nearest)[0]
    return Nearest(distance, nearest_row, nearest_column, jnp.minimum(other_rows, other_pairs))


def _measure(measure, operands, bound: Array, is_bound: bool = False) -> tuple[Array, Array]:
    """The least distance `[b]` [m] of pairs with bounds `[pair, b]`, and its pair `[1, b]`.

    `is_bound` says that what is measured is but a bound where a pair overlaps: the better counts.
    """

    def step(k, gap):
        pair_distance = measure(*(record and column_of(record, k) for record in operands))
        if is_bound:
            pair_distance = jnp.maximum(pair_distance, bound[k])
        return gap.at[k].set(jnp.where(bound[k] < FAR / 2, pair_distance, FAR))

    gap = jax.lax.fori_loop(0, len(bound), step, jnp.full_like(bound, FAR))
    gaps, nearest, _ = smallest(gap, 1)
    return gaps[0], nearest


def _pair_bounds(promising: Rows, own: RoundedBoxes | None, row: Array, groups) -> Array:
    """Bounds of rows `[k, b]` and all obstacles `[column, k, b]` [m]; `FAR` for no pair."""
    bounds = []
    for blocks, pairing in groups:
        obstacles = jax.tree.map(lambda a: a[..., None, :], blocks)
        allowed = _row_flags(pairing.allowed, row)
        exempt = take(pairing.payload[:, None], row) * (1 - pairing.support[:, None])
        bound = pair_bound(promising.centre, promising.extent, promising.radius, obstacles)
        if own and own.hull is not None:
            bound = jnp.maximum(bound, box_bound(own, obstacles))
        bounds.append(jnp.where(allowed - exempt > 0.5, bound, FAR))
    return jnp.concatenate(bounds)


def refine(
    measure, rows, row_boxes, groups, span: slice, best: Array, known: Nearest, enough: Array
) -> Nearest:
    """Measure the pairs of some rows in the order of their bounds, until nothing is undecided.

    Args:
        measure: distance of the pair, see `primitive_kinds.PAIRS`.
        rows: the robot's primitives, all of them.
        row_boxes: those of `span` as blocks where their kind is read so, else None.
        groups: (blocks, pairing) of obstacles.
        span: the rows to search, all of one kind.
        best: `[row, b]` bounds of all rows, `row_bounds` over all groups [m].
        known: the nearest pair of other rows.
        enough: `[1 or b]` distance beyond which nothing is told apart [m].

    Returns:
        The nearest pair of each configuration, leaves `[b]`.
    """
    hulls = row_boxes is not None and row_boxes.hull is not None
    count = min(_HULLS_AT_ONCE if hulls else _ROWS_AT_ONCE, span.stop - span.start)
    columns = sum(blocks.radius.shape[0] for blocks, _ in groups)
    pairs = min(_HULL_PAIRS_AT_ONCE if hulls else _PAIRS_AT_ONCE, count * columns)
    span_number = jnp.arange(span.stop - span.start, dtype=jnp.int32)[:, None, None]
    pair_number = jnp.arange(columns * count, dtype=jnp.int32)[:, None, None]

    def undecided(state):
        """Is any pair left, `[row or pair, b]`, that may be nearer than what is known?"""
        bounds, nearest = state
        return jnp.any(jnp.min(bounds, axis=0) < jnp.minimum(nearest.distance, enough))

    def look_at_rows(state):
        bounds, nearest = state
        _, index, _ = smallest(bounds, count)
        row = index + span.start
        promising = _take_rows(rows, row)
        # a flat list of pairs, as in `search`
        own = row_boxes and _take_rows(row_boxes, index)
        table = _pair_bounds(promising, own, row, groups).reshape(columns * count, -1)

        def measure_pairs(state):
            table, nearest = state
            bound, flat, _ = smallest(table, pairs)
            column, rank = flat // count, flat % count
            operands = (
                _take_rows(promising, rank),
                own and _take_rows(own, rank),
                _pick([b for b, _ in groups], column),
            )
            near = measure
            if hulls:
                # a pair that is farther than this changes nothing
                limit = jnp.minimum(nearest.distance, enough)
                near = functools.partial(measure, enough=limit)
            distance, at = _measure(near, operands, bound, is_bound=hulls)
            found_row, found_column = take(take(row, rank), at)[0], take(column, at)[0]
            found = Nearest(distance, found_row, found_column, nearest.rest)
            is_measured = jnp.any(pair_number == flat, axis=1)
            return jnp.where(is_measured, FAR, table), nearest.merge(found)

        nearest = jax.lax.while_loop(undecided, measure_pairs, (table, nearest))[1]
        return jnp.where(jnp.any(span_number == index, axis=1), FAR, bounds), nearest

    return jax.lax.while_loop(undecided, look_at_rows, (best[span], known))[1]


def _choose(blocks: RoundedBoxes, index: Array) -> RoundedBoxes:
    """Blocks by number `[k, b]`; zeros where the number is none of theirs.

    By products with ones and zeros, or by selection: on a CPU gathers cost more.
    """
    size = blocks.radius.shape[0]
    flags = (jnp.arange(size)[:, None, None] == index).astype(blocks.centre.dtype)

    def choose(a) -> Any:
        if a.shape[-1] == 1:
            # a GPU's default precision, TF32, would round positions
            return jnp.einsum("...n,nkb->...kb", a[..., 0], flags, precision="highest")
        return sum(jnp.where(index == n, a[..., n : n + 1, :], 0.0) for n in range(size))

    return jax.tree.map(choose, blocks)


def _pick(groups: list[RoundedBoxes], column: Array) -> RoundedBoxes:
    """Obstacles by column number over all groups."""
    # exactly one group has the column, the others give zeros: their sum is that obstacle
    parts, first = [], 0
    for blocks in groups:
        parts.append(_choose(blocks, column - first))
        first += blocks.radius.shape[0]
    return jax.tree.map(lambda *a: sum(a), *parts)
