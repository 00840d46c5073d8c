# SPDX-License-Identifier: MIT
"""Write one plan to a file; the file's ending selects the format."""

from collections.abc import Callable
from pathlib import Path

from hybrid_jax.contracts import PlanResult
from hybrid_jax.errors import UnknownNameError
from hybrid_jax.export.fanuc_tp import to_tp_program
from hybrid_jax.export.trajectories import json_text, to_csv, to_joint_trajectory
from hybrid_jax.runtime.output_files import write_text
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
    text = plan_text(path, cell, task, plan)
    if text is not None:
        write_text(path, text)


def plan_text(path: Path, cell: Workcell, task: Task, plan: PlanResult) -> str | None:
    """What a file of a plan holds; None where there is no plan, unless it is JSON.

    Args:
        path: its ending selects the format, its name goes into programs.
        cell, task, plan: as in `write_plan`.
    """
    values, ending = to_joint_trajectory(cell, task, plan), path.suffix.lower()
    if ending == ".json":
        return json_text(values)
    return WRITERS[ending](cell, values, path.stem) if values["points"] else None


def plan_summary(plan: PlanResult) -> dict:
    """A plan without its points: plain values for the answer of a command or a server."""
    return {
        "status": plan.status.name,
        "detail": plan.detail,
        "skills": plan.skills,
        "motion_seconds": round(sum(float(t.times[-1]) for t in plan.phases), 3),
        "shares": {source.name: round(share, 3) for source, share in plan.shares.items()},
    }
