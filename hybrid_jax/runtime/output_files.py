# SPDX-License-Identifier: MIT
"""Files that appear as a whole: whoever reads one sees the old content or the new one."""

import os
from pathlib import Path


def write_text(path: Path, text: str) -> None:
    """Write a text file; an existing file is replaced only once the new one is complete.

    The folder is made where it is missing.
    """
    write_bytes(path, text.encode())


def write_new(path: Path, text: str) -> None:
    """Write a text file as a whole, unless it exists; of two processes only one succeeds.

    Raises:
        FileExistsError: the file exists.
    """
    # a hard link appears at once and complete, and fails where the name is taken
    partial = path.with_name(f"{path.name}.{os.getpid()}.partial")
    try:
        partial.write_text(text)
        try:
            os.link(partial, path)
        except FileExistsError:
            raise
        except OSError:  # a file system without hard links
            with path.open("x") as file:
                file.write(text)
    finally:
        partial.unlink(missing_ok=True)


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file of bytes as `write_text` writes text."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f"{path.name}.{os.getpid()}.partial")  # several may write at once
    try:
        partial.write_bytes(content)
        os.replace(partial, path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise named_error(error, path) from None


def named_error(error: OSError, path: Path) -> OSError:
    """Copy of an error that names the file which was to be written."""
    return OSError(error.errno, error.strerror or str(error), str(path))
