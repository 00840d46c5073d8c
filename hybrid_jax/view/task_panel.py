# SPDX-License-Identifier: MIT
"""A task on the page: choose an object, drag key poses, save."""

import json
import re
from collections.abc import Callable
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import viser

from hybrid_jax.errors import TaskError
from hybrid_jax.feasibility.building import FeasibilityMap
from hybrid_jax.feasibility.lookup import query
from hybrid_jax.runtime.output_files import write_text
from hybrid_jax.tasks.registry import make_task, task_values, with_key_poses
from hybrid_jax.tasks.scene_sampling import require_task_data, sample_scene
from hybrid_jax.tasks.task import Task, as_rows
from hybrid_jax.types import Workcell

FARTHEST = 100.0
"""Largest coordinate of a key pose that was dragged [m]."""
INVITATION = "Choose an object, drag its key poses, plan."


class TaskPanel:
    """Holds the task that is being built, and its handles."""

    def __init__(
        self,
        server: viser.ViserServer,
        cell: Workcell,
        fmap: FeasibilityMap | None,
        changed: Callable[[Task], None],
        guarded: Callable[[Callable[[], str]], None],
    ):
        """Add the controls.

        Args:
            server: of the page.
            cell: with task data.
            fmap: labels each key pose with its feasibility; no labels if None.
            changed: called with every new task.
            guarded: runs the action of a control, one at a time, and shows its sentence.
        """
        self._server, self._cell, self._map, self._changed = server, cell, fmap, changed
        self._handles: list[viser.TransformControlsHandle] = []
        self._labels: list[viser.LabelHandle] = []
        self._guarded = guarded
        names = tuple(spec.name for spec in require_task_data(cell).objects)
        self.object = server.gui.add_dropdown("Object", options=names)
        self.scene = server.gui.add_number("Scene", initial_value=0, min=0, step=1)
        self.again = server.gui.add_button("Reset key poses")
        self.object.on_update(lambda _: guarded(self.reset))
        self.scene.on_update(lambda _: guarded(self.reset))
        self.again.on_click(lambda _: guarded(self.reset))
        self.reset()

    def reset(self) -> str:
        """Begin with the task that the cell's data define in the chosen scene.

        Returns:
            A sentence that says what to do next.

        Raises:
            HybridJaxError: there is no such task; the present one stays.
        """
        poses = sample_scene(self._cell, _scene_number(self.scene.value))
        self.task = make_task(self._cell, self.object.value, poses)
        self._place_handles()
        self._tell()
        return INVITATION

    def _place_handles(self) -> None:
        for handle in self._handles:
            handle.remove()  # and the label that hangs on it
        self._handles, self._labels = [], []
        for number, row in enumerate(as_rows(self.task.key_poses[self.task.given]), 1):
            handle = self._server.scene.add_transform_controls(
                f"/key/{number}", scale=0.1, position=row[:3], wxyz=row[3:], depth_test=False
            )
            handle.on_update(lambda _: self._guarded(self._dragged))
            self._handles.append(handle)
            self._labels.append(self._server.scene.add_label(f"/key/{number}/label", str(number)))

    def _dragged(self) -> str:
        rows = np.array([[*handle.position, *handle.wxyz] for handle in self._handles], float)
        lengths = np.linalg.norm(rows[:, 3:], axis=1)
        valid = (np.abs(rows[:, :3]) < FARTHEST).all(axis=1) & (np.abs(lengths - 1) < 0.1)
        if not valid.all():
            number = int(np.argmin(valid))
            self._place_handles()
            raise TaskError(
                f"key pose {number + 1} was dragged to {rows[number]}: no place in the cell; it is "
                "where it was"
            )
        rows[:, 3:] /= lengths[:, None]
        self.task = with_key_poses(self._cell, self.task, rows)
        self._tell()
        return "Key poses dragged; plan."

    def _tell(self) -> None:
        poses = self.task.key_poses[self.task.given]
        for number, (label, pose) in enumerate(zip(self._labels, poses, strict=True), 1):
            label.text = f"{number}{self._feasibility(pose)}"
        self._changed(self.task)

    def _feasibility(self, pose: np.ndarray) -> str:
        if self._map is None:
            return ""
        value, _ = query(self._map, jnp.asarray(pose))
        return f": feasibility {float(value):.2f}"

    def hide(self, hidden: bool) -> None:
        """Hide the handles, or show them again."""
        for handle in self._handles:
            handle.visible = not hidden

    def save(self, folder: Path, name: str) -> str:
        """Write the task as a file for `hybrid_jax.plan`.

        Args:
            folder: that all tasks of the page are saved to.
            name: of the file in it.

        Returns:
            A sentence that says where it is.

        Raises:
            TaskError: the name is not one of a JSON file, leads elsewhere, or is taken.
        """
        if not re.fullmatch(r"[\w-][\w. -]{0,100}\.json", name):
            raise TaskError(
                f"{name!r} is no name for a task file: letters, digits, '_', '-', '.', and .json "
                f"at its end; it is saved in {folder}"
            )
        path = folder / name
        if path.exists():
            raise TaskError(f"{path} is there already: choose another name")
        write_text(path, json.dumps(task_values(self.task), indent=1) + "\n")
        return f"Saved {path}."


def _scene_number(value) -> int:
    """Number of a scene from the value that the browser sent.

    Raises:
        TaskError: the value is no whole number from 0 on.
    """
    try:
        number = int(value)
    except (TypeError, ValueError, OverflowError):
        number = -1
    if not 0 <= number < 2**63:
        raise TaskError(f"the scene must be a whole number from 0 on, got {value!r}")
    return number
