# SPDX-License-Identifier: MIT
"""Folders and files of the robots and work cells that come with the package."""

from pathlib import Path

from hybrid_jax.errors import UnknownNameError, WorkcellError

ENDINGS = ".xml", ".urdf", ".xacro", ".mjb"
"""Kinds of files that a cell is read from: MJCF, URDF, xacro, compiled MJCF; in any case."""
_PACKAGE = Path(__file__).resolve().parent.parent


def robots_folder() -> Path:
    """Folder of robots, cells and demonstrations: inside the wheel, or beside the package."""
    bundled = _PACKAGE / "_robots"
    return bundled if bundled.is_dir() else _PACKAGE.parent / "robots"


def workcell_names() -> list[str]:
    """Names of the cells that can be loaded by name."""
    return sorted(path.stem for path in (robots_folder() / "workcells").glob("*.xml"))


def default_workcell() -> str:
    """Name of the cell that commands take where none is named."""
    return (robots_folder() / "workcells" / "default.txt").read_text().strip()


def find_workcell(name_or_path: str | Path) -> Path:
    """File of a cell from the name of a shipped cell or the path of a file.

    Raises:
        UnknownNameError: it is neither; the message lists the names.
        WorkcellError: a file of another kind.
    """
    path = Path(name_or_path)
    if path.is_file():
        ending = path.suffix.lower()
        if ending in ENDINGS:
            return path.resolve()
        raise WorkcellError(f"{path} is no work cell: its ending is none of {', '.join(ENDINGS)}")
    shipped = robots_folder() / "workcells" / f"{name_or_path}.xml"
    if shipped.is_file():
        return shipped
    raise UnknownNameError("work cell (and no such file)", name_or_path, workcell_names())


def demonstrations_folder() -> Path:
    """Folder of the recorded demonstrations that come with the package, one file each."""
    return robots_folder() / "demonstrations"
