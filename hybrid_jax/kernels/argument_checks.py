# SPDX-License-Identifier: MIT
"""Refuse bad arguments before anything is traced, naming the offender."""

import functools
import inspect
from collections.abc import Callable

import jax
import numpy as np
from jax.core import Tracer

from hybrid_jax.errors import InputError

_UNIT = 1e-3
"""How far the norm of a unit quaternion may be from 1."""


def _values(name: str, value, size: int, what: str) -> np.ndarray | None:
    """Values `[size]` of an argument on the host, or None while JAX traces it."""
    shape = np.shape(value)
    if shape != (size,):
        hint = "; batch with jax.vmap" if len(shape) > 1 and shape[-1] == size else ""
        raise InputError(f"{name} has shape {shape}; {what} has shape ({size},){hint}")
    if isinstance(value, Tracer):
        return None  # a traced array has a shape, and no values yet
    numbers = np.asarray(value)
    for i in np.flatnonzero(~np.isfinite(numbers)):
        raise InputError(f"{name}[{i}] is {numbers[i]}: every value must be finite")
    return numbers


def configuration(name: str, value, cell) -> None:
    """Check that a value is a configuration of the cell's arm.

    Args:
        name: of the argument, for the message.
        value: `[joint]` [rad or m]; finite unless it is being traced.
        cell: whose arm it is for.

    Raises:
        InputError: another shape, or a value that is not finite.
    """
    # programs see the cell without its names
    joints = f"of {', '.join(cell.joint_names)}" if cell.source else "of the arm"
    _values(name, value, cell.home.shape[-1], f"a configuration {joints}")


def pose(name: str, value, cell) -> None:
    """Check that a value is a unit dual quaternion.

    Args:
        name: of the argument, for the message.
        value: `[8]` pose; its values are checked unless it is being traced.
        cell: not needed; checks share one signature.

    Raises:
        InputError: another shape, a value that is not finite, or no rigid pose.
    """
    numbers = _values(name, value, 8, "a pose (dual quaternion)")
    if numbers is None:
        return
    norm = float(np.linalg.norm(numbers[:4]))
    if abs(norm - 1) > _UNIT:
        raise InputError(
            f"{name}[0:4], the rotation of the pose, has norm {norm:.4f}, not 1: normalise it"
        )
    inner_product = float(numbers[:4] @ numbers[4:])
    if abs(inner_product) > _UNIT:
        raise InputError(
            f"{name} is no rigid pose: its parts [0:4] and [4:8] must be orthogonal, "
            f"their product is {inner_product:.4f}"
        )


def single_precision(function: Callable) -> Callable:
    """Make a function run in single precision, whatever `jax_enable_x64` says.

    The kernels' arrays are float32. With x64 on, constants and inputs would be float64, and JAX
    refuses loops whose carry changes its type.
    """

    @functools.wraps(function)
    def run(*args, **kwargs):
        if not jax.config.read("jax_enable_x64"):
            return function(*args, **kwargs)
        args, kwargs = jax.tree.map(_single, (args, kwargs))
        with jax.enable_x64(False):
            return function(*args, **kwargs)

    return run


def _single(leaf):
    """Convert a 64-bit leaf of a pytree to 32 bits; leave any other as it is."""
    is_double = isinstance(leaf, jax.Array | np.ndarray) and leaf.dtype in (np.float64, np.int64)
    return leaf.astype(np.float32 if leaf.dtype == np.float64 else np.int32) if is_double else leaf


def checks(**kinds: Callable) -> Callable:
    """Make a function check its arguments, then run in single precision.

    Args:
        kinds: check for each argument by its name, as `configuration` or `pose`. An argument that
            is None is left alone.

    Returns:
        A decorator; the function's other arguments must include `cell` where a check needs it.
    """

    def wrap(function):
        names, run = list(inspect.signature(function).parameters), single_precision(function)

        @functools.wraps(function)
        def checked(*args, **kwargs):
            arguments = dict(zip(names, args, strict=False)) | kwargs
            for name, kind in kinds.items():
                if arguments.get(name) is not None:
                    kind(name, arguments[name], arguments.get("cell"))
            return run(*args, **kwargs)

        return checked

    return wrap
