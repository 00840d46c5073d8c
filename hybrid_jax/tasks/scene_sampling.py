# SPDX-License-Identifier: MIT
"""Random scenes of a cell: its objects at rest, within the regions of the task data."""

from typing import TypeVar

import mujoco
import numpy as np

from hybrid_jax.errors import WorkcellError
from hybrid_jax.types import Workcell
from hybrid_jax.workcell.description import TaskData
from hybrid_jax.workcell.layout import home_qpos

T = TypeVar("T")


def require_kind(cell: Workcell, kind: type[T], done: str) -> T:
    """The cell's task data of one kind.

    Args:
        cell: any.
        kind: class of task data that is asked for.
        done: what is done with objects in such a cell, for the message: "handled".

    Raises:
        WorkcellError: the cell has no task data, or data of another kind.
    """
    data, name = require_task_data(cell), cell.source.name
    if not isinstance(data, kind):
        raise WorkcellError(f"nothing is {done} in the cell {name!r}: {name}.toml says otherwise")
    return data


def require_task_data(cell: Workcell) -> TaskData:
    """The cell's task data.

    Raises:
        WorkcellError: it has none.
    """
    if cell.source.task is None:
        raise WorkcellError(
            f"the cell {cell.source.name!r} has no task data: write "
            f"{cell.source.name}.toml beside its MJCF"
        )
    return cell.source.task


def _overlapping(model, data, bodies) -> bool:
    """Do two of the bodies touch at the configuration of `data`?"""
    for contact in data.contact[: data.ncon]:
        first, second = (int(model.geom_bodyid[g]) for g in contact.geom)
        if first in bodies and second in bodies:
            return True
    return False


def sample_scene(cell: Workcell, seed: int, settle: float = 0.4) -> np.ndarray:
    """Random poses of the cell's objects, at rest and apart from each other.

    Args:
        cell: with task data.
        seed: of the scene.
        settle: time that the objects are given to come to rest [s].

    Returns:
        `[object, 7]` position [m] and quaternion.

    Raises:
        WorkcellError: the cell has no task data, or its objects find no room.
    """
    task, layout, model = require_task_data(cell), cell.source.layout, cell.model
    rng = np.random.default_rng(seed)
    data = mujoco.MjData(model)
    for _ in range(200):
        data.qpos[:], data.qvel[:] = home_qpos(model), 0.0
        # the layout has the objects of the task data first; all others stay as they are at home
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
    """Poses `[object, 7]` of the objects after some seconds, in which the arm holds its home."""
    model, layout = cell.model, cell.source.layout
    for actuator, address in zip(layout.actuators, layout.qpos, strict=True):
        if actuator >= 0:
            data.ctrl[actuator] = data.qpos[address]
    if layout.gripper_actuator >= 0:
        data.ctrl[layout.gripper_actuator] = require_task_data(cell).gripper.open
    for _ in range(int(seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)
    return np.stack([data.qpos[a : a + 7] for a in layout.object_qpos]).astype(np.float32)
