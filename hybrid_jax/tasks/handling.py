# SPDX-License-Identifier: MIT
"""Handling tasks: take an object from where it lies and put it into its tray."""

import functools

import mujoco
import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from hybrid_jax.tasks.scene_sampling import require_kind, sample_scene
from hybrid_jax.tasks.task import Task, as_dual_quats, home_pose, start_of, upright, yaw_of
from hybrid_jax.types import Workcell, WorkcellSource
from hybrid_jax.workcell.description import Handling, ObjectSpec
from hybrid_jax.workcell.layout import home_qpos
from hybrid_jax.workcell.poses import as_row, pose_of, pose_row

_DOWN = Rotation.from_euler("x", np.pi)


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
    # the object's origin is to be as high above the tray's floor as it is above z = 0 at home
    height = tray.floor + task.release + home_qpos(source.model)[address + 2]
    slot = upright([*spec.slot[:2], height], spec.slot[2])
    return pose_of(body.pos, body.quat) * slot * _grasp_frame(spec, grasp)


def _raised(pose: RigidTransform, height: float) -> RigidTransform:
    """The pose moved upwards by a height [m]."""
    return RigidTransform.from_components(pose.translation + [0, 0, height], pose.rotation)


def handling_task(
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
        support=(data.table, spec.tray),
        grasp=grasp,
    )


def random_handling_task(cell: Workcell, seed: int) -> Task:
    """The task of sorting one object of a random scene, with key poses `[6, 8]`."""
    objects = require_handling(cell).objects
    return handling_task(cell, objects[seed % len(objects)].name, sample_scene(cell, seed))


def placed_pose(cell: Workcell, task: Task) -> np.ndarray:
    """Pose of a task's object when the gripper lets it go, for a task that carries it.

    Returns:
        `[7]` position [m] and quaternion, in the world.
    """
    release = task.key_poses[1 + int(np.flatnonzero(task.carrying)[-1])]
    in_tool = object_in_tool(require_handling(cell).object(task.object_name), task.grasp)
    tool, position, quat = pose_row(release), np.empty(3), np.empty(4)
    mujoco.mju_mulPose(position, quat, tool[:3], tool[3:], in_tool[:3], in_tool[3:])
    return np.concatenate([position, quat])
