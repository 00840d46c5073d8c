# SPDX-License-Identifier: MIT
"""The phases of a plan in time, and the commands to the gripper between them."""

from dataclasses import dataclass

from hybrid_jax.tasks.task import Task
from hybrid_jax.types import Trajectory

GRIPPER_PAUSE = 0.8
"""Pause between two phases, in which the gripper moves [s]."""


@dataclass(frozen=True)
class Slot:
    """The time in which one phase takes place."""

    begin: float
    """Begin of the motion [s]."""
    end: float
    """End of the motion [s]."""
    command: str
    """Command to the gripper before the phase, while the arm rests: open or close; "" for none."""


def timeline(task: Task, phases: list[Trajectory]) -> list[Slot]:
    """The times of a plan's phases; while the gripper moves, the arm rests.

    Args:
        task: the task that was planned.
        phases: trajectories of the plan, `times` `[point]` [s] each from zero.

    Returns:
        One slot for each phase.
    """
    slots, begin, grips = [], 0.0, any(task.carrying)
    for number, (phase, (low, _)) in enumerate(zip(phases, task.phases, strict=False)):
        command = ("close" if task.carrying[low] else "open") if grips else ""
        begin += GRIPPER_PAUSE if number and grips else 0.0
        end = begin + float(phase.times[-1])
        slots.append(Slot(begin, end, command))
        begin = end
    return slots
