# SPDX-License-Identifier: MIT
"""Joints that can turn more than once: tasks are planned near home, whatever the encoders read.

A whole turn of a hinge changes nothing but its reading. So a task that starts some turns away is
planned as one that starts near home, and its motions are shifted back by these turns: the arm
unwinds only where a limit asks for it. The end of a task is met in the reading nearest to its
start; the answer says where that is not the reading that the task names.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from hybrid_jax.contracts import PlanResult
from hybrid_jax.tasks.task import Task
from hybrid_jax.types import Trajectory, Workcell

TURN = 2 * np.pi
"""One turn [rad]."""


def unlimited(cell: Workcell) -> np.ndarray:
    """`[joint]` True for hinges without limits, which accept any reading of their encoder."""
    return np.array(cell.source.layout.unlimited)


def winding(cell: Workcell) -> np.ndarray:
    """`[joint]` True for hinges that can stand in one place with two readings."""
    hinge = np.array(cell.source.layout.joint_units) == "rad"
    return hinge & (np.ptp(np.asarray(cell.joint_limits, float), axis=1) >= TURN)


def turns_from(cell: Workcell, q: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Whole turns between two configurations.

    Args:
        cell: the robot.
        q: `[joint]` [rad or m].
        reference: `[joint]` configuration to count from.

    Returns:
        `[joint]` multiples of `TURN` [rad]; 0 for joints that `winding` does not name.
    """
    difference = np.asarray(q, float) - np.asarray(reference, float)
    return np.where(winding(cell), TURN * np.round(difference / TURN), 0.0)


def nearest_goal(cell: Workcell, start: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """A goal in the reading nearest to a start; only joints without limits are changed.

    Args:
        cell: the robot.
        start: `[joint]` [rad or m].
        goal: `[joint]` [rad or m].

    Returns:
        `[joint]` the goal [rad or m].
    """
    turns = np.where(unlimited(cell), turns_from(cell, goal, start), 0.0)
    return np.asarray(goal, float) - turns


def _moved(motion: Trajectory, turns: np.ndarray) -> Trajectory:
    return motion.replace(positions=np.asarray(motion.positions, float) + turns)


def rewound(cell: Workcell, result: PlanResult, turns: np.ndarray) -> PlanResult | None:
    """A plan shifted by whole turns.

    Args:
        cell: the robot, for its limits.
        result: a plan near home.
        turns: `[joint]` added to all positions [rad].

    Returns:
        The shifted plan; None where it would leave the limits.
    """
    if not turns.any():
        return result
    phases = [_moved(phase, turns) for phase in result.phases]
    low, high = np.asarray(cell.joint_limits, float).T
    endless = unlimited(cell)
    for phase in phases:
        if not (endless | ((phase.positions >= low) & (phase.positions <= high))).all():
            return None
    return replace(result, phases=phases)


def plan_in_turns(
    cell: Workcell,
    tasks: list[Task],
    plan: Callable[[list[Task]], list[PlanResult]],
) -> list[PlanResult]:
    """Plan tasks near home, and shift each result by the turns of the task's start.

    Args:
        cell: the cell of the tasks.
        tasks: to be planned.
        plan: plans tasks. As far as joints can turn, it gets them with starts within half a turn
            of home, and ends within half a turn of the starts.

    Returns:
        One result for each task.
    """
    turns = [_turns(cell, np.asarray(task.start, float)) for task in tasks]
    near_home = [_near(cell, task, shift) for task, shift in zip(tasks, turns, strict=True)]
    results = zip(plan(near_home), turns, strict=True)
    rewinds = [rewound(cell, result, shift) for result, shift in results]
    # a plan that leaves the limits in the task's own turns is made anew, from the start as it is
    unwinding = [task for task, result in zip(tasks, rewinds, strict=True) if result is None]
    replanned = iter(plan(unwinding) if unwinding else [])
    final = [next(replanned) if result is None else result for result in rewinds]
    return [_saying_turns(cell, task, result) for task, result in zip(tasks, final, strict=True)]


def _near(cell: Workcell, task: Task, shift: np.ndarray) -> Task:
    """A task with its start shifted back, and its end in the reading nearest to that start."""
    if shift.any():
        task = replace(task, start=(task.start - shift).astype(np.float32))
    if task.end is None or np.shape(task.end) != np.shape(task.start):
        return task
    low, high = np.asarray(cell.joint_limits, float).T
    end = task.end - turns_from(cell, task.end, task.start)
    # where the nearest reading is beyond the limits, the one that the task names stays
    end = np.where(unlimited(cell) | ((end >= low) & (end <= high)), end, task.end)
    return task if (end == task.end).all() else replace(task, end=end.astype(np.float32))


def _saying_turns(cell: Workcell, task: Task, result: PlanResult) -> PlanResult:
    """The plan, with a sentence where it ends in another reading than the task names."""
    if task.end is None or not result.phases:
        return result
    turns = np.round(turns_from(cell, result.phases[-1].positions[-1], task.end) / TURN).astype(int)
    sentences = [
        f"{name} ends {n:+d} turns from the end that the task names"
        for name, n in zip(cell.joint_names, turns, strict=True)
        if n
    ]
    return replace(result, detail="; ".join([result.detail, *sentences]))


def _turns(cell: Workcell, start: np.ndarray) -> np.ndarray:
    """Turns of a task's start from home; none for a start that the planner is to refuse."""
    zeros = np.zeros(len(cell.joint_names))
    if start.shape != zeros.shape or not np.isfinite(start).all():
        return zeros
    low, high = np.asarray(cell.joint_limits, float).T
    within = unlimited(cell) | ((start >= low) & (start <= high))
    return turns_from(cell, start, np.asarray(cell.home)) if within.all() else zeros
