# SPDX-License-Identifier: MIT
"""Refuse bad arguments before anything is traced, naming the offender."""

import functools
import inspect
from collections.abc import Callable

import jax
import numpy as np

from hybrid_jax.errors import InputError

_UNIT = 1e-3
"""How far the norm of a unit quaternion may be from 1."""


def _values(name: str, value, size: int, what: str) -> np.ndarray | None:
    """The numbers of an argument, or None where it is being traced."""
    shape = np.shape(value)
    if shape != (size,):
        hint = "; batch with jax.vmap" if len(shape) > 1 and shape[-1] == size else ""
        raise InputError(f"{name} has shape {shape}; {what} has shape ({size},){hint}")
    if isinstance(value, jax.core.Tracer):
        return None
    numbers = np.asarray(value)
    for i in np.flatnonzero(~np.isfinite(numbers)):
        raise InputError(f"{name}[{i}] is {numbers[i]}: every value must be finite")
    return numbers


def configuration(name: str, value, cell) -> None:
    """A configuration of the cell's arm."""
    joints = len(cell.joint_names)
    listed = f"a configuration of {', '.join(cell.joint_names)}"
    _values(name, value, joints, listed)


def pose(name: str, value, cell) -> None:
    """A unit dual quaternion."""
    numbers = _values(name, value, 8, "a pose (dual quaternion)")
    if numbers is None:
        return
    norm = float(np.linalg.norm(numbers[:4]))
    if abs(norm - 1) > _UNIT:
        raise InputError(
            f"{name}[0:4], the rotation of the pose, has norm {norm:.4f}, not 1: normalise it"
        )
    mixed = float(numbers[:4] @ numbers[4:])
    if abs(mixed) > _UNIT:
        raise InputError(
            f"{name} is no rigid pose: its parts [0:4] and [4:8] must be orthogonal, "
            f"their product is {mixed:.4f}"
        )


def single_precision(function: Callable) -> Callable:
    """Decorator: run in single precision, whatever `jax_enable_x64` says.

    The kernels' arrays are float32. With x64 on, constants and inputs would be float64, and loops
    whose carry changes its type are refused.
    """

    @functools.wraps(function)
    def run(*args, **kwargs):
        if not jax.config.jax_enable_x64:
            return function(*args, **kwargs)
        args, kwargs = jax.tree.map(_single, (args, kwargs))
        with jax.enable_x64(False):
            return function(*args, **kwargs)

    return run


def _single(leaf):
    wide = isinstance(leaf, jax.Array | np.ndarray) and leaf.dtype in (np.float64, np.int64)
    return leaf.astype(np.float32 if leaf.dtype == np.float64 else np.int32) if wide else leaf


def checks(**kinds: Callable) -> Callable:
    """Decorator: check the named arguments, None is left alone; run in single precision."""

    def wrap(function):
        names, run = list(inspect.signature(function).parameters), single_precision(function)

        @functools.wraps(function)
        def checked(*args, **kwargs):
            given = dict(zip(names, args, strict=False)) | kwargs
            for name, kind in kinds.items():
                if given.get(name) is not None:
                    kind(name, given[name], given.get("cell"))
            return run(*args, **kwargs)

        return checked

    return wrap
