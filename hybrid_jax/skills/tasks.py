# SPDX-License-Identifier: MIT
"""Tasks of a cell, of whatever kind its data say: made to order, random, or read from a file."""

import json
from pathlib import Path

import numpy as np

from hybrid_jax.errors import TaskError
from hybrid_jax.skills.handling import handling_task, random_handling_task
from hybrid_jax.skills.inspection import inspection_task, random_inspection_task
from hybrid_jax.skills.scenes import require_task_data, sample_scene
from hybrid_jax.skills.task import Task
from hybrid_jax.types import Workcell
from hybrid_jax.workcell.description import Handling, Inspection

_MAKERS = {Handling: handling_task, Inspection: inspection_task}
_RANDOM = {Handling: random_handling_task, Inspection: random_inspection_task}


def make_task(cell: Workcell, object_name: str, object_poses: np.ndarray) -> Task:
    """What the cell's data say is to be done with an object, from home.

    Args:
        cell: with task data.
        object_name: which object.
        object_poses: `[object, 7]` where all objects lie.
    """
    return _MAKERS[type(require_task_data(cell))](cell, object_name, object_poses)


def random_task(cell: Workcell, seed: int) -> Task:
    """One object of a random scene."""
    return _RANDOM[type(require_task_data(cell))](cell, seed)


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
    return make_task(cell, values["object"], poses)
