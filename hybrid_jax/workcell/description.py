# SPDX-License-Identifier: MIT
"""What a handling task needs beyond geometry: objects, grasps, trays. Read from `CELL.toml`."""

import tomllib
from dataclasses import dataclass
from pathlib import Path

from hybrid_jax.errors import UnknownNameError, WorkcellError


@dataclass(frozen=True)
class GripperSpec:
    """A gripper whose fingers slide symmetrically."""

    joints: tuple[str, ...]
    """Slide joints; their common value is the opening of one finger [m]."""
    actuator: str
    """Position actuator of the opening."""
    open: float
    """Opening of each finger when open [m]."""
    squeeze: float
    """Actuator command that closes on any object [m]."""


@dataclass(frozen=True)
class TraySpec:
    """A tray that objects are put into."""

    name: str
    """Body of the tray."""
    half_size: tuple[float, float]
    """Half of its inner length and width, along the body's x and y [m]."""
    floor: float
    """Height of its inner floor above the body's origin [m]."""


@dataclass(frozen=True)
class ObjectSpec:
    """A movable object: where it appears, how it is grasped, where it goes."""

    name: str
    """Free body."""
    kind: str
    """What it is: skills are demonstrated by kind."""
    tray: str
    """Tray that it belongs in."""
    grasp: tuple[float, float, float]
    """Tool centre in the object's frame [m]; the tool points down, the fingers open along x."""
    grip: float
    """Half width of the object between the fingers [m]."""
    spawn: tuple[float, float, float]
    """Middle of the region where it appears: x, y [m], yaw [rad]."""
    jitter: tuple[float, float, float]
    """Half widths of that region [m, m, rad]."""
    slot: tuple[float, float, float]
    """Where it is put in the tray's frame: x, y [m], yaw [rad]."""
    regrasp: tuple[tuple[float, float, float], ...] = ()
    """Further grasps, like `grasp`: tried in turn where the first fails."""

    @property
    def grasps(self) -> tuple[tuple[float, float, float], ...]:
        """All grasps, the best first."""
        return (self.grasp, *self.regrasp)


@dataclass(frozen=True)
class Handling:
    """A handling task: sort the objects into their trays."""

    tool_site: str
    gripper: GripperSpec
    table: str
    """Body whose surface the objects lie on."""
    lift: float
    """Height by which an object is lifted before it is carried [m]."""
    hover: float
    """Height above the place pose at which it arrives [m]."""
    release: float
    """Height above the tray's floor at which it is let go [m]."""
    trays: tuple[TraySpec, ...]
    objects: tuple[ObjectSpec, ...]

    def object(self, name: str) -> ObjectSpec:
        """Object by name."""
        for spec in self.objects:
            if spec.name == name:
                return spec
        raise UnknownNameError("object", name, [spec.name for spec in self.objects])

    def tray(self, name: str) -> TraySpec:
        """Tray by name."""
        for spec in self.trays:
            if spec.name == name:
                return spec
        raise UnknownNameError("tray", name, [spec.name for spec in self.trays])


def _fixed(value):
    return tuple(map(_fixed, value)) if isinstance(value, list) else value


def _record(kind, values: dict, where: str):
    """Build a spec from a TOML table, turning lists into tuples."""
    fixed = {k: _fixed(v) for k, v in values.items()}
    try:
        return kind(**fixed)
    except TypeError as error:
        fields = ", ".join(kind.__dataclass_fields__)
        raise WorkcellError(f"{where}: {error}; the fields are: {fields}") from None


def read_handling(path: Path) -> Handling | None:
    """Read the task data beside a cell's MJCF; None where there is none.

    Raises:
        WorkcellError: the file does not parse, or a field is missing or unknown.
    """
    if not path.is_file():
        return None
    try:
        data = tomllib.loads(path.read_text())
    except tomllib.TOMLDecodeError as error:
        raise WorkcellError(f"{path.name} is no valid TOML: {error}") from None
    gripper = _record(GripperSpec, data.pop("gripper", {}), f"{path.name} [gripper]")
    trays = tuple(_record(TraySpec, t, f"{path.name} [[trays]]") for t in data.pop("trays", []))
    objects = tuple(
        _record(ObjectSpec, o, f"{path.name} [[objects]]") for o in data.pop("objects", [])
    )
    extra = {"gripper": gripper, "trays": trays, "objects": objects}
    return _record(Handling, data | extra, path.name)
