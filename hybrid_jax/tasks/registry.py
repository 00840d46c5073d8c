# SPDX-License-Identifier: MIT
"""Tasks of a cell, of the kind that its data say: made to order, random, or read from a file."""

import json
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np

from hybrid_jax.errors import TaskError
from hybrid_jax.kernels.argument_checks import single_precision
from hybrid_jax.runtime.input_files import read_text
from hybrid_jax.tasks.scene_sampling import require_task_data, sample_scene
from hybrid_jax.tasks.task import Task, as_dual_quats, as_rows
from hybrid_jax.types import Workcell
from hybrid_jax.workcell.description import kind_module
from hybrid_jax.workcell.poses import as_row, pose_of


def kind_of(cell: Workcell) -> ModuleType:
    """Module of the kind of task that the cell's data describe, a `contracts.TaskKind`.

    Raises:
        WorkcellError: the cell has no task data.
    """
    return kind_module(require_task_data(cell).kind)


@single_precision
def make_task(
    cell: Workcell,
    object_name: str,
    object_poses: np.ndarray,
    start: np.ndarray | None = None,
) -> Task:
    """The task that the cell's data set for an object.

    Args:
        cell: with task data.
        object_name: which object.
        object_poses: `[object, 7]` where all objects lie: position [m], quaternion.
        start: `[joint]` configuration in which the arm stands [rad or m]; home if None.

    Returns:
        Key poses `[pose, 8]` and what happens between them.

    Raises:
        WorkcellError: the cell has no task data.
        UnknownNameError: no such object.
    """
    return kind_of(cell).make_task(cell, object_name, object_poses, start)


@single_precision
def random_task(cell: Workcell, seed: int) -> Task:
    """The task of one object of a random scene.

    Args:
        cell: with task data.
        seed: of the scene and of what else is random.

    Returns:
        Key poses `[pose, 8]` and what happens between them.

    Raises:
        WorkcellError: the cell has no task data, or its objects find no room.
    """
    return kind_of(cell).random_task(cell, seed)


def with_key_poses(cell: Workcell, task: Task, rows: np.ndarray) -> Task:
    """A task with other key poses; an object that is carried lies where it is grasped.

    Args:
        cell: of the task.
        task: whose key poses `Task.given` are replaced.
        rows: `[pose, 7]` tool poses: position [m], unit quaternion.

    Returns:
        The task with key poses `[pose, 8]`; an object that is carried has its new pose, too.
    """
    poses, objects = task.key_poses.copy(), task.object_poses.copy()
    tools = [pose_of(row[:3], row[3:]) for row in rows]
    poses[task.given] = as_dual_quats(tools)
    if any(task.carrying):
        in_tool = task.require_hold().in_tool
        grasp = tools[task.carrying.index(True) - 1]
        index = cell.source.layout.object_names.index(task.object_name)
        objects[index] = as_row(grasp * pose_of(in_tool[:3], in_tool[3:]))
    return replace(task, key_poses=poses, object_poses=objects)


def task_values(task: Task) -> dict:
    """Values of a task file from which `read_task` makes the same task.

    Returns:
        `object`; `object_poses` `[object, 7]` and `key_poses` `[pose, 7]` as nested lists:
        position [m], quaternion.
    """
    return {
        "object": task.object_name,
        "object_poses": np.round(task.object_poses.astype(float), 6).tolist(),
        "key_poses": np.round(as_rows(task.key_poses[task.given]), 6).tolist(),
    }


@single_precision
def read_task(cell: Workcell, path: Path | str) -> Task:
    """Read a task file: JSON with `object`, and `scene_seed` or `object_poses`.

    `key_poses` replaces the key poses that follow from the cell's data, see `with_key_poses`.

    Args:
        cell: with task data.
        path: of the file.

    Returns:
        Key poses `[pose, 8]` and what happens between them.

    Raises:
        TaskError: unreadable, or a field that is missing or of the wrong shape.
    """
    try:
        values = json.loads(read_text(Path(path), TaskError))
    except (ValueError, RecursionError) as error:
        raise TaskError(f"{path}: {error}") from None
    return task_of(cell, values, str(path))


def task_of(cell: Workcell, values, name: str) -> Task:
    """The task that the content of a task file describes, see `read_task`.

    Args:
        cell: with task data.
        values: what JSON holds.
        name: what sentences about errors begin with.

    Returns:
        Key poses `[pose, 8]` and what happens between them.

    Raises:
        TaskError: a field that is missing or of the wrong shape.
    """
    fields = ("object", "scene_seed", "object_poses", "key_poses")
    if not isinstance(values, dict) or not isinstance(values.get("object"), str):
        raise TaskError(f"{name}: needs a field 'object' with the name of an object")
    if unknown := set(values) - set(fields):
        raise TaskError(f"{name}: unknown field {min(unknown)!r}; there are: {', '.join(fields)}")
    if "object_poses" in values:
        count = len(cell.source.layout.object_names)
        poses = _rows(name, "object_poses", values["object_poses"], count)
    else:
        poses = sample_scene(cell, _seed(name, values.get("scene_seed", 0)))
    task = make_task(cell, values["object"], poses)
    if "key_poses" not in values:
        return task
    count = len(task.key_poses[task.given])
    return with_key_poses(cell, task, _rows(name, "key_poses", values["key_poses"], count))


def _seed(name: str, value) -> int:
    """Seed of a random scene from a file, checked."""
    # `bool` is a subclass of `int`: JSON's `true` is refused by name
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 2**63:
        raise TaskError(f"{name}: scene_seed must be a whole number from 0 on, got {value!r}")
    return value


def _rows(name: str, field: str, values, count: int) -> np.ndarray:
    """Poses of a file, `[count, 7]`: position [m], quaternion brought to length 1."""
    rule = f"{name}: {field} must be {count} finite rows of x, y, z [m], qw, qx, qy, qz"
    try:
        rows = np.asarray(values, np.float32)
    except (TypeError, ValueError, OverflowError):
        raise TaskError(f"{rule}, got {str(values)[:60]}") from None
    if rows.shape != (count, 7) or not np.isfinite(rows).all():
        raise TaskError(f"{rule}, got shape {rows.shape}")
    lengths = np.linalg.norm(rows[:, 3:], axis=1, keepdims=True)
    if (np.abs(lengths - 1) > 0.01).any():
        raise TaskError(
            f"{rule}: the quaternion of row {int(np.argmax(abs(lengths - 1)))} has not length 1"
        )
    rows[:, 3:] /= lengths
    return rows
