# SPDX-License-Identifier: MIT
"""What stands around a robot: fixtures, trays and objects of a TOML file, added to a spec."""

import tomllib
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from hybrid_jax.adopt.cell_folder import absolute_assets
from hybrid_jax.errors import WorkcellError
from hybrid_jax.workcell.load import as_spec
from hybrid_jax.workcell.mesh_files import readable_mesh

FIELDS = {"name", "box", "cylinder", "sphere", "file", "position", "euler", "scale", "mass"}
"""What a fixture or object may say; `euler` in degrees, `box` half extents, lengths in metres."""
TRAY_FIELDS = {"name", "half_size", "height", "position", "euler"}
"""What a tray may say: half of its inner length and width, and the height of its rim."""
HANDLED = {"kind", "tray", "slot", "grasp", "grip", "jitter"}
"""What an object that is to be carried says as well: as in a cell's task data."""
TABLES = {"table", "fixtures", "trays", "objects"}
COLOURS = {
    "fixtures": (0.72, 0.72, 0.7, 1.0),
    "trays": (0.42, 0.55, 0.68, 1.0),
    "objects": (0.86, 0.45, 0.2, 1.0),
}
FLOOR, RIM = 0.008, 0.006
"""Thickness of a tray's floor and of its rim [m]."""
SHAPES = {
    "box": (mujoco.mjtGeom.mjGEOM_BOX, 3, "three half extents"),
    "cylinder": (mujoco.mjtGeom.mjGEOM_CYLINDER, 2, "radius and half length"),
    "sphere": (mujoco.mjtGeom.mjGEOM_SPHERE, 1, "a radius"),
}
_MODELS = ".xml", ".urdf", ".xacro"


def read_surroundings(path: Path) -> dict[str, Any]:
    """The tables of a TOML file of what stands around a robot.

    Raises:
        WorkcellError: it is no TOML file, or has a table that nothing knows.
    """
    try:
        content = tomllib.loads(path.read_text())
    except (OSError, tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise WorkcellError(f"{path.name} is no TOML file: {error}") from None
    if unknown := set(content) - TABLES:
        raise WorkcellError(
            f"{path.name}: unknown tables {', '.join(sorted(unknown))}; there are [[fixtures]], "
            "[[trays]], [[objects]], and table = NAME"
        )
    return content


def merged(contents: list[dict[str, Any]]) -> dict[str, Any]:
    """The tables of several files as if they stood in one.

    Raises:
        WorkcellError: they name different tables to work on.
    """
    lists = {
        kind: [entry for content in contents for entry in content.get(kind, [])]
        for kind in ("fixtures", "trays", "objects")
    }
    tables = sorted({str(content["table"]) for content in contents if "table" in content})
    if len(tables) > 1:
        raise WorkcellError(f"there can be one table, not {', '.join(tables)}")
    return lists | ({"table": tables[0]} if tables else {})


def add_surroundings(spec: mujoco.MjSpec, content: dict[str, Any], path: Path) -> list[str]:
    """Add fixtures, trays and objects.

    Args:
        spec: of the robot, to be added to.
        content: from `read_surroundings`.
        path: of that file; files in it are beside it.

    Returns:
        A sentence for each.

    Raises:
        WorkcellError: a field that is missing, unknown or wrong; the message names it.
    """
    notes = []
    for kind in ("fixtures", "trays", "objects"):
        for number, entry in enumerate(content.get(kind, [])):
            label = f"{path.name}: {kind} {number}"
            if kind == "trays":
                _add_tray(spec, entry, label)
            else:
                _add(spec, entry, path.parent, label, movable=kind == "objects")
            body = spec.body(entry["name"])
            for geom in body.geoms if body else ():
                geom.rgba = COLOURS[kind]
            notes.append(f"{kind.removesuffix('s')} {entry['name']!r} added")
    return notes


def _require_name(entry: dict[str, Any], known: set[str], label: str) -> str:
    """The label of an entry with its name; its fields must be known.

    Raises:
        WorkcellError: it has no name, or an unknown field.
    """
    if not isinstance(entry, dict):
        raise WorkcellError(f"{label} must be a table")
    if unknown := set(entry) - known:
        raise WorkcellError(
            f"{label}: unknown fields {', '.join(sorted(unknown))}; there are "
            f"{', '.join(sorted(known))}"
        )
    if not isinstance(entry.get("name"), str) or not entry["name"]:
        raise WorkcellError(f"{label}: it needs a name")
    return f"{label} ({entry['name']!r})"


def _pose(entry: dict[str, Any], label: str) -> tuple[np.ndarray, np.ndarray]:
    """Position `[3]` [m] and quaternion `[4]` of an entry."""
    euler = numbers_of(entry, "euler", 3, label, (0, 0, 0))
    rotation = Rotation.from_euler("xyz", euler, degrees=True)
    return numbers_of(entry, "position", 3, label, (0, 0, 0)), rotation.as_quat(scalar_first=True)


def _add_tray(spec, entry: dict[str, Any], label: str) -> None:
    """Add a tray: a floor and four walls, its origin in the middle of its underside."""
    label = _require_name(entry, TRAY_FIELDS, label)
    length, width = numbers_of(entry, "half_size", 2, label, ())
    (height,) = numbers_of(entry, "height", 1, label, (0.05,))
    if min(length, width, height - FLOOR) <= 0:
        raise WorkcellError(
            f"{label}: half_size must be positive, and height more than {FLOOR:g}, the floor's"
        )
    position, quat = _pose(entry, label)
    body = spec.worldbody.add_body(name=entry["name"], pos=position, quat=quat)
    wall, middle = RIM / 2, height / 2
    parts = [([0, 0, FLOOR / 2], [length, width, FLOOR / 2])]
    for side in (1, -1):
        parts.append(([side * (length + wall), 0, middle], [wall, width + RIM, middle]))
        parts.append(([0, side * (width + wall), middle], [length, wall, middle]))
    for place, size in parts:
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, pos=place, size=size)


def _add(spec, entry: dict[str, Any], folder: Path, label: str, movable: bool) -> None:
    """Add one fixture or object."""
    label = _require_name(entry, FIELDS | (HANDLED if movable else set()), label)
    if sum(key in entry for key in (*SHAPES, "file")) != 1:
        raise WorkcellError(f"{label}: it needs one of {', '.join((*SHAPES, 'file'))}")
    position, quat = _pose(entry, label)
    file = folder / str(entry.get("file", ""))
    if "file" in entry and file.suffix.lower() in _MODELS and not movable:
        _attach(spec, file, entry["name"], position, quat, label)
        return
    body = spec.worldbody.add_body(name=entry["name"], pos=position, quat=quat)
    geom = _shape(spec, body, entry, file, label)
    if movable:
        body.add_freejoint(name=f"{entry['name']}_free")
        geom.mass = float(numbers_of(entry, "mass", 1, label, (0.2,))[0])


def numbers_of(entry: dict[str, Any], field: str, count: int, label: str, default) -> np.ndarray:
    """A field of so many finite numbers.

    Raises:
        WorkcellError: it is something else.
    """
    try:
        numbers = np.atleast_1d(np.asarray(entry.get(field, default), float))
    except (TypeError, ValueError):
        numbers = np.zeros(0)
    if numbers.shape != (count,) or not np.isfinite(numbers).all():
        raise WorkcellError(f"{label}: {field} must be {count} number{'s' * (count > 1)}")
    return numbers


def _shape(spec, body, entry: dict[str, Any], file: Path, label: str):
    """Add the geom of a fixture or object to its body."""
    for field, (kind, count, meaning) in SHAPES.items():
        if field in entry:
            size = numbers_of(entry, field, count, label, ())
            if (size <= 0).any():
                raise WorkcellError(f"{label}: {field} must be positive: {meaning} [m]")
            return body.add_geom(type=kind, size=[*size, 0, 0][:3])
    if not file.is_file():
        raise WorkcellError(f"{label}: there is no file {file}")
    name, scale = f"{entry['name']}_mesh", numbers_of(entry, "scale", 1, label, (1.0,))
    if scale[0] <= 0:
        raise WorkcellError(f"{label}: scale must be positive: 0.001 for a mesh in millimetres")
    spec.add_mesh(name=name, file=str(readable_mesh(file.resolve())), scale=[scale[0]] * 3)
    return body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name)


def _attach(spec, file: Path, name: str, position, quat, label: str) -> None:
    """Attach a model file as a fixture: its joints stay where the file has them."""
    if not file.is_file():
        raise WorkcellError(f"{label}: there is no file {file}")
    child = as_spec(file)
    absolute_assets(child)
    frame = spec.worldbody.add_frame(pos=position, quat=quat)
    spec.attach(child, prefix=f"{name}_", frame=frame)
