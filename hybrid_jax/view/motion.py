# SPDX-License-Identifier: MIT
"""A plan as a film strip: configurations of the whole cell at an even rate, with clearances."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from hybrid_jax.kernels.collision import clearance
from hybrid_jax.kernels.kinematics import tool_pose
from hybrid_jax.planner.checking import PhaseScene
from hybrid_jax.planner.records import PlanResult
from hybrid_jax.planner.scenes import in_scene, phase_scene, segment_kinds
from hybrid_jax.planner.timeline import timeline
from hybrid_jax.skills.task import Task, as_rows
from hybrid_jax.types import Trajectory, Workcell
from hybrid_jax.workcell.geometry import as_row, pose_of
from hybrid_jax.workcell.layout import home_qpos

RATE = 30.0
"""Frames per second."""
TOGETHER = 128
"""Configurations of one kernel call."""

_clearances = jax.jit(jax.vmap(clearance, (None, 0)))
_tools = jax.jit(jax.vmap(tool_pose, (None, 0)))


@dataclass(frozen=True)
class Motion:
    """What a plan looks like. All arrays have one row a frame."""

    times: np.ndarray
    """`[frame]` from the start [s]."""
    qpos: np.ndarray
    """`[frame, nq]` of the whole cell."""
    tools: np.ndarray
    """`[frame, 3]` where the tool is [m]."""
    sources: np.ndarray
    """`[frame]` `Source` of each."""
    clearances: np.ndarray
    """`[frame]` distance of robot and payload to whatever they may not touch [m]."""


def resting_qpos(cell: Workcell, object_poses: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Configuration `[nq]` of the whole cell with its gripper as in the keyframe `home`.

    Args:
        cell: any.
        object_poses: `[object, 7]`.
        q: `[joint]` of the arm.
    """
    qpos, layout = home_qpos(cell.model), cell.source.layout
    qpos[list(layout.qpos)] = q
    for address, row in zip(layout.object_qpos, object_poses, strict=True):
        qpos[address : address + 7] = row
    return qpos


def in_pieces(function, cell: Workcell, q: np.ndarray) -> np.ndarray:
    """A batched kernel on many configurations `[n, joint]`, in calls of one size."""
    padded = np.pad(q, ((0, -len(q) % TOGETHER), (0, 0)), mode="edge").astype(np.float32)
    pieces = np.split(padded, len(padded) // TOGETHER)
    found = [np.asarray(function(cell, jnp.asarray(piece))) for piece in pieces]
    return np.concatenate(found)[: len(q)]


def motion_of(cell: Workcell, task: Task, plan: PlanResult) -> Motion:
    """Frames of a plan.

    Args:
        cell: that it was made in.
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
    nearest = np.abs(phase.times[:, None] - times).argmin(axis=0)
    tools = as_rows(in_pieces(_tools, cell, q))
    gaps = in_pieces(_clearances, in_scene(cell, scene), q)
    qpos = np.stack([_frame(cell, scene, *one) for one in zip(q, tools, strict=True)])
    return begin + times, qpos, tools[:, :3], phase.sources[nearest], gaps


def _frame(cell: Workcell, scene: PhaseScene, q: np.ndarray, tool: np.ndarray) -> np.ndarray:
    layout, poses = cell.source.layout, scene.poses.copy()
    if scene.held is not None and scene.held_in_tool is not None:
        hangs = pose_of(scene.held_in_tool[:3], scene.held_in_tool[3:])
        index = layout.object_names.index(scene.held)
        poses[index] = as_row(pose_of(tool[:3], tool[3:]) * hangs)
    qpos = resting_qpos(cell, poses, q)
    qpos[cell.model.jnt_qposadr[list(layout.fingers)]] = scene.opening
    return qpos
