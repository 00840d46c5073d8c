# SPDX-License-Identifier: MIT
"""Traced and lowered programs that are kept on disk, beside the compile cache.

JAX's compile cache saves the work of XLA; tracing and lowering are done again in each process, and
take longer. `kept` is used in the place of `jax.jit` for functions that the host calls. The first
process that needs such a program exports it (`jax.export`: StableHLO, nothing of Python's), later
processes read it and trace nothing.
"""

import functools
import hashlib
import inspect
import os
import threading
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jax import export
from jax.core import Tracer

from hybrid_jax.runtime.artifacts import write_bytes
from hybrid_jax.runtime.compile_cache import cache_folder

LIMIT = 256 * 2**20
"""Largest total size of the files [bytes]; the ones that were not used for longest go first."""
traced: list[str] = []
"""Names of the programs that this process had to trace, in order: those that no file held."""

_CHECKSUM = hashlib.sha256().digest_size
_ENDING = ".program"
_PACKAGE = Path(__file__).resolve().parents[1]


def kept(
    function: Callable | None = None,
    *,
    static: tuple[str, ...] = (),
    compiler_options: Callable[[], dict | None] = lambda: None,
) -> Callable[..., Any]:
    """Compile a function like `jax.jit`, and keep its traced program on disk.

    Args:
        function: of pytrees of arrays. It must depend on its arguments alone: what it reads
            elsewhere must be a constant of the package's source. An argument that has a method
            `for_programs` is replaced by its result.
        static: names of arguments that are part of the program. Their `repr` must tell all that the
            program depends on: frozen dataclasses, numbers, strings and tuples of them.
        compiler_options: called when a program is compiled, for options of XLA.

    Returns:
        A function of the same arguments; a decorator if `function` is None. Called while JAX traces
        it is as `jax.jit` makes it.
    """
    if function is None:
        return functools.partial(kept, static=static, compiler_options=compiler_options)
    return functools.wraps(function)(KeptProgram(function, static, compiler_options))


class KeptProgram:
    """A function whose programs are kept: one for each structure and shape of its arguments."""

    def __init__(self, function: Callable, static: tuple[str, ...], compiler_options: Callable):
        self._function = function
        self._static = static
        self._compiler_options = compiler_options
        self._jitted = jax.jit(function, static_argnames=static)
        self._signature = inspect.signature(function)
        self._programs: dict[tuple, Callable] = {}
        self._lock = threading.Lock()

    def __call__(self, *args, **kwargs):
        bound = self._signature.bind(*args, **kwargs)
        bound.apply_defaults()
        arguments = bound.arguments
        constants = tuple(arguments.pop(name) for name in self._static)
        shown = {name: _for_programs(value) for name, value in arguments.items()}
        leaves, structure = jax.tree.flatten(shown)
        if any(_needs_jit(leaf) for leaf in leaves):
            return self._jitted(*args, **kwargs)
        shapes = tuple(_shape(leaf) for leaf in leaves)
        key = structure, shapes, constants, jax.config.read("jax_enable_x64")
        program = self._programs.get(key)
        if program is None:
            with self._lock:
                if key not in self._programs:
                    self._programs[key] = self._make(structure, leaves, constants, key)
                program = self._programs[key]
        return program(*leaves)

    def _make(self, structure, leaves: list, constants: tuple, key: tuple) -> Callable:
        """The program for arguments of one structure and shape, read or made."""
        options = self._compiler_options()
        path = _path(self._function, key, options)
        exported = path and _read(path)
        if not exported:

            def flat(*leaves):
                arguments = jax.tree.unflatten(structure, leaves)
                return self._function(
                    **arguments, **dict(zip(self._static, constants, strict=True))
                )

            traced.append(self._function.__qualname__)
            exported = export.export(jax.jit(flat))(*map(_abstract, leaves))
            if path:
                _write(path, exported)
        # what was just exported runs as it is read later: both have one entry in the compile cache
        return jax.jit(exported.call, compiler_options=options)


def _for_programs(argument):
    """An argument without what its programs do not depend on, if it says what that is."""
    return argument.for_programs() if hasattr(argument, "for_programs") else argument


def _needs_jit(leaf) -> bool:
    """Must JAX itself handle this argument: traced, or on other devices than the default one?"""
    if isinstance(leaf, Tracer):
        return True
    return isinstance(leaf, jax.Array) and len(leaf.sharding.device_set) > 1


def _shape(leaf) -> tuple:
    dtype = leaf.dtype if hasattr(leaf, "dtype") else type(leaf)
    return np.shape(leaf), dtype


def _abstract(leaf) -> jax.ShapeDtypeStruct:
    """Shape and type of an argument, as JAX takes it."""
    array = leaf if isinstance(leaf, jax.Array) else jax.eval_shape(jax.numpy.asarray, leaf)
    return jax.ShapeDtypeStruct(array.shape, array.dtype)


@functools.cache
def _source_digest() -> str:
    """Hash of the package's source: a program is of one version of it."""
    digest = hashlib.sha256()
    for path in sorted(_PACKAGE.rglob("*.py")):
        digest.update(str(path.relative_to(_PACKAGE)).encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _path(function: Callable, key: tuple, options: dict | None) -> Path | None:
    """File of a program; None where nothing is kept."""
    folder = cache_folder()
    if folder is None:
        return None
    device = jax.devices()[0]
    parts = (
        f"{function.__module__}.{function.__qualname__}",
        key,
        options,
        _source_digest(),
        jax.__version__,
        version("jaxlib"),
        device.platform,
        device.device_kind,
        jax.config.jax_default_matmul_precision,
        jax.config.jax_default_prng_impl,
    )
    digest = hashlib.sha256(repr(parts).encode()).hexdigest()
    return folder / "programs" / f"{function.__name__}-{digest[:40]}{_ENDING}"


def _read(path: Path) -> export.Exported | None:
    """A kept program; None where there is none, or the file is damaged."""
    try:
        content = path.read_bytes()
        if hashlib.sha256(content[_CHECKSUM:]).digest() != content[:_CHECKSUM]:
            return None
        exported = export.deserialize(bytearray(content[_CHECKSUM:]))
        os.utime(path)  # tells when it was used last
    except OSError:
        return None
    except Exception:  # made by a foreign version of JAX: errors of many classes
        return None
    return exported


def _write(path: Path, exported: export.Exported) -> None:
    """Keep a program, if the folder can be written."""
    content = bytes(exported.serialize())
    try:
        write_bytes(path, hashlib.sha256(content).digest() + content)
        _prune(path.parent)
    except OSError as error:
        _say_once(str(path.parent), error.strerror or str(error))


@functools.cache
def _say_once(folder: str, reason: str) -> None:
    from hybrid_jax.runtime.terminal import remark

    remark(f"programs are not kept in {folder} ({reason}): they are traced again next time")


def _prune(folder: Path) -> None:
    """Remove the files that were not used for longest, down to `LIMIT`."""
    files = []
    for path in folder.glob(f"*{_ENDING}"):
        try:
            status = path.stat()
        except FileNotFoundError:  # another process removed it
            continue
        files.append((status.st_mtime, status.st_size, path))
    surplus = sum(size for _, size, _ in files) - LIMIT
    for _, size, path in sorted(files, key=lambda file: file[0]):
        if surplus <= 0:
            break
        path.unlink(missing_ok=True)
        surplus -= size
