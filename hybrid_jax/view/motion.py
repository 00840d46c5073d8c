# SPDX-License-Identifier: MIT
"""Frames of a plan: configurations of the whole cell at an even rate, with clearances."""

from dataclasses import dataclass

import jax
import numpy as np

from hybrid_jax.contracts import PlanResult
from hybrid_jax.kernels.batching import in_calls
from hybrid_jax.kernels.collision.distance import FAR
from hybrid_jax.kernels.collision.motion_validation import path_clearance
from hybrid_jax.kernels.kinematics import tool_pose
from hybrid_jax.planner.phase_scenes import in_scene, phase_scene, segment_kinds
from hybrid_jax.planner.timeline import timeline
from hybrid_jax.planner.trajectory_check import PhaseScene
from hybrid_jax.runtime.kept_programs import kept
from hybrid_jax.tasks.task import Task, as_rows
from hybrid_jax.types import Trajectory, Workcell
from hybrid_jax.workcell.layout import home_qpos
from hybrid_jax.workcell.poses import as_row, pose_of

RATE = 30.0
"""Frames per second."""
CONFIGURATIONS_PER_CALL = 128
"""Configurations of one kernel call."""


@kept
def _tools(cell: Workcell, q):
    """Tool poses `[point, 8]` at configurations `[point, joint]`."""
    return jax.vmap(tool_pose, (None, 0))(cell, q)


@dataclass(frozen=True)
class Motion:
    """Frames of a plan. All arrays have one row a frame."""

    times: np.ndarray
    """`[frame]` time from the start [s]."""
    qpos: np.ndarray
    """`[frame, nq]` MuJoCo's `qpos` of the whole cell."""
    tools: np.ndarray
    """`[frame, 3]` position of the tool [m]."""
    sources: np.ndarray
    """`[frame]` `Source` of each frame."""
    clearances: np.ndarray
    """`[frame]` distance of robot and payload to whatever they may not touch [m]."""


def resting_qpos(cell: Workcell, object_poses: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Configuration `[nq]` of the whole cell with its gripper as in the keyframe `home`.

    Args:
        cell: any scene of it.
        object_poses: `[object, 7]` positions [m] and quaternions.
        q: `[joint]` configuration of the arm [rad].
    """
    qpos, layout = home_qpos(cell.model), cell.source.layout
    qpos[list(layout.qpos)] = q
    for address, row in zip(layout.object_qpos, object_poses, strict=True):
        qpos[address : address + 7] = row
    return qpos


def motion_of(cell: Workcell, task: Task, plan: PlanResult) -> Motion:
    """Frames of a plan.

    Args:
        cell: that the plan was made in.
        task: that was planned.
        plan: with status OK.
    """
    kinds, parts = segment_kinds(task), []
    slots = timeline(task, plan.phases)
    for (low, _), phase, slot in zip(task.phases, plan.phases, slots, strict=True):
        scene = phase_scene(cell, task, int(kinds[low]))
        parts.append(_phase_frames(cell, scene, phase, slot.begin))
    columns = zip(*parts, strict=True)
    return Motion(*(np.concatenate(column) for column in columns))


def _phase_frames(cell: Workcell, scene: PhaseScene, phase: Trajectory, begin: float) -> tuple:
    times = np.append(np.arange(0.0, phase.times[-1], 1 / RATE), phase.times[-1])
    q = np.stack([np.interp(times, phase.times, column) for column in phase.positions.T], axis=1)
    # sources are labels: the nearest point's holds, nothing is interpolated
    nearest = np.abs(phase.times[:, None] - times).argmin(axis=0)
    q32 = q.astype(np.float32)
    run = lambda rows, used: _tools(cell, q32[rows])  # noqa: E731
    tools = as_rows(in_calls(run, len(q), (CONFIGURATIONS_PER_CALL,)))
    gaps = path_clearance(in_scene(cell, scene), q32, FAR)
    qpos = np.stack([_frame(cell, scene, *row) for row in zip(q, tools, strict=True)])
    return begin + times, qpos, tools[:, :3], phase.sources[nearest], gaps


def _frame(cell: Workcell, scene: PhaseScene, q: np.ndarray, tool: np.ndarray) -> np.ndarray:
    layout, poses = cell.source.layout, scene.poses.copy()
    if scene.held is not None and scene.held_in_tool is not None:
        held_pose = pose_of(scene.held_in_tool[:3], scene.held_in_tool[3:])
        index = layout.object_names.index(scene.held)
        poses[index] = as_row(pose_of(tool[:3], tool[3:]) * held_pose)
    qpos = resting_qpos(cell, poses, q)
    qpos[cell.model.jnt_qposadr[list(layout.fingers)]] = scene.opening
    return qpos
