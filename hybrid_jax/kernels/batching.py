# SPDX-License-Identifier: MIT
"""Single-item functions that run as one kernel over whole batches, however they are vmapped.

A kernel takes leaves with a leading axis of 1 (shared) or B (one per item) and returns leaves
with a leading axis of B. `batched` turns it into a function of one item; any nest of `jax.vmap`
around that function reaches the kernel as one flat batch, also inside the caller's own `jit`.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_batching import custom_vmap

CPU_CHUNK = 256
"""Items at once on a CPU: the working set of a chunk stays in the second-level cache."""
ACCELERATOR_CHUNK = 65536
"""The same on an accelerator: bounds the memory of one pass."""


def by_backend(cpu: int, accelerator: int) -> int:
    """How many items to take at once: few fit a CPU's cache, few leave an accelerator waiting."""
    return cpu if jax.default_backend() == "cpu" else accelerator


def batch_size(args) -> int:
    """The B of a kernel's arguments."""
    return max(leaf.shape[0] for leaf in jax.tree.leaves(args))


def map_items(function: Callable, args, size: int):
    """Apply `function` to the leaves that have one entry per item, passing shared ones through."""
    return jax.tree.map(lambda a: function(a) if a.shape[0] == size else a, args)


def padded_chunks(count: int, size: int) -> list[tuple[np.ndarray, int]]:
    """Indices 0 .. count - 1 in chunks of one size, so that few programs serve any count.

    Where three quarters of a chunk would be padding, each item is a chunk of its own. The last
    chunk repeats its last index.

    Returns:
        Indices `[size]` or `[1]` of each chunk, and how many of them count.
    """
    if 4 * count <= size:
        return [(np.array([i]), 1) for i in range(count)]
    firsts = range(0, count, size)
    return [
        (np.minimum(np.arange(first, first + size), count - 1), min(size, count - first))
        for first in firsts
    ]


def batched(kernel: Callable) -> Callable:
    """Function of one item from a kernel of whole batches; see the module."""

    @custom_vmap
    def whole(*args):
        return kernel(*args)

    @whole.def_vmap
    def _merge(axis_size, in_batched, *args):
        """Flatten a further batch axis into the one the kernel knows."""
        inner = max(
            a.shape[1] if on else a.shape[0]
            for a, on in zip(jax.tree.leaves(args), jax.tree.leaves(in_batched), strict=True)
        )

        def merge(a, on):
            if not on and a.shape[0] == 1:
                return a
            a = a if on else jnp.broadcast_to(a, (axis_size, *a.shape))
            a = jnp.broadcast_to(a, (axis_size, inner, *a.shape[2:]))
            return a.reshape(axis_size * inner, *a.shape[2:])

        out = whole(*jax.tree.map(merge, args, tuple(in_batched)))
        out = jax.tree.map(lambda a: a.reshape(axis_size, inner, *a.shape[1:]), out)
        return out, jax.tree.map(lambda _: True, out)

    def one(*args):
        out = whole(*jax.tree.map(lambda a: jnp.asarray(a)[None], args))
        return jax.tree.map(lambda a: a[0], out)

    return one


def in_chunks(kernel: Callable, *args, cpu_chunk: int = CPU_CHUNK):
    """Run a kernel over a batch piece by piece."""
    size = batch_size(args)
    chunk = by_backend(cpu_chunk, ACCELERATOR_CHUNK)
    if size <= chunk:
        return kernel(*args)
    count = -(-size // chunk)
    spare = count * chunk - size
    leaves, structure = jax.tree.flatten(args)
    own = [a.shape[0] == size for a in leaves]

    def split(a):
        a = jnp.concatenate([a, jnp.broadcast_to(a[-1:], (spare, *a.shape[1:]))])
        return a.reshape(count, chunk, *a.shape[1:])

    def run(pieces):
        pieces = iter(pieces)
        whole = [next(pieces) if mine else a for a, mine in zip(leaves, own, strict=True)]
        return kernel(*jax.tree.unflatten(structure, whole))

    out = jax.lax.map(run, [split(a) for a, mine in zip(leaves, own, strict=True) if mine])
    return jax.tree.map(lambda a: a.reshape(count * chunk, *a.shape[2:])[:size], out)


def redo(kernel: Callable, args, found, pending, chunk: int):
    """Run a kernel again for the pending items of a batch, `chunk` of them at a time.

    Args:
        kernel: returns leaves like those of `found`.
        args: the kernel's arguments, leaves `[1 or B, ...]`.
        found: what is known so far, leaves `[B, ...]`.
        pending: `[B]` where `found` is to be replaced.
    """
    size = batch_size(args)
    chunk = min(chunk, size)
    order = jnp.nonzero(pending, size=-(-size // chunk) * chunk, fill_value=0)[0]
    count = jnp.sum(pending)

    def step(state):
        done, found = state
        items = jax.lax.dynamic_slice_in_dim(order, done, chunk)
        again = kernel(*map_items(lambda a: a[items], args, size))
        return done + chunk, jax.tree.map(lambda old, new: old.at[items].set(new), found, again)

    return jax.lax.while_loop(lambda state: state[0] < count, step, (jnp.int32(0), found))[1]
