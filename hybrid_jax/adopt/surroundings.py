# SPDX-License-Identifier: MIT
"""What stands around a robot: fixtures and objects from a TOML file, added to a spec."""

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
SHAPES = {
    "box": (mujoco.mjtGeom.mjGEOM_BOX, 3, "three half extents"),
    "cylinder": (mujoco.mjtGeom.mjGEOM_CYLINDER, 2, "radius and half length"),
    "sphere": (mujoco.mjtGeom.mjGEOM_SPHERE, 1, "a radius"),
}
_MODELS = ".xml", ".urdf", ".xacro"


def add_surroundings(spec: mujoco.MjSpec, path: Path) -> list[str]:
    """Add what a TOML file lists under `fixtures` and `objects`.

    Args:
        spec: of the robot, to be added to.
        path: of the TOML file; files in it are beside it.

    Returns:
        A sentence for each.

    Raises:
        WorkcellError: a field that is missing, unknown or wrong; the message names it.
    """
    try:
        content = tomllib.loads(path.read_text())
    except (OSError, tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise WorkcellError(f"{path.name} is no TOML file: {error}") from None
    if unknown := set(content) - {"fixtures", "objects"}:
        raise WorkcellError(
            f"{path.name}: unknown tables {', '.join(sorted(unknown))}; there are [[fixtures]] "
            "and [[objects]]"
        )
    notes = []
    for kind in ("fixtures", "objects"):
        for number, entry in enumerate(content.get(kind, [])):
            label = f"{path.name}: {kind} {number}"
            _add(spec, entry, path.parent, label, movable=kind == "objects")
            notes.append(f"{kind.removesuffix('s')} {entry['name']!r} added")
    return notes


def _add(spec, entry: dict[str, Any], folder: Path, label: str, movable: bool) -> None:
    """Add one fixture or object."""
    if unknown := set(entry) - FIELDS:
        raise WorkcellError(f"{label}: unknown fields {', '.join(sorted(unknown))}")
    if not isinstance(entry.get("name"), str) or not entry["name"]:
        raise WorkcellError(f"{label}: it needs a name")
    if sum(key in entry for key in (*SHAPES, "file")) != 1:
        raise WorkcellError(f"{label}: it needs one of {', '.join((*SHAPES, 'file'))}")
    label = f"{label} ({entry['name']!r})"
    position = _numbers(entry, "position", 3, label, (0, 0, 0))
    euler = _numbers(entry, "euler", 3, label, (0, 0, 0))
    quat = Rotation.from_euler("xyz", euler, degrees=True).as_quat(scalar_first=True)
    file = folder / str(entry.get("file", ""))
    if "file" in entry and file.suffix.lower() in _MODELS and not movable:
        _attach(spec, file, entry["name"], position, quat, label)
        return
    body = spec.worldbody.add_body(name=entry["name"], pos=position, quat=quat)
    geom = _shape(spec, body, entry, file, label)
    if movable:
        body.add_freejoint(name=f"{entry['name']}_free")
        geom.mass = float(_numbers(entry, "mass", 1, label, (0.2,))[0])


def _numbers(entry: dict[str, Any], field: str, count: int, label: str, default) -> np.ndarray:
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
            size = _numbers(entry, field, count, label, ())
            if (size <= 0).any():
                raise WorkcellError(f"{label}: {field} must be positive: {meaning} [m]")
            return body.add_geom(type=kind, size=[*size, 0, 0][:3])
    if not file.is_file():
        raise WorkcellError(f"{label}: there is no file {file}")
    name, scale = f"{entry['name']}_mesh", _numbers(entry, "scale", 1, label, (1.0,))
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
