# SPDX-License-Identifier: MIT
"""Spread batches over the devices of a machine; on a CPU, over its cores."""

import contextlib
import os

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from hybrid_jax.errors import DeviceError
from hybrid_jax.runtime.compiler_options import vector_options


def use_all_cores() -> None:
    """Make every core a JAX device, where there is no accelerator.

    XLA runs most kernels of this package on one core: each operation on a chunk is too small to
    be worth sharing. All commands do so: XLA's compiled programs are of a number of devices, and so
    training makes those of the other commands. Call it first: once a device has been used it has no
    effect, and no error is raised.
    """
    with contextlib.suppress(RuntimeError):
        jax.config.update("jax_num_cpu_devices", usable_cores())


def usable_cores() -> int:
    """Number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):  # Linux alone
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def require_device() -> None:
    """Make sure that JAX has a device of a platform that it may use.

    Raises:
        DeviceError: this machine has no device of the platforms in JAX_PLATFORMS.
    """
    try:
        jax.devices()
    except (RuntimeError, AssertionError) as error:  # the latter without a word, for lack of CUDA
        platforms = jax.config.jax_platforms
        raise DeviceError(
            f"JAX has no device of the platforms {platforms!r} that JAX_PLATFORMS asks for"
            f"{f' ({error})' if str(error) else ''}; JAX_PLATFORMS=cpu uses the processor"
        ) from None


class Spread:
    """Runs a function of one item over whole batches, split over devices."""

    def __init__(self, devices=None):
        self.devices = list(devices or jax.local_devices())
        self.mesh = Mesh(np.array(self.devices), ("item",))
        self._split = NamedSharding(self.mesh, PartitionSpec("item"))
        self._whole = NamedSharding(self.mesh, PartitionSpec())

    def share(self, tree):
        """A copy of `tree` on every device."""
        return jax.device_put(tree, self._whole)

    def split(self, array):
        """`array` cut along its first axis, one piece on each device."""
        return jax.device_put(array, self._split)

    def over(self, function, items: int, shared: int = 0, options: dict | None = None):
        """Compile `function(cell, *items, *shared)` of one item for batches.

        Args:
            function: its first argument is the same for all items.
            items: number of next arguments, which have one entry per item.
            shared: number of further arguments that are the same for all items.
            options: of XLA's compiler; `vector_options` if None.

        Returns:
            A function of the same arguments, those per item as `[item, ...]`, to `[item, ...]`.
            The number of items must be a multiple of the number of devices.
        """

        def run(first, *arguments):
            batched, common = arguments[:items], arguments[items:]
            return jax.vmap(lambda *row: function(first, *row, *common))(*batched)

        by_item, replicated = PartitionSpec("item"), PartitionSpec()
        specs = (replicated, *[by_item] * items, *[replicated] * shared)
        mapped = jax.shard_map(
            run, mesh=self.mesh, in_specs=specs, out_specs=by_item, check_vma=False
        )
        options = vector_options() if options is None else options
        return jax.jit(mapped, compiler_options=options)
