# SPDX-License-Identifier: MIT
"""Files from outside, checked before they are read, so that none hangs or fills the memory.

A pipe would wait for ever, a device never ends, and a small archive may unpack to gigabytes.
"""

import stat
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from hybrid_jax.errors import HybridJaxError

MOST_TEXT = 32 * 2**20
"""Largest size of a text file [byte]."""
MOST_ARRAYS = 2**31
"""Largest size of an archive of arrays, unpacked [byte]."""


def require_regular(path: Path, limit: int, error: type[HybridJaxError]) -> None:
    """Raise `error` where a path is no regular file, or is larger than `limit`.

    Args:
        path: of the file.
        limit: largest size [byte].
        error: class of the error that is raised.
    """
    try:
        info = path.stat()
    except (OSError, ValueError) as reason:  # ValueError: a NUL in the name
        raise error(f"{_short(path)} cannot be read: {_reason(reason)}") from None
    if not stat.S_ISREG(info.st_mode):
        raise error(f"{_short(path)} is no regular file")
    if info.st_size > limit:
        raise error(
            f"{_short(path)} has {info.st_size / 2**20:,.0f} MiB; at most {limit / 2**20:,.0f} MiB "
            "are read"
        )


def read_text(path: Path, error: type[HybridJaxError], limit: int = MOST_TEXT) -> str:
    """Text of a UTF-8 file.

    Args:
        path: of the file.
        error: class of the error that is raised where it cannot be read.
        limit: largest size [byte].
    """
    require_regular(path, limit, error)
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as reason:
        raise error(f"{_short(path)} cannot be read: {_reason(reason)}") from None


def read_arrays(
    path: Path, error: type[HybridJaxError], wanted: Callable[[str], bool] = lambda name: True
) -> dict[str, np.ndarray]:
    """Arrays `[...]` of an `.npz` file by name, in their stored shapes.

    Args:
        path: of the file.
        error: class of the error that is raised where the file is too large, packed or unpacked.
        wanted: is an array of this name read? Others are not unpacked.
    """
    require_regular(path, MOST_ARRAYS, error)
    # the archive's directory states the sizes before anything is unpacked
    with zipfile.ZipFile(path) as archive:
        sizes = {i.filename.removesuffix(".npy"): i.file_size for i in archive.infolist()}
    total = sum(size for name, size in sizes.items() if wanted(name))
    if total > MOST_ARRAYS:
        raise error(
            f"{_short(path)} would unpack to {total / 2**30:.1f} GiB; at most "
            f"{MOST_ARRAYS / 2**30:.0f} GiB are read"
        )
    with np.load(path, allow_pickle=False) as file:
        return {name: file[name] for name in file.files if wanted(name)}


def _short(path: Path) -> str:
    """A path for a message; an endless one is cut."""
    text = str(path).replace("\0", "\\0")
    return text if len(text) <= 200 else f"{text[:200]}..."


def _reason(reason: Exception) -> str:
    return getattr(reason, "strerror", None) or str(reason)
