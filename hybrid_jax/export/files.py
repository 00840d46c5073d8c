# SPDX-License-Identifier: MIT
"""Write one plan to a file; the file's ending selects the format."""

from collections.abc import Callable
from pathlib import Path

from hybrid_jax.contracts import PlanResult
from hybrid_jax.errors import UnknownNameError
from hybrid_jax.export.fanuc_tp import to_tp_program
from hybrid_jax.export.trajectories import to_csv, to_joint_trajectory, write_json
from hybrid_jax.runtime.artifacts import write_text
from hybrid_jax.tasks.task import Task
from hybrid_jax.types import Workcell

WRITERS: dict[str, Callable[[Workcell, dict, str], str]] = {
    ".csv": lambda cell, values, name: to_csv(values),
    ".ls": to_tp_program,
}
"""Text of a plan by the ending of its file, from cell, JointTrajectory and name of the file."""
ENDINGS = (".json", *WRITERS)
"""Endings of files; JSON is written without a plan too."""


def refuse_ending(path: Path) -> None:
    """Refuse an unknown ending, before a plan is made that could not be written.

    Raises:
        UnknownNameError: no such kind of file.
    """
    if path.suffix.lower() not in ENDINGS:
        raise UnknownNameError(f"ending of {path.name}:", path.suffix, ENDINGS)


def write_plan(path: Path | str, cell: Workcell, task: Task, plan: PlanResult) -> None:
    """Write a plan. Only JSON is written without a plan too, to say why there is none.

    Args:
        path: ending in `.json`, `.csv` or `.ls`.
        cell: that the plan was made in.
        task: that was planned.
        plan: its phases are empty where there is no plan.

    Raises:
        UnknownNameError: no such kind of file.
        WorkcellError: the cell's data do not describe such a controller.
    """
    path = Path(path)
    refuse_ending(path)
    values = to_joint_trajectory(cell, task, plan)
    ending = path.suffix.lower()
    if ending == ".json":
        write_json(path, values)
    elif values["points"]:
        write_text(path, WRITERS[ending](cell, values, path.stem))
