# SPDX-License-Identifier: MIT
"""Checks of tasks before planning, and sentences about what cannot be planned."""

from dataclasses import replace

import numpy as np

from hybrid_jax.contracts import PlanResult
from hybrid_jax.kernels.collision.motion_validation import path_clearance
from hybrid_jax.planner.branch_selection import Routes
from hybrid_jax.planner.phase_scenes import phase_scene, segment_kinds
from hybrid_jax.planner.trajectory_check import ConfigurationChecker
from hybrid_jax.planner.turns import unlimited
from hybrid_jax.tasks.task import Task
from hybrid_jax.types import Status, Workcell

PROVEN = 1e-4
"""Smallest clearance of a configuration [m]: a motion through a closer one is never proven free."""
ROUNDING = 1e-3
"""A start beyond the limits by no more than this is put back to them, as encoders and messages
round [rad or m]."""


def _bad_numbers(cell: Workcell, task: Task) -> str | None:
    """What is wrong with the arrays of a task, or with its object."""
    names = cell.source.layout.object_names
    if task.object_name not in names:
        return f"unknown object {task.object_name!r}; there are: {', '.join(sorted(names))}"
    if any(task.carrying) and (fault := _bad_hold(cell, task)):
        return fault
    shape = (len(names), 7)
    if np.shape(task.object_poses) != shape:
        return f"object_poses must have shape {shape}, got {np.shape(task.object_poses)}"
    for name in ("object_poses", "key_poses"):
        rows = np.flatnonzero(~np.isfinite(getattr(task, name)).all(axis=1))
        if rows.size:
            return f"{name}: row {rows[0]} is not finite"
    return within_limits(cell, np.asarray(task.end), "end")[2] if task.end is not None else None


def _bad_hold(cell: Workcell, task: Task) -> str | None:
    """What is wrong with how a task's object is held."""
    if task.hold is None:
        return f"{task.object_name!r} is carried, but the task does not say how: give it a `hold`"
    owner = cell.source.layout.object_names.index(task.object_name)
    if cell.source.owners.count(owner) and not cell.scene.payload.count:
        return (
            f"{task.object_name!r} is carried, but nothing can be held in this cell: see its data"
        )
    in_tool = np.asarray(task.hold.in_tool, float)
    if in_tool.shape != (7,) or not np.isfinite(in_tool).all():
        return f"hold.in_tool must be 7 finite numbers, got {task.hold.in_tool!r}"
    fixtures = set(cell.source.fixture_bodies) - {""}
    unknown = set(task.hold.support) - fixtures
    if unknown:
        known = ", ".join(sorted(fixtures))
        return f"hold.support names {min(unknown)!r}; the fixtures are: {known}"
    return None


def within_limits(cell: Workcell, q: np.ndarray, name: str) -> tuple[np.ndarray, str, str]:
    """A configuration that is put back within the limits if rounding took it out of them.

    Args:
        cell: the robot, for its limits.
        q: `[joint]` [rad or m].
        name: what the sentences call the configuration.

    Returns:
        The configuration `[joint]`, a sentence about what was changed, and a sentence about what is
        wrong. The sentences are empty where there is nothing to say.
    """
    low, high = np.asarray(cell.joint_limits).T
    if q.shape != low.shape or not np.isfinite(q).all():
        return q, "", f"the {name} must be {low.size} finite joint values, got {q!r}"
    # a hinge without limits accepts any reading of its encoder
    excess = np.where(unlimited(cell), 0.0, np.maximum(low - q, q - high))
    worst = int(np.argmax(excess))
    if excess[worst] <= 0:
        return q, "", ""
    unit = cell.joint_units[worst]
    sentence = (
        f"the {name}: {cell.joint_names[worst]} is at {q[worst]:.6f} {unit}, {excess[worst]:.2g} "
        f"{unit} outside its limits {low[worst]:.4f} to {high[worst]:.4f}"
    )
    if excess[worst] > ROUNDING:
        return q, "", sentence
    put_back = np.where(unlimited(cell), q, np.clip(q, low, high))
    return put_back, f"({sentence}: put back to the limit)", ""


def kernels_touch(cell: Workcell, q: np.ndarray) -> str | None:
    """What the kernels find wrong with a configuration, in words; None if nothing.

    Args:
        cell: robot and scene.
        q: `[joint]` [rad or m].
    """
    return too_close(float(path_clearance(cell, np.asarray(q, float)[None])[0]))


def too_close(gap: float) -> str | None:
    """A sentence about a clearance of the kernels [m] that is too small; None if it is enough.

    It is for configurations in which C MuJoCo sees no contact. The kernels are stricter: their
    primitives contain the solids, and they see a capsule that runs right through a thin box.
    """
    if gap >= PROVEN:
        return None
    how = f"overlap by {-1e3 * gap:.1f} mm" if gap < 0 else f"leave {1e3 * gap:.2f} mm only"
    return f"C MuJoCo sees no contact, but the kernels' primitives {how}"


def admit(
    cell: Workcell, checker: ConfigurationChecker, task: Task
) -> tuple[Task, str, PlanResult | None]:
    """Check a task, and put its start back within the limits if rounding took it out of them.

    Args:
        cell: the cell of the task.
        checker: judges the start configuration.
        task: to be planned.

    Returns:
        The task as it can be planned, a sentence about what was changed (mostly empty), and a
        refusal if it cannot be planned.
    """
    start, note, fault = within_limits(cell, np.asarray(task.start), "start")
    if fault:
        return task, "", PlanResult(Status.START_INVALID, fault)
    wrong = _bad_numbers(cell, task)
    if wrong:
        return task, "", PlanResult(Status.INVALID_TASK, wrong)
    if note:
        task = replace(task, start=start.astype(np.float32))
    checker.enter(phase_scene(cell, task, int(segment_kinds(task)[0])))
    touched = checker.collision(start)
    if touched:
        detail = f"the arm collides where it stands: {touched}"
        return task, "", PlanResult(Status.START_INVALID, detail)
    return task, note, None


def why_infeasible(
    cell: Workcell, checker: ConfigurationChecker, task: Task, routes: Routes
) -> str:
    """Why no route leads through a task: the first key pose or the first segment that fails."""
    labels = routes.labels
    for k in range(len(labels.usable)):
        if not labels.usable[k].any():
            return _why_unreachable(cell, checker, task, k, labels)
    a = routes.blocked_segment()
    return f"key pose {a} to {a + 1}: no candidate of either begins a feasible joint path"


def _why_unreachable(
    cell: Workcell, checker: ConfigurationChecker, task: Task, k: int, labels
) -> str:
    """Why key pose `k` has no feasible configuration."""
    # the start is no result of inverse kinematics: `reached` begins at key pose 1
    if 0 < k <= len(labels.reached) and not labels.reached[k - 1]:
        return f"key pose {k} is out of reach"
    kinds = segment_kinds(task)
    for kind in {int(kinds[max(k - 1, 0)]), int(kinds[min(k, len(kinds) - 1)])}:
        checker.enter(phase_scene(cell, task, kind))
        contacts = [checker.collision(q) for q in labels.candidates[k]]
        if all(contacts):
            return f"key pose {k} collides in every configuration found: {contacts[0]}"
    return f"key pose {k} is too close to an obstacle or to a singularity in every configuration"
