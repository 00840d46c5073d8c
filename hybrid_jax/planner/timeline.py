# SPDX-License-Identifier: MIT
"""A plan's phases one after the other in time, and what the gripper does between them."""

from dataclasses import dataclass

from hybrid_jax.skills.task import Task
from hybrid_jax.types import Trajectory

GRIPPER_PAUSE = 0.8
"""Time between two phases in which the gripper moves [s]."""


@dataclass(frozen=True)
class Slot:
    """When one phase takes place."""

    begin: float
    """Of its motion [s]."""
    end: float
    """[s]."""
    command: str
    """What the gripper is told before the phase, where the arm rests then: open, close; "" for
    nothing."""


def timeline(task: Task, phases: list[Trajectory]) -> list[Slot]:
    """When each phase of a plan takes place. Where the gripper moves, the arm rests meanwhile.

    Args:
        task: that was planned.
        phases: of the plan.
    """
    slots, begin, grips = [], 0.0, any(task.carrying)
    for number, (phase, (low, _)) in enumerate(zip(phases, task.phases, strict=False)):
        command = ("close" if task.carrying[low] else "open") if grips else ""
        begin += GRIPPER_PAUSE if number and grips else 0.0
        end = begin + float(phase.times[-1])
        slots.append(Slot(begin, end, command))
        begin = end
    return slots
