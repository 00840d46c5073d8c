# SPDX-License-Identifier: MIT
"""Trajectories in the layout of ROS's JointTrajectory, as JSON or CSV."""

import csv
import io
import json
from pathlib import Path

import numpy as np

from hybrid_jax.artifacts import write_text
from hybrid_jax.planner.records import PlanResult
from hybrid_jax.skills.task import Task
from hybrid_jax.types import Trajectory, Workcell

FORMAT = "hybrid_jax.trajectory/1"
"""Name and version of the JSON format."""
SOURCES = ("LfD", "DRL", "RRT")
"""Names of the sources of a point, in the order of `Trajectory.sources`."""
GRIPPER_PAUSE = 0.8
"""Time between two phases in which the gripper moves [s]."""


def _runs(sources: np.ndarray) -> list[dict]:
    """Runs of equal source as first and last point."""
    edges = np.flatnonzero(np.diff(sources)) + 1
    starts, ends = np.concatenate([[0], edges]), np.concatenate([edges, [len(sources)]]) - 1
    return [
        {"source": SOURCES[int(sources[a])], "first": int(a), "last": int(b)}
        for a, b in zip(starts, ends, strict=True)
    ]


def _points(trajectory: Trajectory, begin: float) -> list[dict]:
    """The points of a phase that begins at a time [s]."""
    rows = zip(
        trajectory.times, trajectory.positions, trajectory.velocities, trajectory.accelerations,
        strict=True,
    )  # fmt: skip
    return [
        {
            "positions": [round(float(x), 6) for x in q],
            "velocities": [round(float(x), 6) for x in v],
            "accelerations": [round(float(x), 6) for x in a],
            "time_from_start": round(begin + float(t), 6),
        }
        for t, q, v, a in rows
    ]


def to_joint_trajectory(cell: Workcell, task: Task, plan: PlanResult) -> dict:
    """A plan as a dictionary: `joint_names`, `points`, `status`, `parts`, `gripper`.

    The points of all phases stand in one list; where the gripper acts, time passes at rest. Where
    nothing is carried the list `gripper` is empty. Angles are in rad, times in s.

    Args:
        cell: that the plan was made in.
        task: that was planned.
        plan: its phases are empty where there is no plan.
    """
    out = {
        "format": FORMAT,
        "joint_names": list(cell.joint_names),
        "points": [],
        "status": plan.status.name,
        "detail": plan.detail,
        "skills": plan.skills,
        "parts": [],
        "gripper": [],
    }
    begin, grips = 0.0, any(task.carrying)
    sources = []
    for phase, trajectory in enumerate(plan.phases):
        closed = bool(task.carrying[task.phases[phase][0]])
        if grips:
            command = "close" if closed else "open"
            out["gripper"].append({"time_from_start": round(begin, 4), "command": command})
            begin += GRIPPER_PAUSE if phase else 0.0
        # without a pause the last point of a phase is the first of the next
        first = int(phase > 0 and not grips)
        out["points"] += _points(trajectory, begin)[first:]
        sources.append(trajectory.sources[first:])
        begin += float(trajectory.times[-1])
    if sources:
        out["parts"] = _runs(np.concatenate(sources))
        if grips:
            out["gripper"].append({"time_from_start": round(begin, 4), "command": "open"})
    return out


def to_csv(trajectory: dict) -> str:
    """A trajectory as a table, one row a point.

    Args:
        trajectory: see `to_joint_trajectory`.

    Returns:
        Columns `time_from_start` [s], `source`, `gripper` (open, close, or nothing), then position,
        velocity and acceleration of each joint [rad, rad/s, rad/s^2].
    """
    names, out = trajectory["joint_names"], io.StringIO()
    rows = csv.writer(out, lineterminator="\n")
    columns = [name + kind for kind in ("", "_velocity", "_acceleration") for name in names]
    rows.writerow(["time_from_start", "source", "gripper", *columns])
    sources = [
        part["source"]
        for part in trajectory["parts"]
        for _ in range(part["first"], part["last"] + 1)
    ]
    for point, source in zip(trajectory["points"], sources, strict=True):
        began = [g["command"] for g in trajectory["gripper"]
                 if g["time_from_start"] <= point["time_from_start"] + 1e-6]  # fmt: skip
        values = point["positions"] + point["velocities"] + point["accelerations"]
        rows.writerow([point["time_from_start"], source, began[-1] if began else "", *values])
    return out.getvalue()


def write_json(path: Path, values) -> None:
    """Write JSON, making the folder if need be."""
    write_text(path, json.dumps(values, indent=1) + "\n")
