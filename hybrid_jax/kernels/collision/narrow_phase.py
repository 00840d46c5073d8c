# SPDX-License-Identifier: MIT
"""Narrow phase: exact distances of the pairs that the bounds leave, and the nearest of all.

Only the most promising pairs are measured. The answer is certified where no unmeasured pair's bound
is below it; `clearance` measures the others in full. Layout and loops as in the broad phase.

A group of obstacles is (blocks, pairing). Columns are numbered through all groups.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from hybrid_jax.kernels.collision.broad_phase import (
    column_of,
    over_columns,
    pair_bound,
    pair_flags,
)
from hybrid_jax.kernels.collision.distance import FAR
from hybrid_jax.kernels.collision.primitive_kinds import PAIRS
from hybrid_jax.kernels.collision.rounded_boxes import RoundedBoxes, Rows

_WORD = 24
"""Flags in one word: float32 counts that far exactly."""


class Nearest(NamedTuple):
    """The nearest pair of each configuration of a batch."""

    distance: Array
    """`[b]` signed [m]; `FAR` where there is no pair."""
    row: Array
    """`[b]` the robot's or payload's primitive."""
    column: Array
    """`[b]` the obstacle, numbered through all groups."""
    rest: Array
    """`[b]` smallest lower bound of a pair that was not measured [m]."""

    @property
    def certain(self) -> Array:
        """`[b]` False where an unmeasured pair might be nearer."""
        return self.rest >= self.distance

    def merge(self, other: "Nearest") -> "Nearest":
        """The nearer `[b]` of two answers about disjoint sets of pairs."""
        nearer = other.distance < self.distance
        return Nearest(
            distance=jnp.where(nearer, other.distance, self.distance),
            row=jnp.where(nearer, other.row, self.row),
            column=jnp.where(nearer, other.column, self.column),
            rest=jnp.minimum(self.rest, other.rest),
        )


def _smallest(values: Array, count: int) -> tuple[Array, Array, Array]:
    """The `count` smallest along the first axis, where they stand, and the smallest of the rest.

    From values `[n, ...]` to `[count, ...]` twice and `[...]`; of equals the first one comes first.
    """
    size = values.shape[0]
    index = jnp.arange(size, dtype=jnp.int32).reshape(size, *(1,) * (values.ndim - 1))
    smallest, positions = [], []
    for _ in range(count):
        least = jnp.min(values, axis=0)
        position = jnp.min(jnp.where(values == least, index, size - 1), axis=0)
        smallest, positions = [*smallest, least], [*positions, position]
        values = jnp.where(index == position, FAR, values)
    return jnp.stack(smallest), jnp.stack(positions), jnp.min(values, axis=0)


def _take(array: Array, index: Array) -> Array:
    """Entries along the axis before the last: `[..., n, 1 or b]` at `[k, b]` to `[..., k, b]`."""
    if array.shape[-1] == 1:
        return array[..., 0][..., index]
    index = index.reshape((1,) * (array.ndim - 2) + index.shape)
    return jnp.take_along_axis(array, index, -2, mode="promise_in_bounds")


def _take_rows(record, index: Array):
    return type(record)(*(_take(a, index) for a in record))


def _row_flags(allowed: Array, row: Array) -> Array:
    """Flags `[column, k, b]` of the rows `[k, b]`, gathered as bit words of 24 columns each."""
    columns = allowed.shape[1]
    words = []
    for first in range(0, columns, _WORD):
        flags = allowed[:, first : first + _WORD]
        packed = (flags @ 2.0 ** jnp.arange(flags.shape[1])).astype(jnp.int32)[:, None]
        shift = jnp.arange(flags.shape[1], dtype=jnp.int32)[:, None, None]
        words.append((_take(packed, row)[None] >> shift) & 1)
    return jnp.concatenate(words)


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
    _, span_index, other_rows = _smallest(best[span], count)
    row = span_index + span.start
    promising = _take_rows(rows, row)
    bounds = []
    for blocks, pairing in groups:
        obstacles = RoundedBoxes(*(a[..., None, :] for a in blocks))
        allowed = _row_flags(pairing.allowed, row)
        exempt = _take(pairing.payload[:, None], row) * (1 - pairing.support[:, None])
        bound = pair_bound(promising.centre, promising.extent, promising.radius, obstacles)
        bounds.append(jnp.where(allowed - exempt > 0.5, bound, FAR))
    # a flat list of pairs, column by column: its index is column * count + rank of the row
    table = jnp.concatenate(bounds).reshape(columns * count, -1)
    bound, flat, other_pairs = _smallest(table, pairs)
    column, rank = flat // count, flat % count
    operands = (
        _take_rows(promising, rank),
        row_boxes and _take_rows(row_boxes, _take(span_index, rank)),
        _pick([b for b, _ in groups], column),
    )

    def step(k, gap):
        pair_distance = measure(*(record and column_of(record, k) for record in operands))
        return gap.at[k].set(jnp.where(bound[k] < FAR / 2, pair_distance, FAR))

    gap = jax.lax.fori_loop(0, pairs, step, jnp.full_like(bound, FAR))
    gaps, nearest, _ = _smallest(gap, 1)
    nearest_row = _take(_take(row, rank), nearest)[0]
    return Nearest(
        gaps[0], nearest_row, _take(column, nearest)[0], jnp.minimum(other_rows, other_pairs)
    )


def _choose(blocks: RoundedBoxes, index: Array) -> RoundedBoxes:
    """Blocks by number `[k, b]`; zeros where the number is none of theirs.

    By products with ones and zeros, or by selection: on a CPU gathers cost more.
    """
    size = blocks.radius.shape[0]
    flags = (jnp.arange(size)[:, None, None] == index).astype(blocks.centre.dtype)

    def take(a) -> Any:
        if a.shape[-1] == 1:
            # a GPU's default precision, TF32, would round positions
            return jnp.einsum("...n,nkb->...kb", a[..., 0], flags, precision="highest")
        return sum(jnp.where(index == n, a[..., n : n + 1, :], 0.0) for n in range(size))

    return RoundedBoxes(*(take(a) for a in blocks))


def _pick(groups: list[RoundedBoxes], column: Array) -> RoundedBoxes:
    """Obstacles by column number over all groups."""
    # exactly one group has the column, the others give zeros: their sum is that obstacle
    parts, first = [], 0
    for blocks in groups:
        parts.append(_choose(blocks, column - first))
        first += blocks.radius.shape[0]
    return jax.tree.map(lambda *a: sum(a), *parts)


def tabulate(measure, rows, row_boxes, groups, span: slice) -> Nearest:
    """Measure every pair of some rows: the plain answer, for few configurations.

    All pairs at once, then the least of them by a loop: slices of columns inside the measuring, or
    a minimum that is merged with it, do not vectorise on a CPU.

    Args:
        measure: distance of the pair, see `primitive_kinds.PAIRS`.
        rows: the robot's primitives, all of them.
        row_boxes: those of `span` as blocks where their kind is read so, else None.
        groups: (blocks, pairing) of obstacles.
        span: the rows to measure, all of one kind.

    Returns:
        The nearest pair of each configuration, leaves `[b]`.
    """
    rows = Rows(*(a[..., None, span, :] for a in rows))
    row_boxes = row_boxes and RoundedBoxes(*(a[..., None, :, :] for a in row_boxes))
    blocks = RoundedBoxes(
        *(_join(a)[..., None, :] for a in zip(*(b for b, _ in groups), strict=True))
    )
    flags = jnp.swapaxes(_join([pair_flags(p).swapaxes(0, 1) for _, p in groups]), 0, 1)
    gap = jnp.where(flags[:, span] > 0, measure(rows, row_boxes, blocks), FAR)

    def nearer(i, state):
        best, column = state
        column_gap = jax.lax.dynamic_index_in_dim(gap, i, keepdims=False)
        return jnp.minimum(best, column_gap), jnp.where(column_gap < best, i, column)

    start = jnp.full(gap.shape[1:], FAR), jnp.zeros(gap.shape[1:], jnp.int32)
    best, column = jax.lax.fori_loop(0, gap.shape[0], nearer, start)
    gaps, row, _ = _smallest(best, 1)
    nearest_column = _take(column, row)[0]
    return Nearest(gaps[0], row[0] + span.start, nearest_column, jnp.full_like(gaps[0], FAR))


def around(rows: Rows, own: RoundedBoxes, groups) -> Nearest:
    """Measure every pair of a robot of balls, which is as cheap as a bound.

    Args:
        rows: the robot's balls.
        own: its balls `ContactPairs.cover` as blocks; where they are a group, balls meet balls.
        groups: (blocks, pairing) of obstacles.

    Returns:
        The nearest pair of each configuration, leaves `[b]`.
    """
    best = jnp.full(rows.radius.shape[:-1] + rows.centre.shape[-1:], FAR)
    state, first = (best, jnp.zeros(best.shape, jnp.int32)), 0
    for blocks, pairing in groups:
        counts, count = pair_flags(pairing), blocks.radius.shape[0]
        measure = PAIRS["ball", "ball" if blocks is own else "rounded box"]

        def step(i, state, blocks=blocks, counts=counts, first=first, measure=measure):
            best, column = state
            column_gap = measure(rows, None, column_of(blocks, i))
            counted_gap = jnp.where(counts[i] > 0, column_gap, FAR)
            return jnp.minimum(best, counted_gap), jnp.where(counted_gap < best, first + i, column)

        state = over_columns(count, step, state)
        first += count
    best, column = state
    gaps, row, _ = _smallest(best, 1)
    return Nearest(gaps[0], row[0], _take(column, row)[0], jnp.full_like(gaps[0], FAR))


def _join(parts) -> Array:
    """Columns of several groups `[..., n, 1 or b]` as one list, along the axis before the batch."""
    batch = max(a.shape[-1] for a in parts)
    return jnp.concatenate([jnp.broadcast_to(a, (*a.shape[:-1], batch)) for a in parts], axis=-2)
