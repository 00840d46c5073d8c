# SPDX-License-Identifier: MIT
"""Inspection tasks: go over a tray, then brush one part from end to end (paper, experiments)."""

import math
from dataclasses import dataclass, field
from typing import Annotated, ClassVar

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from hybrid_jax.errors import WorkcellError
from hybrid_jax.kernels.collision.clearance import clearance
from hybrid_jax.runtime.kept_programs import kept
from hybrid_jax.tasks.scene_sampling import require_kind, sample_scene
from hybrid_jax.tasks.task import Task, as_dual_quats, home_pose, start_of
from hybrid_jax.types import Workcell
from hybrid_jax.workcell.description import LENGTH, ControllerSpec
from hybrid_jax.workcell.poses import pose_of
from hybrid_jax.workcell.records import Within, by_name, record, records

EXECUTION = "hybrid_jax.execution.inspection"
STUDY = "hybrid_jax.studies.inspection"

_DOWN = Rotation.from_euler("x", np.pi)
_TRIES = 1000
AT_HOME = 1e-3
"""Largest distance from home at which the arm is taken to be there, in any joint [rad]."""
ROOM = 0.01
"""Least clearance of a random start [m]."""


@kept
def _clearance(cell: Workcell, q):
    return clearance(cell, q)


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

    kind: ClassVar[str] = "inspection"

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

    def held_in_tool(self, name: str) -> None:
        """None: an inspection carries nothing."""
        del name

    def part(self, name: str) -> PartSpec:
        """Part by name."""
        return by_name("part", name, self.parts)

    def face(self, name: str) -> FaceSpec:
        """Face by name."""
        return by_name("face", name, self.faces)


def read(tables: dict, file: str) -> Inspection:
    """The task data of a TOML file's tables, see `contracts.TaskKind`."""
    faces = records(FaceSpec, tables.pop("faces", []), f"{file} [[faces]]")
    parts = records(PartSpec, tables.pop("parts", []), f"{file} [[parts]]")
    inspection = record(Inspection, tables | {"faces": faces, "parts": parts}, file)
    for part in parts:
        inspection.face(part.face)
    return inspection


def require_inspection(cell: Workcell) -> Inspection:
    """The cell's data of an inspection task; WorkcellError where it has none."""
    return require_kind(cell, Inspection, "inspected")


def on_face(face: FaceSpec, share: float) -> RigidTransform:
    """Tool pose on a face, in the part's frame: square to the face, x along the stroke.

    Args:
        face: that is brushed.
        share: how much of the stroke is done, from 0 to 1.
    """
    turn = Rotation.from_euler("x", np.interp(share, [0, 1], face.twist))
    position = [(share - 0.5) * face.length, 0.0, face.height]
    return RigidTransform.from_components(position, turn * _DOWN)


def brush_errors(face: FaceSpec, part: np.ndarray, tools: np.ndarray) -> tuple[np.ndarray, ...]:
    """Errors of a brush against where it should be on a face.

    Args:
        face: that is brushed.
        part: `[7]` pose of the part: position [m], quaternion.
        tools: `[point, 7]` poses of the tool along the stroke, as `part`.

    Returns:
        Angle between the brush and the face's normal `[point]` [rad], and how far its tips stand
        off the face `[point]` [m].
    """
    frame = pose_of(part[:3], part[3:]).inv()
    angles, gaps = [], []
    for tool in tools:
        pose = frame * pose_of(tool[:3], tool[3:])
        ideal = on_face(face, float(np.clip(pose.translation[0] / face.length + 0.5, 0, 1)))
        error = ideal.inv() * pose
        # the brush points along z: rotations about z do not count, and -z leads off the face
        angles.append(np.arccos(np.clip(error.rotation.as_matrix()[2, 2], -1, 1)))
        gaps.append(-error.translation[2])
    return np.array(angles), np.array(gaps)


def make_task(
    cell: Workcell,
    part_name: str,
    object_poses: np.ndarray,
    start: np.ndarray | None = None,
    stroke: tuple[float, float] = (0.0, 1.0),
) -> Task:
    """The task of brushing one part: home, over the tray, on the part, along it (con_1 to con_4).

    The arm comes to rest at each of them and ends on the part. If it does not stand at home, it
    goes there first.

    Args:
        cell: with inspection data.
        part_name: what to brush.
        object_poses: `[object, 7]` where all parts lie: position [m], quaternion.
        start: `[joint]` configuration in which the arm stands [rad or m]; home if None.
        stroke: shares of the face's length at which the stroke begins and ends.

    Returns:
        The task, with key poses `[pose, 8]`.

    Raises:
        WorkcellError: the cell has no inspection data.
        UnknownNameError: no such part.
    """
    data, model = require_inspection(cell), cell.model
    part, tray = data.part(part_name), model.body(data.tray)
    row = object_poses[cell.source.layout.object_names.index(part_name)]
    part_pose, face = pose_of(row[:3], row[3:]), data.face(part.face)
    hover_pose = pose_of(tray.pos, tray.quat) * RigidTransform.from_components(
        [0, 0, data.hover], _DOWN
    )
    stroke_poses = [
        part_pose * on_face(face, share) for share in np.linspace(*stroke, data.guides + 2)
    ]
    start, start_pose = start_of(cell, start)
    not_home = start.shape != cell.home.shape or bool(np.abs(start - cell.home).max() > AT_HOME)
    poses = [*as_dual_quats([hover_pose, *stroke_poses])]
    poses = [start_pose, home_pose(cell), *poses] if not_home else [start_pose, *poses]
    speeds = [np.inf] * (len(poses) - data.guides - 2) + [data.brush_speed] * (data.guides + 1)
    return Task(
        part_name,
        np.asarray(object_poses, np.float32),
        np.stack(poses),
        (False,) * len(speeds),
        start,
        stops=tuple(range(1, len(poses) - data.guides - 1)),
        transit=not_home,
        tool_speeds=tuple(speeds),
    )


def random_start(cell: Workcell, rng: np.random.Generator) -> np.ndarray:
    """Random configuration near home that keeps a clearance of `ROOM`.

    Returns:
        `[joint]` [rad or m], within the limits.

    Raises:
        WorkcellError: none of many random configurations has the clearance.
    """
    data, home = require_inspection(cell), np.asarray(cell.home)
    low, high = np.asarray(cell.joint_limits).T
    for _ in range(_TRIES):
        q = home + data.start_jitter * rng.uniform(-1, 1, home.size)
        q = np.clip(q, low, high).astype(np.float32)
        if _clearance(cell, q) > ROOM:
            return q
    raise WorkcellError(
        f"cell {cell.source.name!r}: none of {_TRIES} random starts has {1e3 * ROOM:.0f} mm of "
        "clearance; make 'start_jitter' smaller, or give the arm more room at home"
    )


def random_task(cell: Workcell, seed: int) -> Task:
    """The task of brushing one part of a random scene, with key poses `[pose, 8]`.

    The arm starts at random near home and brushes a random stretch of the part's face.
    """
    rng, parts = np.random.default_rng([seed, 1]), require_inspection(cell).parts
    stroke = rng.uniform(0.0, 0.35), rng.uniform(0.65, 1.0)
    name, start = parts[seed % len(parts)].name, random_start(cell, rng)
    return make_task(cell, name, sample_scene(cell, seed), start, stroke)
