# SPDX-License-Identifier: MIT
"""The nearest pair of primitives of each configuration, and how the least of many is found."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from hybrid_jax.kernels.collision.distance import FAR


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


def no_pair(batch: int) -> Nearest:
    """What is known of `batch` configurations before anything is measured."""
    zero, far = jnp.zeros(batch, jnp.int32), jnp.full(batch, FAR)
    return Nearest(far, zero, zero, far)


def smallest(values: Array, count: int) -> tuple[Array, Array, Array]:
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


def least_bounds(bounds: Array, count: int) -> tuple[Array, Array, Array]:
    """`smallest` of lower bounds, rounded down by so much that each holds its own number.

    One number is compared instead of two, and no two are equal: that takes far less time.
    """
    size = bounds.shape[0]
    digits = (1 << max(1, (size - 1).bit_length())) - 1
    as_sorted = lambda bits: jnp.where(bits < 0, bits ^ 0x7FFFFFFF, bits)  # noqa: E731
    # the bits of a float, with those of negative ones reversed, stand in its order
    keys = as_sorted(jax.lax.bitcast_convert_type(bounds, jnp.int32)) & ~digits
    keys |= jnp.arange(size, dtype=jnp.int32).reshape(size, *(1,) * (bounds.ndim - 1))
    least = [jnp.min(keys, axis=0)]
    for _ in range(count):
        least.append(jnp.min(jnp.where(keys > least[-1], keys, 0x7FFFFFFF), axis=0))
    least = jnp.stack(least)
    rounded = jax.lax.bitcast_convert_type(as_sorted(least & ~digits), jnp.float32)
    rounded = jnp.where(rounded < FAR / 2, rounded, FAR)
    return rounded[:count], least[:count] & digits, rounded[count]


def take(array: Array, index: Array) -> Array:
    """Entries along the axis before the last: `[..., n, 1 or b]` at `[k, b]` to `[..., k, b]`."""
    if array.shape[-1] == 1:
        return array[..., 0][..., index]
    index = index.reshape((1,) * (array.ndim - 2) + index.shape)
    return jnp.take_along_axis(array, index, -2, mode="promise_in_bounds")
