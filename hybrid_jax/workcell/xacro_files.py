# SPDX-License-Identifier: MIT
"""Xacro files expanded to URDF text."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from hybrid_jax.errors import WorkcellError
from hybrid_jax.workcell.ros_packages import package_folders, where_packages_were_sought

ENDING = ".xacro"
_MISSING = re.compile(r"Package not found: (\S+)")


def expand_xacro(
    path: Path, package_paths: Sequence[Path] = (), arguments: Mapping[str, str] | None = None
) -> str:
    """URDF of a xacro file.

    Args:
        path: of the file.
        package_paths: folders that hold ROS packages, looked at first.
        arguments: values of the file's `<xacro:arg>` by their names.

    Raises:
        WorkcellError: `xacrodoc` is not installed, a package is not found, an argument is missing,
            or the file is wrong in another way; the message says which.
    """
    try:
        from xacrodoc import XacroDoc, packages
    except ImportError:
        raise WorkcellError(
            f"{path.name} is a xacro file: pip install 'hybrid_jax[adopt]', or expand it first"
        ) from None
    packages.reset()
    while True:
        try:
            document = XacroDoc.from_file(path, walk_up=False, subargs=dict(arguments or {}))
            return document.to_urdf_string(use_protocols=True)
        except Exception as error:  # xacro wraps what it meets in errors without a common base
            missing = _MISSING.search(str(error))
            if not missing:
                lacking = _arguments_without_values(path, arguments or {})
                raise WorkcellError(
                    f"{path.name}: xacro cannot expand it: {_reason(error, lacking)}"
                ) from None
            folder = _package(path, missing[1], package_paths)
            packages.update_package_cache({missing[1]: folder})


def _package(path: Path, name: str, package_paths: Sequence[Path]) -> Path:
    """Folder of a ROS package that a xacro file names.

    Raises:
        WorkcellError: there is none.
    """
    for folder in package_folders(path, name, package_paths):
        if folder.is_dir():
            return folder
    raise WorkcellError(
        f"{path.name} needs the ROS package {name!r}, which is not "
        f"{where_packages_were_sought(path)}; name the folder that holds it with --package-path"
    )


def _arguments_without_values(path: Path, given: Mapping[str, str]) -> list[str]:
    """Names of a file's arguments that have no default and are not given."""
    arguments = re.findall(r"<xacro:arg\b[^>]*>", path.read_text(errors="replace"))
    names = [re.search(r"name\s*=\s*[\"']([^\"']+)", text) for text in arguments]
    return [
        name[1]
        for name, text in zip(names, arguments, strict=True)
        if name and "default" not in text and name[1] not in given
    ]


def _reason(error: Exception, lacking: list[str]) -> str:
    """What is wrong, and what would be right where an argument is missing."""
    text = str(error).strip() or type(error).__name__
    if lacking:
        options = " ".join(f"--xacro-arg {name}=VALUE" for name in lacking)
        return f"it has arguments without a default; give {options}"
    if "arg" in text.lower() and "undefined" in text.lower():
        return f"{text}; give it with --xacro-arg NAME=VALUE"
    return text
