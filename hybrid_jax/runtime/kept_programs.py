# SPDX-License-Identifier: MIT
"""Traced and lowered programs that are kept on disk, beside the compile cache.

JAX's compile cache saves the work of XLA; tracing and lowering are done again in each process, and
take longer. `kept` is used in the place of `jax.jit` for functions that the host calls. The first
process that needs such a program exports it (`jax.export`: StableHLO, nothing of Python's), later
processes read it and trace nothing.
"""

import functools
import inspect
import threading
import weakref
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import jax
from jax import export
from jax.core import Tracer

from hybrid_jax.runtime import program_files
from hybrid_jax.runtime.compile_cache import enable_compile_cache
from hybrid_jax.runtime.compiler_options import few_pieces, quick_options
from hybrid_jax.runtime.devices import require_device
from hybrid_jax.runtime.program_durations import making
from hybrid_jax.runtime.tree_descriptions import describe, structure_of

traced: list[str] = []
"""Names of the programs that this process had to trace, in order: those that no file held."""

AT_ONCE, MOST_AHEAD = 2, 64
"""Programs that are loaded ahead in parallel, and the most that a purpose is taken to need."""


def kept(
    function: Callable | None = None,
    *,
    static: tuple[str, ...] = (),
    hot: bool = False,
) -> Callable[..., Any]:
    """Compile a function like `jax.jit`, and keep its traced program on disk.

    Args:
        function: of pytrees of arrays. It must depend on its arguments alone: what it reads
            elsewhere must be a constant of the package's source. An argument that has a method
            `for_programs` is replaced by its result.
        static: names of arguments that are part of the program. Their `repr` must tell all that the
            program depends on: frozen dataclasses, numbers, strings and tuples of them.
        hot: how long it runs matters more than how long it is compiled: see `quick_options`.

    Returns:
        A function of the same arguments; a decorator if `function` is None. Called while JAX traces
        it is as `jax.jit` makes it.
    """
    if function is None:
        return functools.partial(kept, static=static, hot=hot)
    return functools.wraps(function)(KeptProgram(function, static, hot))


_all: weakref.WeakSet = weakref.WeakSet()


def forget_programs() -> None:
    """Drop all programs that this process holds: each takes memory maps, which Linux limits."""
    for program in list(_all):
        program.forget()
    jax.clear_caches()


class KeptProgram:
    """A function whose programs are kept: one for each structure and shape of its arguments."""

    def __init__(self, function: Callable, static: tuple[str, ...], hot: bool):
        self._function = function
        self._static = static
        self._hot = hot
        self._jitted = jax.jit(function, static_argnames=static)
        self._signature = inspect.signature(function)
        self._programs: dict[tuple, Callable] = {}
        self._being_made: dict[tuple, Future] = {}
        self._lock = threading.Lock()
        _all.add(self)

    def forget(self) -> None:
        """Drop the programs that this process holds; they are read again when they are needed."""
        self._programs.clear()

    def __call__(self, *args, **kwargs):
        bound = self._signature.bind(*args, **kwargs)
        bound.apply_defaults()
        arguments = bound.arguments
        constants = tuple(arguments.pop(name) for name in self._static)
        shown = {name: _for_programs(value) for name, value in arguments.items()}
        leaves, structure = jax.tree.flatten(shown)
        x64 = jax.config.read("jax_enable_x64")
        shapes = _shapes(leaves, x64)
        if shapes is None:
            return self._jitted(*args, **kwargs)
        key = structure, shapes, constants, x64
        program = self._programs.get(key)
        if program is None:
            program = self._made_once(structure, leaves, constants, key)
        return program(*leaves)

    def _made_once(self, structure, leaves: list, constants: tuple, key: tuple) -> Callable:
        """The program, made by the first thread that asks for it; the others wait."""
        with self._lock:
            future = self._being_made.get(key)
            is_mine = future is None
            if future is None:
                future = self._being_made[key] = Future()
        if not is_mine:
            return future.result()
        try:
            with making(self._function.__name__):
                self._programs[key] = self._make(structure, leaves, constants, key)
        except BaseException as error:
            future.set_exception(error)
            raise
        else:
            future.set_result(self._programs[key])
            return self._programs[key]
        finally:
            with self._lock:
                del self._being_made[key]

    def _make(self, structure, leaves: list, constants: tuple, key: tuple) -> Callable:
        """The program for arguments of one structure and shape, read or made."""
        about = f"{self._function.__module__}.{self._function.__qualname__}", key
        ending = program_files.HOT if self._hot else program_files.ENDING
        path = program_files.file_of(self._function.__name__, about, ending)
        if path:
            _note(path.name)
        kept_one = path and (_taken(path) or _load(path))
        if kept_one:
            run, result_structure = kept_one
            return lambda *leaves: jax.tree.unflatten(result_structure, run(*leaves))
        results = []

        def flat(*leaves):
            arguments = jax.tree.unflatten(structure, leaves)
            result = self._function(**arguments, **dict(zip(self._static, constants, strict=True)))
            flat_result, result_structure = jax.tree.flatten(result)
            results[:] = [result_structure]
            return flat_result

        traced.append(self._function.__qualname__)
        run = jax.jit(flat)
        try:
            exported = export.export(run)(*map(_abstract, leaves))
        except (ValueError, NotImplementedError):
            # it calls something of this device whose form JAX does not promise to keep, or its
            # arguments are wrong: running it says so
            exported = None
        if exported:
            if path:
                program_files.write(path, exported, describe(results[0]))
            # it runs as it is read later: both have one entry in the compile cache
            run = _compiled(exported, self._hot)

        def program(*leaves):
            flat_result = run(*leaves)
            return jax.tree.unflatten(results[0], flat_result)

        return program


def _for_programs(argument):
    """An argument without what its programs do not depend on, if it says what that is."""
    return argument.for_programs() if hasattr(argument, "for_programs") else argument


def _shapes(leaves: list, x64: bool) -> tuple | None:
    """Shapes and types of arguments, as programs are told apart.

    None where JAX itself must handle one: it is traced, or on other devices than the default one.
    This is done at each call, for some 50 arguments, so it is kept short.
    """
    shapes, default = [], _default_sharding()
    for leaf in leaves:
        if isinstance(leaf, jax.Array):
            if isinstance(leaf, Tracer) or leaf.sharding != default:
                return None
            shapes.append((leaf.shape, leaf.dtype))
        elif hasattr(leaf, "dtype"):
            shapes.append((leaf.shape, _canonical(leaf.dtype, x64)))
        else:
            shapes.append(((), type(leaf)))
    return tuple(shapes)


@functools.cache
def _default_sharding() -> jax.sharding.Sharding:
    return jax.sharding.SingleDeviceSharding(jax.devices()[0])


@functools.cache
def _canonical(dtype, x64: bool):
    """The type as JAX takes it: without `x64`, float32 for float64."""
    del x64  # a part of the cache's key
    return jax.dtypes.canonicalize_dtype(dtype, allow_extended_dtype=True)


def _abstract(leaf) -> jax.ShapeDtypeStruct:
    """Shape and type of an argument, as JAX takes it."""
    array = leaf if isinstance(leaf, jax.Array) else jax.eval_shape(jax.numpy.asarray, leaf)
    return jax.ShapeDtypeStruct(array.shape, array.dtype)


_ahead: dict[Path, Future] = {}
"""Programs that are being loaded ahead of need, by their files."""
_noting: dict[Path, set[str]] = {}
"""Lists that take the names of the programs that this process uses, and the names they hold."""


def load_ahead(purpose: str) -> None:
    """Load in the background what a purpose took in earlier processes; note what it takes now.

    Args:
        purpose: name of what is about to be done, with all that decides which programs it takes.

    Raises:
        DeviceError: JAX has no device of the kind that JAX_PLATFORMS asks for.
    """
    enable_compile_cache()
    require_device()
    path = program_files.file_of("ahead", (purpose,), program_files.LIST)
    if path is None or path in _noting:
        return
    files = program_files.read_list(path)
    _noting[path] = {file.name for file in files}
    pool = ThreadPoolExecutor(AT_ONCE, thread_name_prefix="programs")
    for file in files[:MOST_AHEAD]:
        if file not in _ahead:
            _ahead[file] = pool.submit(_load_ahead, file)
    pool.shutdown(wait=False)


def _load_ahead(path: Path) -> tuple[Callable, str] | None:
    """A program that is ready to run, and its description; None where its file is no good."""
    if not threading.main_thread().is_alive():  # the process ends, but for this thread
        return None
    found = program_files.read(path)
    if found is None:
        return None
    exported, description = found
    return _compiled(exported, _is_hot(path)), description


def _is_hot(path: Path) -> bool:
    return path.name.endswith(program_files.HOT)


def _compiled(exported: export.Exported, hot: bool) -> Callable:
    """A program that is ready to run: compiled, or read from the compile cache."""
    shapes = [jax.ShapeDtypeStruct(aval.shape, aval.dtype) for aval in exported.in_avals]
    options = few_pieces() if hot else quick_options()
    return jax.jit(exported.call).lower(*shapes).compile(compiler_options=options)


def _taken(path: Path) -> tuple[Callable, Any] | None:
    """The program of a file if it is being loaded ahead; one not begun is not waited for."""
    future = _ahead.pop(path, None)
    found = None if future is None or future.cancel() else future.result()
    return found and _with_structure(*found)


def _load(path: Path) -> tuple[Callable, Any] | None:
    """The program of a file and the structure of its result; None where the file is no good."""
    found = program_files.read(path)
    return found and _with_structure(_compiled(found[0], _is_hot(path)), found[1])


def _with_structure(run: Callable, description: str) -> tuple[Callable, Any] | None:
    try:
        return run, structure_of(description)
    except ValueError:  # of classes that are no longer there
        return None


def _note(name: str) -> None:
    for path, names in _noting.items():
        if name not in names:
            names.add(name)
            program_files.add_to_list(path, name)
