# SPDX-License-Identifier: MIT
"""What a plan is worth: length, seams, jerk, clearance, and how well it keeps to the task."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from hybrid_jax.contracts import PlanResult
from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels.collision.motion_validation import path_clearance
from hybrid_jax.kernels.kinematics import tool_pose
from hybrid_jax.planner.phase_scenes import CARRYING, inside, segment_kinds, task_scenes
from hybrid_jax.tasks.task import Task
from hybrid_jax.types import Trajectory, Workcell

APPROACH, STRETCHES = 0.08, 16
"""The last way of the tool before it grasps or lets go [m], and parts that it is compared in."""

_poses = jax.jit(jax.vmap(tool_pose, (None, 0)))


@dataclass(frozen=True)
class Measures:
    """Of one plan."""

    length: float
    """Of the joint path [rad]."""
    duration: float
    """[s]."""
    seam: float
    """Largest joint step at a change of the source over the median step; NaN without seams."""
    jerk: float
    """Root mean square over joints and time [rad/s^3]."""
    clearance: float
    """Smallest, at most 5 cm [m]."""
    tilt: float
    """Mean angle between the tool's axis and the vertical while it carries [deg]."""
    approach: float
    """Mean angle between the tool's way and that of the demonstration, on the last 8 cm before it
    grasps or lets go [deg]."""


def seam_ratio(phases: list[Trajectory]) -> float:
    """Largest joint step beside a change of the source over the median step of its trajectory."""
    worst = []
    for phase in phases:
        step = np.abs(np.diff(phase.positions, axis=0)).max(axis=1)
        seams = np.flatnonzero(np.diff(phase.sources.astype(int)))
        near = np.unique(np.clip(seams[:, None] + [-1, 0, 1], 0, len(step) - 1))
        if len(near):
            worst.append(step[near].max() / np.median(step))
    return max(worst, default=np.nan)


def _tool(cell: Workcell, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions `[point, 3]` and axes `[point, 3]` of the tool."""
    size = -(-len(q) // 256) * 256  # few shapes, few programs
    padded = np.concatenate([q, q[-1:].repeat(size - len(q), axis=0)])
    poses = np.asarray(_poses(cell, jnp.asarray(padded, jnp.float32)), float)[: len(q)]
    w, x, y, z = poses[:, :4].T
    axis = np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=1)
    dual, real = poses[:, 4:], poses[:, :4]
    position = 2 * (
        real[:, :1] * dual[:, 1:] - dual[:, :1] * real[:, 1:] + np.cross(real[:, 1:], dual[:, 1:])
    )
    return position, axis


def _angle(cosine: np.ndarray) -> np.ndarray:
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def _last_steps(position: np.ndarray) -> np.ndarray:
    """`[STRETCHES, 3]` even steps of the last stretch of a way, by its length."""
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(position, axis=0), axis=1))])
    at = np.linspace(max(0.0, way[-1] - APPROACH), way[-1], STRETCHES + 1)
    points = np.stack([np.interp(at, way, column) for column in position.T], axis=1)
    return np.diff(points, axis=0)


def _approach(position: np.ndarray, shown: np.ndarray) -> float:
    """Mean angle [deg] of the last stretches of two ways of the tool."""
    own, other = _last_steps(position), _last_steps(shown)
    sizes = np.linalg.norm(own, axis=1) * np.linalg.norm(other, axis=1)
    return float(_angle(np.sum(own * other, axis=1) / np.maximum(sizes, 1e-12)).mean())


def measure(cell: Workcell, task: Task, plan: PlanResult, shown: np.ndarray) -> Measures:
    """Measures of a plan with status OK.

    Args:
        cell: of the task.
        task: that was planned.
        plan: its trajectories.
        shown: `[segment, point, 8]` the demonstrations, mapped to the task.
    """
    scenes, kinds = task_scenes(cell, task), segment_kinds(task)
    gaps, jerks, tilts, approaches = [], [], [], []
    for (low, high), phase in zip(task.phases, plan.phases, strict=True):
        gaps.append(path_clearance(inside(cell, scenes, low), phase.positions).min())
        jerks.append(np.diff(phase.accelerations, axis=0) / np.diff(phase.times)[:, None])
        position, axis = _tool(cell, phase.positions)
        if kinds[low] == CARRYING:
            tilts.append(_angle(-axis[:, 2]).mean())
        if high < len(task.carrying):
            demonstration = np.asarray(dq.position(jnp.asarray(shown[high - 1])), float)
            approaches.append(_approach(position, demonstration))
    ways = [np.linalg.norm(np.diff(p.positions, axis=0), axis=1).sum() for p in plan.phases]
    return Measures(
        float(sum(ways)),
        float(sum(p.times[-1] for p in plan.phases)),
        seam_ratio(plan.phases),
        float(np.sqrt(np.mean(np.concatenate(jerks) ** 2))),
        float(min(gaps)),
        float(np.mean(tilts)),
        float(np.mean(approaches)),
    )
