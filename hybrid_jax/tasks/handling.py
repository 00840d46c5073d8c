# SPDX-License-Identifier: MIT
"""Handling tasks: take an object from where it lies and put it into its tray."""

import functools
from dataclasses import dataclass, field
from typing import Annotated, ClassVar

import mujoco
import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from hybrid_jax.tasks.scene_sampling import require_kind, sample_scene
from hybrid_jax.tasks.task import Hold, Task, as_dual_quats, home_pose, start_of, upright, yaw_of
from hybrid_jax.types import Workcell
from hybrid_jax.workcell.description import LENGTH, ControllerSpec, GripperSpec
from hybrid_jax.workcell.layout import home_qpos
from hybrid_jax.workcell.poses import as_row, pose_of
from hybrid_jax.workcell.records import Within, by_name, record, records
from hybrid_jax.workcell.source import WorkcellSource

EXECUTION = "hybrid_jax.execution.handling"
STUDY = "hybrid_jax.studies.handling"

_DOWN = Rotation.from_euler("x", np.pi)


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

    kind: ClassVar[str] = "handling"

    tool_site: str
    """Site that is the tool."""
    gripper: GripperSpec
    table: str
    """Body whose top the objects lie on."""
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
        return by_name("object", name, self.objects)

    def tray(self, name: str) -> TraySpec:
        """Tray by name."""
        return by_name("tray", name, self.trays)

    @property
    def fixture_names(self) -> tuple[str, ...]:
        """Bodies of the cell that the data name and that do not move."""
        return (self.table, *(tray.name for tray in self.trays))

    def held_in_tool(self, name: str) -> np.ndarray | None:
        """Pose `[7]` of an object in the tool at its first grasp; None if it is not handled."""
        names = [spec.name for spec in self.objects]
        return object_in_tool(self.object(name)) if name in names else None


def read(tables: dict, file: str) -> Handling:
    """The task data of a TOML file's tables, see `contracts.TaskKind`."""
    gripper = record(GripperSpec, tables.pop("gripper", {}), f"{file} [gripper]")
    trays = records(TraySpec, tables.pop("trays", []), f"{file} [[trays]]")
    objects = records(ObjectSpec, tables.pop("objects", []), f"{file} [[objects]]")
    tables |= {"gripper": gripper, "trays": trays, "objects": objects}
    return record(Handling, tables, file)


def require_handling(cell: Workcell) -> Handling:
    """The cell's data of a handling task; WorkcellError where it has none."""
    return require_kind(cell, Handling, "handled")


def _grasp_frame(spec: ObjectSpec, grasp: int) -> RigidTransform:
    """Pose of the tool in the frame of an upright object."""
    return RigidTransform.from_components(np.array(spec.grasps[grasp]), _DOWN)


@functools.cache
def object_in_tool(spec: ObjectSpec, grasp: int = 0) -> np.ndarray:
    """Pose of a grasped object in the tool's frame, read-only, since all callers share the array.

    Args:
        spec: of the object.
        grasp: which of its grasps is used.

    Returns:
        `[7]` position [m] and quaternion.
    """
    row = as_row(_grasp_frame(spec, grasp).inv())
    row.setflags(write=False)
    return row


def grasp_pose(spec: ObjectSpec, pose: np.ndarray, grasp: int = 0) -> RigidTransform:
    """Tool pose that grasps an object from above, along its heading.

    Args:
        spec: of the object.
        pose: `[7]` where the object lies: position [m], quaternion.
        grasp: which of its grasps to use.
    """
    return upright(pose[:3], yaw_of(pose)) * _grasp_frame(spec, grasp)


def place_pose(source: WorkcellSource, spec: ObjectSpec, grasp: int = 0) -> RigidTransform:
    """Tool pose that puts an object into its slot in its tray."""
    task, layout = source.task, source.layout
    tray = task.tray(spec.tray)
    body = source.model.body(tray.name)
    address = layout.object_qpos[layout.object_names.index(spec.name)]
    # the object's origin is to be as high above the tray's floor as it is above the table at home
    over_table = home_qpos(source.model)[address + 2] - _top(source.model, task.table)
    height = tray.floor + task.release + over_table
    slot = upright([*spec.slot[:2], height], spec.slot[2])
    return pose_of(body.pos, body.quat) * slot * _grasp_frame(spec, grasp)


def _top(model: mujoco.MjModel, name: str) -> float:
    """Height of the highest point of a body's geoms [m]; that of its origin without geoms."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    body = model.body(name)
    geoms = range(int(body.geomadr[0]), int(body.geomadr[0] + body.geomnum[0]))
    tops = [data.xpos[body.id, 2]] if not geoms else []
    for geom in geoms:
        centre, half = np.split(model.geom_aabb[geom], 2)
        upward = data.geom_xmat[geom].reshape(3, 3)[2]
        tops.append(data.geom_xpos[geom, 2] + upward @ centre + np.abs(upward) @ half)
    return float(max(tops))


def _raised(pose: RigidTransform, height: float) -> RigidTransform:
    """The pose moved upwards by a height [m]."""
    return RigidTransform.from_components(pose.translation + [0, 0, height], pose.rotation)


def make_task(
    cell: Workcell,
    object_name: str,
    object_poses: np.ndarray,
    start: np.ndarray | None = None,
    grasp: int = 0,
) -> Task:
    """The task of sorting one object: start, grasp, lifted, above its slot, placed, home.

    Args:
        cell: with task data.
        object_name: what to carry to its tray.
        object_poses: `[object, 7]` where all objects lie: position [m], quaternion.
        start: `[joint]` configuration in which the arm stands [rad or m]; home if None.
        grasp: which of the object's grasps to use.

    Returns:
        The task, with key poses `[6, 8]`.

    Raises:
        WorkcellError: the cell has no handling data.
        UnknownNameError: no such object.
    """
    data = require_handling(cell)
    spec = data.object(object_name)
    index = cell.source.layout.object_names.index(object_name)
    grasped = grasp_pose(spec, object_poses[index], grasp)
    placed = place_pose(cell.source, spec, grasp)
    poses = as_dual_quats(
        [grasped, _raised(grasped, data.lift), _raised(placed, data.hover), placed]
    )
    start, start_pose = start_of(cell, start)
    return Task(
        object_name,
        np.asarray(object_poses, np.float32),
        np.stack([start_pose, *poses, home_pose(cell)]),
        (False, True, True, True, False),
        start,
        np.asarray(cell.home),
        hold=Hold(object_in_tool(spec, grasp), spec.grip, (data.table, spec.tray)),
        opening=data.gripper.open,
    )


def random_task(cell: Workcell, seed: int) -> Task:
    """The task of sorting one object of a random scene, with key poses `[6, 8]`."""
    objects = require_handling(cell).objects
    return make_task(cell, objects[seed % len(objects)].name, sample_scene(cell, seed))
