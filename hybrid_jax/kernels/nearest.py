# SPDX-License-Identifier: MIT
"""The nearest pair of many robot primitives (rows) and many obstacles (columns).

Bounds of all pairs are cheap: the distance of enclosing boxes along the world's axes is never
larger than the distance itself. Only the most promising pairs are measured exactly. The answer is
certified where no unmeasured pair's bound is below it; the rest is measured in full.
Components first, batch last, throughout. Loops stand where a value has several uses: their operands
are computed once, while XLA's CPU back end repeats a fused expression for each use.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from hybrid_jax.kernels import distance
from hybrid_jax.kernels.distance import FAR
from hybrid_jax.kernels.primitives import Blocks, Rows

_WORD = 24
"""Flags in one word: float32 counts that far exactly."""
_MANY = 16
"""Columns from which on a rough bound pays: fixtures yes, the robot's own few links no."""


class Pairing(NamedTuple):
    """Which rows and columns count as a pair."""

    allowed: Array
    """`[row, column]` 1 or 0."""
    payload: Array
    """`[row]` 1 for the payload's slots."""
    support: Array
    """`[column, b]` 0 where the payload may touch."""


class Nearest(NamedTuple):
    """The nearest pair of each configuration."""

    distance: Array
    """`[b]` signed [m]; `FAR` where there is no pair."""
    row: Array
    """`[b]`"""
    column: Array
    """`[b]`"""
    rest: Array
    """`[b]` smallest bound of a pair that was not measured [m]."""

    @property
    def certain(self) -> Array:
        """`[b]` False where an unmeasured pair might be nearer."""
        return self.rest >= self.distance

    def merge(self, other: "Nearest") -> "Nearest":
        """The nearer of two answers about disjoint sets of pairs."""
        nearer = other.distance < self.distance
        pick = [jnp.where(nearer, b, a) for a, b in zip(self[:3], other[:3], strict=True)]
        return Nearest(*pick, jnp.minimum(self.rest, other.rest))


def _gaps(centre, extent, other) -> list[Array]:
    """Gaps of the enclosing boxes along the world's axes, without the balls."""
    return [jnp.abs(centre[i] - other.centre[i]) - extent[i] - other.extent[i] for i in range(3)]


def _worst(gaps: list[Array]) -> Array:
    return jnp.maximum(jnp.maximum(gaps[0], gaps[1]), gaps[2])


def _bound(centre, extent, radius, other) -> Array:
    """Lower bound of the signed distance: that of the enclosing boxes, less the radii."""
    gaps = _gaps(centre, extent, other)
    apart = jnp.sqrt(sum(jnp.square(jnp.maximum(g, 0.0)) for g in gaps))
    return apart + jnp.minimum(_worst(gaps), 0.0) - radius - other.radius


def _rough_bound(centre, extent, radius, other) -> Array:
    """The same along the worst axis alone: cheaper, without a root, and looser."""
    return _worst(_gaps(centre, extent, other)) - radius - other.radius


def _column(record, index: Array):
    """One block or row, sliced by component: as one slice they vectorise badly on a CPU."""

    def split(a):
        if a.ndim > 2:
            return [split(part) for part in a]
        return jax.lax.dynamic_index_in_dim(a, index, keepdims=False)

    return type(record)(*(split(a) for a in record))


def _counts(pairing: Pairing) -> Array:
    """`[column, row, 1 or b]` 1 where a pair counts."""
    spared = pairing.payload[:, None] * (1 - pairing.support[:, None])
    return pairing.allowed.T[:, :, None] * (1 - spared)


def row_bounds(rows: Rows, blocks: Blocks, pairing: Pairing, best: Array) -> Array:
    """Smallest bound of each row over the columns, `[row, b]`, starting from `best`.

    A pair that does not count is put `FAR` away by a sum: what the payload may touch can differ
    within a batch, and a table of all pairs for all of it would not fit a cache.
    """
    count = blocks.radius.shape[0]
    bound = _rough_bound if count >= _MANY else _bound
    barred, spared = FAR * (1 - pairing.allowed.T), FAR * (1 - pairing.support)

    def step(i, best):
        found = bound(rows.centre, rows.extent, rows.radius, _column(blocks, i))
        here, support = (
            jax.lax.dynamic_index_in_dim(a, i, keepdims=False) for a in (barred, spared)
        )
        return jnp.minimum(best, found + here[:, None] + pairing.payload[:, None] * support)

    return jax.lax.fori_loop(0, count, step, best, unroll=_unroll(count))


def _unroll(count: int) -> int:
    """How many columns to take in one pass over the rows, without a remainder outside the loop."""
    return next(n for n in (4, 3, 2, 1) if count % n == 0 and (count > n or n == 1))


def _smallest(values: Array, count: int) -> tuple[Array, Array, Array]:
    """The `count` smallest along the first axis, where they stand, and the smallest of the rest."""
    size = values.shape[0]
    index = jnp.arange(size, dtype=jnp.int32).reshape(size, *(1,) * (values.ndim - 1))
    found, at = [], []
    for _ in range(count):
        best = jnp.min(values, axis=0)
        where = jnp.min(jnp.where(values == best, index, size - 1), axis=0)
        found, at = [*found, best], [*at, where]
        values = jnp.where(index == where, FAR, values)
    return jnp.stack(found), jnp.stack(at), jnp.min(values, axis=0)


def _take(array: Array, index: Array) -> Array:
    """Entries along the axis before the last: `[..., n, 1 or b]`, `[k, b]` to `[..., k, b]`."""
    if array.shape[-1] == 1:
        return array[..., 0][..., index]
    index = index.reshape((1,) * (array.ndim - 2) + index.shape)
    return jnp.take_along_axis(array, index, -2, mode="promise_in_bounds")


def _take_rows(record, index: Array):
    return type(record)(*(_take(a, index) for a in record))


def measure(rows: Rows, whole: Blocks | None, block: Blocks) -> Array:
    """Exact distances of rows and blocks of one shape.

    Args:
        rows: the robot's primitives.
        whole: the same rows as blocks where they are boxes, else None: they are capsules.
        block: the obstacles.
    """
    if whole is not None:
        return distance.swept_blocks(whole, block)
    return distance.swept_capsule(rows.centre, rows.axis, rows.radius, block)


def _row_flags(allowed: Array, row: Array) -> Array:
    """`[column, k, b]` flags of the rows `[k, b]`, gathered as bit words of 24 columns each."""
    columns = allowed.shape[1]
    words = []
    for first in range(0, columns, _WORD):
        flags = allowed[:, first : first + _WORD]
        packed = (flags @ 2.0 ** jnp.arange(flags.shape[1])).astype(jnp.int32)[:, None]
        shift = jnp.arange(flags.shape[1], dtype=jnp.int32)[:, None, None]
        words.append((_take(packed, row)[None] >> shift) & 1)
    return jnp.concatenate(words)


def search(rows, whole, groups, some: slice, best: Array, count: int, pairs: int) -> Nearest:
    """Measure the most promising pairs: the best `pairs` of those of the best `count` rows.

    Args:
        rows: the robot's primitives.
        whole: those of `some` as blocks where they are boxes, else None.
        groups: (blocks, pairing) of obstacles, columns numbered through.
        some: the rows to search, all capsules or all boxes.
        best: `row_bounds` over all groups.
    """
    columns = sum(blocks.radius.shape[0] for blocks, _ in groups)
    count = min(count, some.stop - some.start)
    pairs = min(pairs, count * columns)
    _, place, other_rows = _smallest(best[some], count)
    row = place + some.start
    taken = _take_rows(rows, row)
    bounds = []
    for blocks, pairing in groups:
        wide = Blocks(*(a[..., None, :] for a in blocks))
        counts = _row_flags(pairing.allowed, row)
        spared = _take(pairing.payload[:, None], row) * (1 - pairing.support[:, None])
        bound = _bound(taken.centre, taken.extent, taken.radius, wide)
        bounds.append(jnp.where(counts - spared > 0.5, bound, FAR))
    table = jnp.concatenate(bounds).reshape(columns * count, -1)
    bound, at, other_pairs = _smallest(table, pairs)
    column, which = at // count, at % count
    chosen = (
        _take_rows(taken, which),
        whole and _take_rows(whole, _take(place, which)),
        _pick([b for b, _ in groups], column),
    )

    def step(k, gap):
        found = measure(*(record and _column(record, k) for record in chosen))
        return gap.at[k].set(jnp.where(bound[k] < FAR / 2, found, FAR))

    gap = jax.lax.fori_loop(0, pairs, step, jnp.full_like(bound, FAR))
    found, first, _ = _smallest(gap, 1)
    winner = _take(_take(row, which), first)[0]
    return Nearest(found[0], winner, _take(column, first)[0], jnp.minimum(other_rows, other_pairs))


def _choose(blocks: Blocks, index: Array) -> Blocks:
    """Blocks by number `[k, b]`; zeros where the number is none of theirs.

    By products with ones and zeros, or by selection: on a CPU gathers cost more.
    """
    size = blocks.radius.shape[0]
    chosen = (jnp.arange(size)[:, None, None] == index).astype(blocks.centre.dtype)

    def take(a):
        if a.shape[-1] == 1:
            return jnp.einsum("...n,nkb->...kb", a[..., 0], chosen, precision="highest")
        return sum(jnp.where(index == n, a[..., n : n + 1, :], 0.0) for n in range(size))

    return Blocks(*(take(a) for a in blocks))


def _pick(groups: list[Blocks], column: Array) -> Blocks:
    """Obstacles by column number over all groups."""
    parts, first = [], 0
    for blocks in groups:
        parts.append(_choose(blocks, column - first))
        first += blocks.radius.shape[0]
    return jax.tree.map(lambda *a: sum(a), *parts)


def tabulate(rows, whole, groups, some: slice) -> Nearest:
    """Measure every pair of `some` rows: the plain answer, for few configurations.

    All pairs at once, then the least of them by a loop: slices of columns inside the measuring, or
    a minimum that is merged with it, do not vectorise on a CPU.
    """
    rows = Rows(*(a[..., None, some, :] for a in rows))
    whole = whole and Blocks(*(a[..., None, :, :] for a in whole))
    blocks = Blocks(*(_join(a)[..., None, :] for a in zip(*(b for b, _ in groups), strict=True)))
    counts = jnp.swapaxes(_join([_counts(p).swapaxes(0, 1) for _, p in groups]), 0, 1)
    gap = jnp.where(counts[:, some] > 0, measure(rows, whole, blocks), FAR)

    def nearer(i, state):
        best, at = state
        here = jax.lax.dynamic_index_in_dim(gap, i, keepdims=False)
        return jnp.minimum(best, here), jnp.where(here < best, i, at)

    start = jnp.full(gap.shape[1:], FAR), jnp.zeros(gap.shape[1:], jnp.int32)
    best, at = jax.lax.fori_loop(0, gap.shape[0], nearer, start)
    found, row, _ = _smallest(best, 1)
    winner = _take(at, row)[0]
    return Nearest(found[0], row[0] + some.start, winner, jnp.full_like(found[0], FAR))


def around(rows: Rows, own: Blocks, groups) -> Nearest:
    """The exact answer for a robot of balls: every pair, as cheap as a bound of one.

    Args:
        rows: the robot's balls.
        own: the same as blocks; where they are a group, balls meet balls.
        groups: blocks, and which of them count for which row.
    """
    best = jnp.full(rows.radius.shape[:-1] + rows.centre.shape[-1:], FAR)
    state, first = (best, jnp.zeros(best.shape, jnp.int32)), 0
    for blocks, pairing in groups:
        counts, count = _counts(pairing), blocks.radius.shape[0]
        apart = distance.ball_ball if blocks is own else distance.ball_block

        def step(i, state, blocks=blocks, counts=counts, first=first, apart=apart):
            best, at = state
            found = apart(rows.centre, rows.radius, _column(blocks, i))
            here = jnp.where(counts[i] > 0, found, FAR)
            return jnp.minimum(best, here), jnp.where(here < best, first + i, at)

        state = jax.lax.fori_loop(0, count, step, state, unroll=_unroll(count))
        first += count
    best, at = state
    found, row, _ = _smallest(best, 1)
    return Nearest(found[0], row[0], _take(at, row)[0], jnp.full_like(found[0], FAR))


def _join(parts) -> Array:
    """Columns of several groups as one list: along the axis before the batch."""
    batch = max(a.shape[-1] for a in parts)
    return jnp.concatenate([jnp.broadcast_to(a, (*a.shape[:-1], batch)) for a in parts], axis=-2)
