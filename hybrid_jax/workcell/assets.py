# SPDX-License-Identifier: MIT
"""Where the robots and work cells that come with the package lie."""

from pathlib import Path

from hybrid_jax.errors import UnknownNameError

_PACKAGE = Path(__file__).resolve().parent.parent


def robots_folder() -> Path:
    """Folder of robots, cells and demonstrations: inside the wheel, or beside the package."""
    inside = _PACKAGE / "_robots"
    return inside if inside.is_dir() else _PACKAGE.parent / "robots"


def workcell_names() -> list[str]:
    """Cells that can be loaded by name."""
    return sorted(path.stem for path in (robots_folder() / "workcells").glob("*.xml"))


def default_workcell() -> str:
    """Cell that commands take where none is named."""
    return (robots_folder() / "workcells" / "default.txt").read_text().strip()


def find_workcell(name_or_path: str | Path) -> Path:
    """MJCF file of a cell, from the name of a shipped cell or a path to a file.

    Raises:
        UnknownNameError: neither; the message lists the names.
    """
    path = Path(name_or_path)
    if path.suffix in (".xml", ".urdf", ".mjb") and path.is_file():
        return path.resolve()
    shipped = robots_folder() / "workcells" / f"{name_or_path}.xml"
    if shipped.is_file():
        return shipped
    raise UnknownNameError("work cell (and no such file)", name_or_path, workcell_names())


def demonstrations_folder() -> Path:
    """Recorded demonstrations that come with the package, one file each."""
    return robots_folder() / "demonstrations"
