# SPDX-License-Identifier: MIT
"""Every pair measured: the plain answer, for few configurations and for robots of balls."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jax import Array

from hybrid_jax.kernels.collision.broad_phase import column_of, over_columns, pair_flags
from hybrid_jax.kernels.collision.distance import FAR
from hybrid_jax.kernels.collision.nearest_pair import Nearest, smallest, take
from hybrid_jax.kernels.collision.primitive_kinds import PAIRS
from hybrid_jax.kernels.collision.rounded_boxes import RoundedBoxes, Rows


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
    row_boxes = jax.tree.map(lambda a: a[..., None, :, :], row_boxes)
    blocks = jax.tree.map(lambda *a: _join(a)[..., None, :], *(b for b, _ in groups))
    flags = jnp.swapaxes(_join([pair_flags(p).swapaxes(0, 1) for _, p in groups]), 0, 1)
    gap = jnp.where(flags[:, span] > 0, measure(rows, row_boxes, blocks), FAR)

    def nearer(i, state):
        best, column = state
        column_gap = jax.lax.dynamic_index_in_dim(gap, i, keepdims=False)
        return jnp.minimum(best, column_gap), jnp.where(column_gap < best, i, column)

    start = jnp.full(gap.shape[1:], FAR), jnp.zeros(gap.shape[1:], jnp.int32)
    best, column = jax.lax.fori_loop(0, gap.shape[0], nearer, start)
    gaps, row, _ = smallest(best, 1)
    nearest_column = take(column, row)[0]
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
    gaps, row, _ = smallest(best, 1)
    return Nearest(gaps[0], row[0], take(column, row)[0], jnp.full_like(gaps[0], FAR))


def _join(parts: Sequence[Array]) -> Array:
    """Columns of several groups `[..., n, 1 or b]` as one list, along the axis before the batch."""
    batch = max(a.shape[-1] for a in parts)
    return jnp.concatenate([jnp.broadcast_to(a, (*a.shape[:-1], batch)) for a in parts], axis=-2)
