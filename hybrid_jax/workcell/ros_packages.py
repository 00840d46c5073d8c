# SPDX-License-Identifier: MIT
"""Where the folders of ROS packages are, without ROS: by their `package.xml` or by their names."""

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from xml.etree import ElementTree

PACKAGE = "package://"
"""How the name of a file begins that lies in a ROS package."""
VARIABLES = "ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH"
"""Environment variables in which ROS lists the folders of its packages."""
_LEVELS = 4
"""Folders above a file in which packages beside its own are looked for."""


def package_folders(file: Path, package: str, package_paths: Sequence[Path] = ()) -> Iterator[Path]:
    """Folders that may be a package: those named, those around a file, those of ROS.

    A folder is the package by its own name, or by the name that its `package.xml` states.

    Args:
        file: that names the package.
        package: its name.
        package_paths: folders that hold packages, or are packages, looked at first.
    """
    parents = [*file.resolve().parents]
    ros = [Path(p) for v in VARIABLES for p in os.environ.get(v, "").split(os.pathsep) if p]
    for folder in [*map(Path, package_paths), *parents, *ros]:
        if folder.name == package or _stated_name(folder) == package:
            yield folder
        yield folder / package
        yield folder / "share" / package
    for folder in [*map(Path, package_paths), *parents[:_LEVELS], *ros]:
        yield from (f for f in _folders_in(folder) if _stated_name(f) == package)


def where_packages_were_sought(file: Path) -> str:
    """Where `package_folders` looks, for a message."""
    return (
        f"in, above or beside {file.resolve().parent}, in --package-path, {' or '.join(VARIABLES)}"
    )


def _folders_in(folder: Path) -> list[Path]:
    try:
        return sorted(f for f in folder.iterdir() if f.is_dir())
    except OSError:  # a folder that may not be read holds nothing
        return []


def _stated_name(folder: Path) -> str:
    """Name in a folder's `package.xml`; empty where there is none."""
    try:
        name = ElementTree.parse(folder / "package.xml").getroot().findtext("name", "")
    except (OSError, ElementTree.ParseError):
        return ""
    return name.strip()
