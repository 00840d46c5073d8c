# SPDX-License-Identifier: MIT
"""Single-item functions that run as one kernel over whole batches, however they are vmapped.

A kernel takes leaves with a leading axis of 1 (shared) or B (one per item) and returns leaves
with a leading axis of B. `batched` turns it into a function of one item; any nest of `jax.vmap`
around that function reaches the kernel as one flat batch, also inside the caller's own `jit`.
"""

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.custom_batching import custom_vmap

T = TypeVar("T")

CPU_CHUNK = 256
"""Items at once on a CPU: the working set of a chunk stays in the second-level cache."""
ACCELERATOR_CHUNK = 65536
"""The same on an accelerator: bounds the memory of one pass."""


def by_backend(cpu: T, accelerator: T) -> T:
    """Choose the number of items to take at once, or such numbers, for JAX's default back end.

    Few items fit a CPU's cache; as few would leave an accelerator waiting.
    """
    return cpu if jax.default_backend() == "cpu" else accelerator


def batch_size(args) -> int:
    """Batch size B of a kernel's arguments, leaves `[1 or B, ...]`."""
    return max(leaf.shape[0] for leaf in jax.tree.leaves(args))


def map_items(function: Callable, args, size: int):
    """Apply `function` to the leaves that have one entry per item.

    Args:
        function: takes and returns a leaf `[size, ...]`.
        args: leaves `[1 or size, ...]`; those of one entry are passed through as they are.
        size: of the batch.
    """
    return jax.tree.map(lambda a: function(a) if a.shape[0] == size else a, args)


def padded_chunks(count: int, size: int, single: bool = True) -> list[tuple[np.ndarray, int]]:
    """Cut the indices 0 .. count - 1 into chunks of one size: few programs serve any count.

    The last chunk repeats its last index.

    Args:
        count: of the indices.
        size: of a chunk.
        single: where three quarters of a chunk would be padding, each item is a chunk of its own.

    Returns:
        Indices `[size]` or `[1]` of each chunk, and how many of them are no padding.
    """
    if single and 4 * count <= size:
        return [(np.array([i]), 1) for i in range(count)]
    firsts = range(0, count, size)
    return [
        (np.minimum(np.arange(first, first + size), count - 1), min(size, count - first))
        for first in firsts
    ]


def in_calls(run: Callable, count: int, sizes: tuple[int, ...]):
    """Run a program over rows, in calls of few sizes: few programs serve any count.

    Args:
        run: from numbers of rows `[size]` to leaves `[size, ...]`. Those after the first `used`,
            its second argument, are padding.
        count: rows in all, at least 1.
        sizes: of the calls, in ascending order: the smallest that suffices is used.

    Returns:
        The results of all rows on the host, leaves `[count, ...]`.
    """
    results, start = [], 0
    while start < count:
        size = next((n for n in sizes if n >= count - start), sizes[-1])
        rows, used = np.minimum(np.arange(start, start + size), count - 1), min(size, count - start)
        result = jax.device_get(run(rows, used))
        results.append(jax.tree.map(lambda a, used=used: a[:used], result))
        start += size
    return results[0] if len(results) == 1 else jax.tree.map(lambda *a: np.concatenate(a), *results)


def batched(kernel: Callable) -> Callable:
    """Turn a kernel of whole batches into a function of one item.

    Args:
        kernel: takes leaves `[1 or B, ...]`, returns leaves `[B, ...]`.

    Returns:
        Function of the same arguments and results without the batch axis, to be vmapped.
    """

    @custom_vmap
    def over_batch(*args):
        return kernel(*args)

    @over_batch.def_vmap
    def _merge(axis_size, in_batched, *args):
        """Flatten a further batch axis into the one the kernel knows."""
        inner_size = max(
            a.shape[1] if is_batched else a.shape[0]
            for a, is_batched in zip(
                jax.tree.leaves(args), jax.tree.leaves(in_batched), strict=True
            )
        )

        def merge(a, is_batched):
            # what all items share stays one entry: the kernel broadcasts it
            if not is_batched and a.shape[0] == 1:
                return a
            a = a if is_batched else jnp.broadcast_to(a, (axis_size, *a.shape))
            a = jnp.broadcast_to(a, (axis_size, inner_size, *a.shape[2:]))
            return a.reshape(axis_size * inner_size, *a.shape[2:])

        results = over_batch(*jax.tree.map(merge, args, tuple(in_batched)))
        results = jax.tree.map(lambda a: a.reshape(axis_size, inner_size, *a.shape[1:]), results)
        return results, jax.tree.map(lambda _: True, results)

    def single_item(*args):
        results = over_batch(*jax.tree.map(lambda a: jnp.asarray(a)[None], args))
        return jax.tree.map(lambda a: a[0], results)

    return single_item


def in_chunks(kernel: Callable, *args, cpu_chunk: int = CPU_CHUNK):
    """Run a kernel over a batch, a chunk at a time, to bound its working set.

    Args:
        kernel: takes leaves `[1 or b, ...]`, returns leaves `[b, ...]`.
        args: its arguments for the whole batch, leaves `[1 or B, ...]`.
        cpu_chunk: items in a chunk on a CPU.

    Returns:
        The kernel's results, leaves `[B, ...]`.
    """
    size = batch_size(args)
    chunk = by_backend(cpu_chunk, ACCELERATOR_CHUNK)
    if size <= chunk:
        return kernel(*args)
    count = -(-size // chunk)
    surplus = count * chunk - size  # `lax.map` needs chunks of one size
    leaves, treedef = jax.tree.flatten(args)
    per_item = [a.shape[0] == size for a in leaves]

    def to_chunks(a):
        a = jnp.concatenate([a, jnp.broadcast_to(a[-1:], (surplus, *a.shape[1:]))])
        return a.reshape(count, chunk, *a.shape[1:])

    def run(pieces):
        pieces = iter(pieces)
        chunk_leaves = [
            next(pieces) if has_batch else a for a, has_batch in zip(leaves, per_item, strict=True)
        ]
        return kernel(*jax.tree.unflatten(treedef, chunk_leaves))

    results = jax.lax.map(
        run, [to_chunks(a) for a, has_batch in zip(leaves, per_item, strict=True) if has_batch]
    )
    return jax.tree.map(lambda a: a.reshape(count * chunk, *a.shape[2:])[:size], results)


def first_items(run: Callable, items: Array, used: Array):
    """`jax.lax.map(run, items)` of the first `used` items; 0 for the others, which take no time."""
    shapes = jax.eval_shape(run, items[0])
    empty = jax.tree.map(lambda a: jnp.zeros((len(items), *a.shape), a.dtype), shapes)

    def step(number, results):
        new = run(items[number])
        return jax.tree.map(lambda a, b: a.at[number].set(b), results, new)

    return jax.lax.fori_loop(0, used, step, empty)


def redo(kernel: Callable, args, found, pending, chunk: int):
    """Run a kernel again for the pending items of a batch, `chunk` of them at a time.

    Args:
        kernel: returns leaves like those of `found`.
        args: the kernel's arguments, leaves `[1 or B, ...]`.
        found: results so far, leaves `[B, ...]`.
        pending: `[B]` True where `found` is to be replaced.
        chunk: items in one pass.

    Returns:
        `found` with the pending items replaced, leaves `[B, ...]`.
    """
    size = batch_size(args)
    chunk = min(chunk, size)
    # shapes are static under `jit`: `fill_value` fills the last pass with item 0 as often as needed
    order = jnp.nonzero(pending, size=-(-size // chunk) * chunk, fill_value=0)[0]
    count = jnp.sum(pending)

    def step(state):
        done, results = state
        items = jax.lax.dynamic_slice_in_dim(order, done, chunk)
        recomputed = kernel(*map_items(lambda a: a[items], args, size))
        return done + chunk, jax.tree.map(
            lambda old, new: old.at[items].set(new), results, recomputed
        )

    return jax.lax.while_loop(lambda state: state[0] < count, step, (jnp.int32(0), found))[1]
