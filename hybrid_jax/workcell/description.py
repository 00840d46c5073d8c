# SPDX-License-Identifier: MIT
"""Task data of a cell, read from `CELL.toml`: objects, grasps, strokes, beside the geometry.

The file's `kind` says what is done in the cell: `handling` or `inspection`.
"""

import math
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from hybrid_jax.errors import UnknownNameError, WorkcellError
from hybrid_jax.runtime.input_files import read_text
from hybrid_jax.workcell.records import Within, record, records

LENGTH = 10.0
"""Largest length that the task data of a work cell may state [m]."""


@dataclass(frozen=True)
class GripperSpec:
    """A gripper whose fingers slide symmetrically."""

    joints: tuple[str, ...]
    """Slide joints; their common value is the opening of one finger [m]."""
    actuator: str
    """Position actuator of the opening."""
    open: Annotated[float, Within(1e-6, LENGTH)]
    """Opening of each finger when open [m]."""
    squeeze: Annotated[float, Within(-LENGTH, LENGTH)]
    """Actuator command that closes on any object [m]."""


@dataclass(frozen=True)
class ControllerSpec:
    """How the robot's controller wants its programs."""

    program: str
    """Language of the programs: `tp`."""
    minus: tuple[tuple[str, str], ...] = ()
    """Pairs of joints: the controller counts the first from the second, not from its link."""
    close: str = ""
    """Instruction that closes the gripper."""
    open: str = ""
    """Instruction that opens the gripper."""


@dataclass(frozen=True)
class TraySpec:
    """A tray into which objects are put."""

    name: str
    """Body of the tray."""
    half_size: Annotated[tuple[float, float], Within(1e-6, LENGTH)]
    """Half of its inner length and width, along the body's x and y [m]."""
    floor: Annotated[float, Within(-LENGTH, LENGTH)]
    """Height of its inner floor above the body's origin [m]."""


@dataclass(frozen=True)
class ObjectSpec:
    """A movable object: where it appears, how it is grasped, where it goes."""

    name: str
    """Free body."""
    kind: str
    """Kind of object: skills are demonstrated for each kind."""
    tray: str
    """Name of the tray that it belongs in."""
    grasp: Annotated[tuple[float, float, float], Within(-LENGTH, LENGTH)]
    """Tool centre in the object's frame [m]; the tool points down, the fingers open along x."""
    grip: Annotated[float, Within(0.0, LENGTH)]
    """Half width of the object between the fingers [m]."""
    spawn: Annotated[tuple[float, float, float], Within(-LENGTH, LENGTH)]
    """Middle of the region where it appears: x, y [m], yaw [rad]."""
    jitter: Annotated[tuple[float, float, float], Within(0.0, LENGTH)]
    """Half widths of that region [m, m, rad]."""
    slot: Annotated[tuple[float, float, float], Within(-LENGTH, LENGTH)]
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
    """Site that is the tool."""
    gripper: GripperSpec
    table: str
    """Body whose surface the objects lie on."""
    lift: Annotated[float, Within(0.0, LENGTH)]
    """Height by which an object is lifted before it is carried [m]."""
    hover: Annotated[float, Within(0.0, LENGTH)]
    """Height above the place pose at which it arrives [m]."""
    release: Annotated[float, Within(0.0, LENGTH)]
    """Height above the tray's floor at which it is let go [m]."""
    trays: tuple[TraySpec, ...]
    objects: tuple[ObjectSpec, ...]
    # not in the `repr`, of which the cell's hash is made: programs do not change what is planned
    controller: ControllerSpec | None = field(default=None, repr=False)

    def object(self, name: str) -> ObjectSpec:
        """Object by name."""
        return _by_name("object", name, self.objects)

    def tray(self, name: str) -> TraySpec:
        """Tray by name."""
        return _by_name("tray", name, self.trays)

    @property
    def fixture_names(self) -> tuple[str, ...]:
        """Bodies of the cell that the data name and that do not move."""
        return (self.table, *(tray.name for tray in self.trays))


@dataclass(frozen=True)
class FaceSpec:
    """A face that is brushed: a strip along a part's x axis that twists evenly about this axis."""

    name: str
    length: Annotated[float, Within(1e-6, LENGTH)]
    """Length of the stroke [m]; its middle is the part's origin."""
    height: Annotated[float, Within(-LENGTH, LENGTH)]
    """Height of the strip's middle line above the part's origin [m]."""
    twist: Annotated[tuple[float, float], Within(-math.pi, math.pi)]
    """Angle of the face about x where the stroke begins and where it ends [rad]."""


@dataclass(frozen=True)
class PartSpec:
    """A part that is brushed: where it lies, and its face."""

    name: str
    """Free body."""
    face: str
    """Name of its face."""
    spawn: Annotated[tuple[float, float, float], Within(-LENGTH, LENGTH)]
    """Middle of the region where it lies: x, y [m], yaw [rad]."""
    jitter: Annotated[tuple[float, float, float], Within(0.0, LENGTH)]
    """Half widths of that region [m, m, rad]."""


@dataclass(frozen=True)
class Inspection:
    """An inspection task: go home, over the tray, then brush one of the parts from end to end."""

    tool_site: str
    """Site at the tips of the brush, which points along z and is moved along x."""
    tray: str
    """Body that the parts lie in."""
    hover: Annotated[float, Within(0.0, LENGTH)]
    """Height above the tray's origin at which the arm comes to rest before it brushes [m]."""
    brush_speed: Annotated[float, Within(1e-4, LENGTH)]
    """Highest speed of the brush on a part [m/s]."""
    guides: Annotated[int, Within(0, 100)]
    """How many key poses the brush passes between the ends of a stroke."""
    start_jitter: Annotated[float, Within(0.0, math.pi)]
    """How far from home random tasks begin at most, in every joint [rad]."""
    faces: tuple[FaceSpec, ...]
    parts: tuple[PartSpec, ...]
    controller: ControllerSpec | None = field(default=None, repr=False)

    @property
    def objects(self) -> tuple[PartSpec, ...]:
        """The movable objects of the cell: its parts."""
        return self.parts

    @property
    def gripper(self) -> None:
        """None: an inspection carries nothing."""
        return None

    @property
    def fixture_names(self) -> tuple[str, ...]:
        """Bodies of the cell that the data name and that do not move."""
        return (self.tray,)

    def part(self, name: str) -> PartSpec:
        """Part by name."""
        return _by_name("part", name, self.parts)

    def face(self, name: str) -> FaceSpec:
        """Face by name."""
        return _by_name("face", name, self.faces)


TaskData = Handling | Inspection
"""Task data of a cell, of either kind."""


def _by_name(what: str, name: str, specs):
    for spec in specs:
        if spec.name == name:
            return spec
    raise UnknownNameError(what, name, [spec.name for spec in specs])


def _handling(data: dict, name: str) -> Handling:
    gripper = record(GripperSpec, data.pop("gripper", {}), f"{name} [gripper]")
    trays = records(TraySpec, data.pop("trays", []), f"{name} [[trays]]")
    objects = records(ObjectSpec, data.pop("objects", []), f"{name} [[objects]]")
    return record(Handling, data | {"gripper": gripper, "trays": trays, "objects": objects}, name)


def _inspection(data: dict, name: str) -> Inspection:
    faces = records(FaceSpec, data.pop("faces", []), f"{name} [[faces]]")
    parts = records(PartSpec, data.pop("parts", []), f"{name} [[parts]]")
    inspection = record(Inspection, data | {"faces": faces, "parts": parts}, name)
    for part in parts:
        inspection.face(part.face)
    return inspection


_READERS = {"handling": _handling, "inspection": _inspection}


def read_task_data(path: Path) -> TaskData | None:
    """Read the task data beside a cell's model; None where there are none.

    Raises:
        WorkcellError: the file does not parse, or a field is missing or unknown.
        UnknownNameError: no such kind of task, or a part has a face that is not listed.
    """
    if not path.is_file():
        return None
    try:
        data = tomllib.loads(read_text(path, WorkcellError))
    except (ValueError, RecursionError) as error:  # syntax, or bytes that are no text
        raise WorkcellError(f"{path.name} is no valid TOML: {error}") from None
    kind = data.pop("kind", "handling")
    if not isinstance(kind, str) or kind not in _READERS:
        raise UnknownNameError(f"kind of task in {path.name}", kind, _READERS)
    if "controller" in data:
        table, where = data["controller"], f"{path.name} [controller]"
        data["controller"] = record(ControllerSpec, table, where)
    return _READERS[kind](data, path.name)
