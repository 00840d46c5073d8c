# SPDX-License-Identifier: MIT
"""Files of traced and lowered programs, and of arrays, beside the compile cache.

A file holds a checksum and a content that Python does not execute: what `jax.export` wrote
(StableHLO), or an array. One that is damaged or of another version of JAX counts as absent. Several
processes may write at once: a file appears as a whole.
"""

import functools
import hashlib
import io
import os
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

import jax
import numpy as np
from jax import export

from hybrid_jax.runtime.compile_cache import cache_folder
from hybrid_jax.runtime.output_files import write_bytes

LIMIT = 256 * 2**20
"""Largest total size of the files [bytes]; the ones that were not used for longest go first."""
ENDING, LIST, ARRAY = ".program", ".list", ".array"
"""Endings of the files of programs, of lists of such files, one a line, and of arrays."""
HOT = f".hot{ENDING}"
"""Ending of the file of a program that is compiled to run fast, not to be ready soon."""
_CHECKSUM = hashlib.sha256().digest_size
_PACKAGE = Path(__file__).resolve().parents[1]


@functools.cache
def source_digest() -> str:
    """Hash of the package's source: a program is of one version of it."""
    digest = hashlib.sha256()
    for path in sorted(_PACKAGE.rglob("*.py")):
        digest.update(str(path.relative_to(_PACKAGE)).encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()


def file_of(name: str, about: tuple, ending: str = ENDING) -> Path | None:
    """File that belongs to a name and what is told about it; None where nothing is kept.

    Args:
        name: what the file's name begins with.
        about: all that the content depends on, but for source, versions and device; by `repr`.
        ending: of the file.
    """
    folder = cache_folder()
    if folder is None:
        return None
    device = jax.devices()[0]
    parts = (
        name,
        about,
        source_digest(),
        jax.__version__,
        version("jaxlib"),
        device.platform,
        device.device_kind,
        jax.config.jax_default_matmul_precision,
        jax.config.jax_default_prng_impl,
    )
    digest = hashlib.sha256(repr(parts).encode()).hexdigest()
    return folder / "programs" / f"{name}-{digest[:40]}{ending}"


def _content(path: Path) -> bytes | None:
    """What a file holds; None where there is none, or it is damaged."""
    try:
        content = path.read_bytes()
        os.utime(path)  # tells when it was used last
    except OSError:
        return None
    is_whole = hashlib.sha256(content[_CHECKSUM:]).digest() == content[:_CHECKSUM]
    return content[_CHECKSUM:] if is_whole else None


def read(path: Path) -> tuple[export.Exported, str] | None:
    """A kept program and its description; None where there is none, or the file is damaged."""
    content = _content(path)
    if content is None:
        return None
    try:
        description, _, program = content.partition(b"\n")
        return export.deserialize(bytearray(program)), description.decode()
    except Exception:  # made by a foreign version of JAX: errors of many classes
        return None


def kept_array(name: str, about: tuple, make: Callable[[], np.ndarray]) -> np.ndarray:
    """An array that is made once, and read from a file by later processes.

    Args:
        name: what the file's name begins with.
        about: all that the array depends on, but for the package's source; by `repr`.
        make: makes the array `[...]`.
    """
    path = file_of(name, about, ARRAY)
    content = path and _content(path)
    if content:
        return np.load(io.BytesIO(content), allow_pickle=False)
    array = make()
    if path:
        file = io.BytesIO()
        np.save(file, array, allow_pickle=False)
        _write(path, file.getvalue())
    return array


def write(path: Path, exported: export.Exported, description: str) -> None:
    """Keep a program, and one line about it; where that cannot be written, it is said once."""
    _write(path, description.encode() + b"\n" + bytes(exported.serialize()))


def _write(path: Path, content: bytes) -> None:
    try:
        write_bytes(path, hashlib.sha256(content).digest() + content)
        _prune(path.parent)
    except OSError as error:
        say_once(str(path.parent), error.strerror or str(error))


def read_list(path: Path) -> list[Path]:
    """The files that a list names, the largest first; those that are gone are left out."""
    try:
        names = path.read_text().splitlines()
        os.utime(path)  # tells when it was used last
    except (OSError, UnicodeDecodeError):
        return []
    files = [path.parent / Path(name).name for name in names]
    there = [file for file in dict.fromkeys(files) if file.suffix == ENDING and file.is_file()]
    return sorted(there, key=lambda file: -file.stat().st_size)


def add_to_list(path: Path, name: str) -> None:
    """Append the name of a file to a list; where that is not possible, nothing is lost."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("a") as file:  # one short line: written at once, also beside others
            file.write(f"{name}\n")
    except OSError as error:
        say_once(str(path.parent), error.strerror or str(error))


@functools.cache
def say_once(folder: str, reason: str) -> None:
    """Say that programs are not kept."""
    from hybrid_jax.runtime.terminal import remark

    remark(f"programs are not kept in {folder} ({reason}): they are traced again next time")


def _prune(folder: Path) -> None:
    """Remove the files that were not used for longest, down to `LIMIT`."""
    files = []
    for path in folder.iterdir():
        if path.suffix not in (ENDING, LIST, ARRAY):
            continue
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
