# SPDX-License-Identifier: MIT
"""Trajectories in the layout of ROS's JointTrajectory, as JSON."""

import json
from pathlib import Path

import numpy as np

from hybrid_jax.planner.records import PlanResult
from hybrid_jax.skills.task import Task
from hybrid_jax.types import Workcell

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


def to_joint_trajectory(cell: Workcell, task: Task, plan: PlanResult) -> dict:
    """A plan as a dictionary: `joint_names`, `points`, `status`, `parts`, `gripper`.

    The points of all phases stand in one list; where the gripper acts, time passes at rest. Where
    nothing is carried the list `gripper` is empty.
    """
    out = {
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
        new = slice(int(phase > 0 and not grips), None)
        for t, q, v, a in zip(
            trajectory.times[new],
            trajectory.positions[new],
            trajectory.velocities[new],
            trajectory.accelerations[new],
            strict=True,
        ):
            out["points"].append(
                {
                    "positions": [round(float(x), 6) for x in q],
                    "velocities": [round(float(x), 6) for x in v],
                    "accelerations": [round(float(x), 6) for x in a],
                    "time_from_start": round(begin + float(t), 6),
                }
            )
        sources.append(trajectory.sources[new])
        begin += float(trajectory.times[-1])
    if sources:
        out["parts"] = _runs(np.concatenate(sources))
        if grips:
            out["gripper"].append({"time_from_start": round(begin, 4), "command": "open"})
    return out


def write_json(path: Path, values) -> None:
    """Write JSON, making the folder if need be."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(values, indent=1) + "\n")
