# SPDX-License-Identifier: MIT
"""Trajectories in the layout of ROS's JointTrajectory, as JSON or CSV.

Events refer to a point by its number. Numbers keep nine digits: a controller that interpolates by
a quintic turns the last ones into accelerations.
"""

import csv
import io
import json
from pathlib import Path

import numpy as np

from hybrid_jax.contracts import PlanResult
from hybrid_jax.planner.timeline import timeline
from hybrid_jax.runtime.output_files import write_text
from hybrid_jax.tasks.task import Task
from hybrid_jax.types import Trajectory, Workcell

FORMAT = "hybrid_jax.trajectory/2"
"""Name and version of the JSON format."""
SOURCES = ("LfD", "DRL", "RRT")
"""Names of the sources of a point, in the order of `Trajectory.sources`."""
DIGITS = 9
"""Number of decimals."""


def _runs(sources: np.ndarray) -> list[dict]:
    """Runs of equal source `[point]`, each with its first and last point."""
    edges = np.flatnonzero(np.diff(sources)) + 1
    starts, ends = np.concatenate([[0], edges]), np.concatenate([edges, [len(sources)]]) - 1
    return [
        {"source": SOURCES[int(sources[a])], "first": int(a), "last": int(b)}
        for a, b in zip(starts, ends, strict=True)
    ]


def _points(trajectory: Trajectory, begin: float) -> list[dict]:
    """The points of a phase that begins at a time [s]."""
    rows = zip(
        trajectory.times,
        trajectory.positions,
        trajectory.velocities,
        trajectory.accelerations,
        strict=True,
    )
    return [
        {
            "positions": _rounded(q),
            "velocities": _rounded(v),
            "accelerations": _rounded(a),
            "time_from_start": round(begin + float(t), DIGITS),
        }
        for t, q, v, a in rows
    ]


def _rounded(values: np.ndarray) -> list[float]:
    return [round(float(x), DIGITS) for x in values]


def to_joint_trajectory(cell: Workcell, task: Task, plan: PlanResult) -> dict:
    """A plan as a dictionary, see `docs/file_formats.md`.

    The points of all phases stand in one list; where the gripper acts, time passes at rest. Where
    nothing is carried the list `gripper` is empty.

    Args:
        cell: that the plan was made in.
        task: that was planned.
        plan: its phases are empty where there is no plan.

    Returns:
        Lists and plain values; a point has `[joint]` positions, velocities and accelerations in
        the joint's unit (`joint_units`: rad or m), per s and s^2, and its time [s].
    """
    record = {
        "format": FORMAT,
        "joint_names": list(cell.joint_names),
        "joint_units": list(cell.joint_units),
        "points": [],
        "status": plan.status.name,
        "detail": plan.detail,
        "skills": plan.skills,
        "parts": [],
        "phases": [],
        "gripper": [],
    }
    sources, slots = [], timeline(task, plan.phases) if plan.phases else []
    for trajectory, slot in zip(plan.phases, slots, strict=True):
        # without a pause the last point of a phase is the first of the next
        shared = int(bool(record["points"]) and not slot.command)
        if slot.command:
            _say(record, slot.command)
        first = len(record["points"]) - shared
        record["points"] += _points(trajectory, slot.begin)[shared:]
        record["phases"].append({"first": first, "last": len(record["points"]) - 1})
        sources.append(trajectory.sources[shared:])
    if sources:
        record["parts"] = _runs(np.concatenate(sources))
        if slots[-1].command:
            _say(record, "open")
    return record


def _say(out: dict, command: str) -> None:
    """Add a command to the gripper at the last point so far, where the arm rests."""
    point = max(0, len(out["points"]) - 1)
    time = out["points"][point]["time_from_start"] if out["points"] else 0.0
    out["gripper"].append({"point": point, "time_from_start": time, "command": command})


def gripper_states(trajectory: dict) -> list[str]:
    """Last command to the gripper at each point.

    Args:
        trajectory: see `to_joint_trajectory`.

    Returns:
        `[point]` `open`, `close`, or empty before the first command.
    """
    states = [""] * len(trajectory["points"])
    for event in trajectory["gripper"]:
        states[event["point"] :] = [event["command"]] * (len(states) - event["point"])
    return states


def to_csv(trajectory: dict) -> str:
    """A trajectory as a table, one row a point.

    Args:
        trajectory: see `to_joint_trajectory`.

    Returns:
        Columns `time_from_start` [s], `source`, `gripper` (the last command, at this point or
        before: open, close, or nothing), then positions of all joints [rad or m], their
        velocities and their accelerations (per s and s^2).
    """
    names, buffer = trajectory["joint_names"], io.StringIO()
    rows = csv.writer(buffer, lineterminator="\n")
    columns = [name + kind for kind in ("", "_velocity", "_acceleration") for name in names]
    rows.writerow(["time_from_start", "source", "gripper", *columns])
    sources = [
        part["source"]
        for part in trajectory["parts"]
        for _ in range(part["first"], part["last"] + 1)
    ]
    states = gripper_states(trajectory)
    for point, source, state in zip(trajectory["points"], sources, states, strict=True):
        values = point["positions"] + point["velocities"] + point["accelerations"]
        rows.writerow([point["time_from_start"], source, state, *values])
    return buffer.getvalue()


def json_text(values) -> str:
    """JSON as it stands in files."""
    return json.dumps(values, indent=1) + "\n"


def write_json(path: Path, values) -> None:
    """Write JSON; the folder is made where it is missing."""
    write_text(path, json_text(values))
