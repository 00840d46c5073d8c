# SPDX-License-Identifier: MIT
"""Tasks: ordered key poses with what the gripper does between them."""

import json
from dataclasses import dataclass
from pathlib import Path

import jax.numpy as jnp
import mujoco
import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from hybrid_jax.errors import TaskError, WorkcellError
from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels.kinematics import tool_pose
from hybrid_jax.types import Workcell, WorkcellSource
from hybrid_jax.workcell.description import Handling, ObjectSpec
from hybrid_jax.workcell.geometry import as_row, pose_of
from hybrid_jax.workcell.layout import home_qpos

_DOWN = Rotation.from_euler("x", np.pi)


@dataclass(frozen=True)
class Task:
    """Carry one object from where it lies to its tray. Segment i leads from pose i to i + 1."""

    object_name: str
    object_poses: np.ndarray
    """`[object, 7]` where every object of the cell lies."""
    key_poses: np.ndarray
    """`[K, 8]` tool poses, in order; the first is where the tool is now."""
    carrying: tuple[bool, ...]
    """`[K - 1]` True for segments on which the object is held."""
    support: tuple[str, ...]
    """Fixtures that the held object may touch: it is lifted from or put on them."""
    start: np.ndarray
    """`[joint]` configuration in which the arm stands [rad]."""
    grasp: int = 0
    """Which of the object's grasps is used."""

    @property
    def phases(self) -> list[tuple[int, int]]:
        """Runs of segments between gripper events, as (first key pose, last key pose)."""
        cuts = (
            [0]
            + [i for i in range(1, len(self.carrying)) if self.carrying[i] != self.carrying[i - 1]]
            + [len(self.carrying)]
        )
        return list(zip(cuts[:-1], cuts[1:], strict=True))


def require_handling(cell: Workcell) -> Handling:
    """The cell's task data; WorkcellError where it has none."""
    if cell.source.task is None:
        raise WorkcellError(
            f"the cell {cell.source.name!r} has no task data: write "
            f"{cell.source.name}.toml beside its MJCF"
        )
    return cell.source.task


def yaw_of(pose: np.ndarray) -> float:
    """Heading of a body's x axis [rad] from its pose `[7]`."""
    x = Rotation.from_quat(pose[3:], scalar_first=True).apply([1.0, 0.0, 0.0])
    return float(np.arctan2(x[1], x[0]))


def upright(position, yaw: float) -> RigidTransform:
    """Pose turned about the vertical only."""
    return RigidTransform.from_components(
        np.asarray(position, float), Rotation.from_euler("z", yaw)
    )


def _grasp_frame(spec: ObjectSpec, grasp: int) -> RigidTransform:
    """The tool in the frame of an upright object."""
    return RigidTransform.from_components(np.array(spec.grasps[grasp]), _DOWN)


def object_in_tool(spec: ObjectSpec, grasp: int = 0) -> np.ndarray:
    """`[7]` pose of a grasped object in the tool's frame."""
    return as_row(_grasp_frame(spec, grasp).inv())


def grasp_pose(spec: ObjectSpec, pose: np.ndarray, grasp: int = 0) -> RigidTransform:
    """Tool pose that grasps an object lying at `pose` `[7]`: from above, along its heading."""
    return upright(pose[:3], yaw_of(pose)) * _grasp_frame(spec, grasp)


def place_pose(source: WorkcellSource, spec: ObjectSpec, grasp: int = 0) -> RigidTransform:
    """Tool pose that puts an object into its slot of its tray."""
    task, layout = source.task, source.layout
    tray = task.tray(spec.tray)
    body = source.model.body(tray.name)
    address = layout.object_qpos[layout.object_names.index(spec.name)]
    height = tray.floor + task.release + home_qpos(source.model)[address + 2]
    slot = upright([*spec.slot[:2], height], spec.slot[2])
    return pose_of(body.pos, body.quat) * slot * _grasp_frame(spec, grasp)


def _raised(pose: RigidTransform, height: float) -> RigidTransform:
    return RigidTransform.from_components(pose.translation + [0, 0, height], pose.rotation)


def home_pose(cell: Workcell) -> np.ndarray:
    """Tool pose `[8]` of the arm at home."""
    return np.asarray(tool_pose(cell, cell.home))


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
        object_poses: `[object, 7]` where all objects lie.
        start: `[joint]` where the arm stands [rad]; at home if None.
        grasp: which of the object's grasps to use.
    """
    data = require_handling(cell)
    spec = data.object(object_name)
    index = cell.source.layout.object_names.index(object_name)
    hold = grasp_pose(spec, object_poses[index], grasp)
    place = place_pose(cell.source, spec, grasp)
    rows = np.stack(
        [as_row(p) for p in (hold, _raised(hold, data.lift), _raised(place, data.hover), place)]
    ).astype(np.float32)
    poses = np.asarray(dq.from_parts(jnp.asarray(rows[:, :3]), jnp.asarray(rows[:, 3:])))
    home = home_pose(cell)
    start = np.asarray(cell.home if start is None else start, np.float32)
    begin = home if start.shape != cell.home.shape else np.asarray(tool_pose(cell, start))
    return Task(
        object_name,
        np.asarray(object_poses, np.float32),
        np.stack([begin, *poses, home]),
        (False, True, True, True, False),
        (data.table, spec.tray),
        start,
        grasp,
    )


def _overlapping(model, data, bodies) -> bool:
    for contact in data.contact[: data.ncon]:
        first, second = (int(model.geom_bodyid[g]) for g in contact.geom)
        if first in bodies and second in bodies:
            return True
    return False


def sample_scene(cell: Workcell, seed: int, settle: float = 0.4) -> np.ndarray:
    """Random poses `[object, 7]` of the cell's objects, at rest and apart from each other."""
    task, layout, model = require_handling(cell), cell.source.layout, cell.model
    rng = np.random.default_rng(seed)
    data = mujoco.MjData(model)
    for _ in range(200):
        data.qpos[:], data.qvel[:] = home_qpos(model), 0.0
        for spec, address in zip(task.objects, layout.object_qpos, strict=False):
            x, y, yaw = rng.uniform(-1, 1, 3) * spec.jitter + spec.spawn
            data.qpos[address : address + 2] = x, y
            data.qpos[address + 3 : address + 7] = np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)
        mujoco.mj_forward(model, data)
        if not _overlapping(model, data, layout.object_bodies):
            return _settle(cell, data, settle)
    raise WorkcellError(
        f"cell {cell.source.name!r}: 200 random scenes in a row had overlapping "
        "objects; widen the distances of 'spawn' or narrow 'jitter'"
    )


def _settle(cell: Workcell, data: mujoco.MjData, seconds: float) -> np.ndarray:
    """Let the objects come to rest while the arm holds its home."""
    model, layout = cell.model, cell.source.layout
    for actuator, address in zip(layout.actuators, layout.qpos, strict=True):
        if actuator >= 0:
            data.ctrl[actuator] = data.qpos[address]
    if layout.gripper_actuator >= 0:
        data.ctrl[layout.gripper_actuator] = require_handling(cell).gripper.open
    for _ in range(int(seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)
    return np.stack([data.qpos[a : a + 7] for a in layout.object_qpos]).astype(np.float32)


def random_task(cell: Workcell, seed: int) -> Task:
    """One object of a random scene."""
    objects = require_handling(cell).objects
    return handling_task(cell, objects[seed % len(objects)].name, sample_scene(cell, seed))


def read_task(cell: Workcell, path: Path) -> Task:
    """Read a task file: JSON with `object`, and `scene_seed` or `object_poses`.

    Raises:
        TaskError: unreadable, or a field that is missing or of the wrong shape.
    """
    try:
        values = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise TaskError(f"{path}: {error}") from None
    if not isinstance(values, dict) or "object" not in values:
        raise TaskError(f"{path}: needs a field 'object' with the name of an object")
    if "object_poses" in values:
        poses = np.asarray(values["object_poses"], np.float32)
        wanted = (len(cell.source.layout.object_names), 7)
        if poses.shape != wanted or not np.isfinite(poses).all():
            raise TaskError(
                f"{path}: object_poses must be {wanted[0]} finite rows of x, y, z, "
                f"qw, qx, qy, qz, got shape {poses.shape}"
            )
    else:
        poses = sample_scene(cell, int(values.get("scene_seed", 0)))
    return handling_task(cell, values["object"], poses)
