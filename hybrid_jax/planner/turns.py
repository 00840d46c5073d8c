# SPDX-License-Identifier: MIT
"""Joints that can turn more than once: plan near home, give the motion back in the arm's own turns.

A whole turn of a hinge changes nothing but its reading. So a task that starts some turns away is
planned as one that starts near home, and its motions are moved by the turns again: the arm unwinds
only where a limit asks for it. Its end is met in the reading nearest to the start; the answer says
where that is not the one that was named.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from hybrid_jax.planner.records import PlanResult
from hybrid_jax.skills.task import Task
from hybrid_jax.types import Trajectory, Workcell

TURN = 2 * np.pi
"""One turn [rad]."""


def unlimited(cell: Workcell) -> np.ndarray:
    """`[joint]` True for hinges without limits: any reading of their encoder is as good."""
    return np.array(cell.source.layout.unlimited)


def winding(cell: Workcell) -> np.ndarray:
    """`[joint]` True for hinges that can stand in one place with two readings."""
    hinge = np.array(cell.source.layout.joint_units) == "rad"
    return hinge & (np.ptp(np.asarray(cell.joint_limits, float), axis=1) >= TURN)


def turns_from(cell: Workcell, q: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """`[joint]` whole turns between two configurations [rad]; 0 where a joint has none."""
    away = np.asarray(q, float) - np.asarray(reference, float)
    return np.where(winding(cell), TURN * np.round(away / TURN), 0.0)


def nearest_goal(cell: Workcell, start: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """The reading of a goal that is nearest to a start, in joints without limits."""
    turns = np.where(unlimited(cell), turns_from(cell, goal, start), 0.0)
    return np.asarray(goal, float) - turns


def _moved(motion: Trajectory, turns: np.ndarray) -> Trajectory:
    return motion.replace(positions=np.asarray(motion.positions, float) + turns)


def rewound(cell: Workcell, result: PlanResult, turns: np.ndarray) -> PlanResult | None:
    """A plan in other turns; None where it would leave the limits there."""
    if not turns.any():
        return result
    phases = [_moved(phase, turns) for phase in result.phases]
    low, high = np.asarray(cell.joint_limits, float).T
    free = unlimited(cell)
    for phase in phases:
        if not (free | ((phase.positions >= low) & (phase.positions <= high))).all():
            return None
    return replace(result, phases=phases)


def plan_in_turns(
    cell: Workcell,
    tasks: list[Task],
    plan: Callable[[list[Task]], list[PlanResult]],
) -> list[PlanResult]:
    """Plan tasks near home, each result in the turns of its start.

    Args:
        cell: of the tasks.
        tasks: to be planned.
        plan: plans them; where a joint can turn so, their starts are within half a turn of home,
            and their ends of the starts.
    """
    turns = [_turns(cell, np.asarray(task.start, float)) for task in tasks]
    near = [_near(cell, task, shift) for task, shift in zip(tasks, turns, strict=True)]
    results = zip(plan(near), turns, strict=True)
    found = [rewound(cell, result, shift) for result, shift in results]
    unwinding = [i for i, result in enumerate(found) if result is None]
    if unwinding:
        for i, result in zip(unwinding, plan([tasks[i] for i in unwinding]), strict=True):
            found[i] = result
    return [_saying_turns(cell, task, result) for task, result in zip(tasks, found, strict=True)]


def _near(cell: Workcell, task: Task, shift: np.ndarray) -> Task:
    """A task with its start so many turns back, and its end in the reading nearest to that."""
    if shift.any():
        task = replace(task, start=(task.start - shift).astype(np.float32))
    if task.end is None or np.shape(task.end) != np.shape(task.start):
        return task
    low, high = np.asarray(cell.joint_limits, float).T
    end = task.end - turns_from(cell, task.end, task.start)
    end = np.where(unlimited(cell) | ((end >= low) & (end <= high)), end, task.end)
    return task if (end == task.end).all() else replace(task, end=end.astype(np.float32))


def _saying_turns(cell: Workcell, task: Task, result: PlanResult) -> PlanResult:
    """The plan, with a sentence where it ends in another reading than the task names."""
    if task.end is None or not result.phases:
        return result
    turns = np.round(turns_from(cell, result.phases[-1].positions[-1], task.end) / TURN).astype(int)
    said = [f"{name} ends {n:+d} turns from the end that the task names"
            for name, n in zip(cell.joint_names, turns, strict=True) if n]  # fmt: skip
    return replace(result, detail="; ".join([result.detail, *said]))


def _turns(cell: Workcell, start: np.ndarray) -> np.ndarray:
    """Turns of a task's start from home; none for a start that the planner is to refuse."""
    none = np.zeros(len(cell.joint_names))
    if start.shape != none.shape or not np.isfinite(start).all():
        return none
    low, high = np.asarray(cell.joint_limits, float).T
    inside = unlimited(cell) | ((start >= low) & (start <= high))
    return turns_from(cell, start, np.asarray(cell.home)) if inside.all() else none
