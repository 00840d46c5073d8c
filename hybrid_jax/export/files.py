# SPDX-License-Identifier: MIT
"""One plan to a file; the file's ending says which kind."""

from pathlib import Path

from hybrid_jax.artifacts import write_text
from hybrid_jax.errors import UnknownNameError
from hybrid_jax.export.tpprogram import to_tp_program
from hybrid_jax.export.trajectories import to_csv, to_joint_trajectory, write_json
from hybrid_jax.planner.records import PlanResult
from hybrid_jax.skills.task import Task
from hybrid_jax.types import Workcell

ENDINGS = (".json", ".csv", ".ls")
"""Kinds of file: JointTrajectory as JSON or CSV, TP program."""


def refuse_ending(path: Path) -> None:
    """Raise before a plan is made that could not be written.

    Raises:
        UnknownNameError: no such kind of file.
    """
    if path.suffix.lower() not in ENDINGS:
        raise UnknownNameError(f"ending of {path.name}:", path.suffix, ENDINGS)


def write_plan(path: Path | str, cell: Workcell, task: Task, plan: PlanResult) -> None:
    """Write a plan. JSON says also why there is none; the others are written of plans alone.

    Args:
        path: ending in `.json`, `.csv` or `.ls`.
        cell: that the plan was made in.
        task: that was planned.
        plan: with status OK, but for JSON.

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
        text = to_csv(values) if ending == ".csv" else to_tp_program(cell, values, path.stem)
        write_text(path, text)
