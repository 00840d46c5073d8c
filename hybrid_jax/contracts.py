# SPDX-License-Identifier: MIT
"""What agents, planner and execution hand each other: they know these names, not one another.

An agent, an exact oracle, a sampling-based planner and a test's stub are all the same to the
planner, and a plan is the same to an engine whoever made it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import jax
import numpy as np
from jax import Array

from hybrid_jax.skills.costs import SegmentCosts
from hybrid_jax.skills.task_segmentation import SkillPlan
from hybrid_jax.tasks.task import Task
from hybrid_jax.types import Record, Scene, Source, Status, Trajectory, Workcell, pytree
from hybrid_jax.workcell.description import TaskData

STEPS = 200
"""Points of the grid of a combined motion (paper, table of the switching agent: steps)."""


@pytree
class Segments(Record):
    """Problems of the joint agent; the leading axis of every array runs over segments."""

    scene: Scene
    """`[segment, ...]` what stands where, and what is held."""
    start: Array
    """`[segment, joint]` configuration to start from [rad or m]."""
    goal: Array
    """`[segment, joint]` configuration to arrive at [rad or m]."""


def take(segments: Segments, index) -> Segments:
    """Segments by their numbers `index` `[n]`, a slice or a mask; one number drops the axis."""
    return jax.tree.map(lambda a: a[index], segments)


@pytree
class Combined(Record):
    """Both motions of one phase on the switching agent's grid."""

    q: Array
    """`[2, STEPS, joint]` [rad or m]: of the skill, and of the joint agent, which is the skill's
    where that has none."""
    manipulability: Array
    """`[2, STEPS]` man', from 0 to 1."""
    collision: Array
    """`[2, STEPS]` 1 where a motion is infeasible or the joint agent has none."""
    available: Array
    """`[STEPS]` 1 where the joint agent has a motion."""


SkillChooser = Callable[[SegmentCosts], SkillPlan]
"""From the costs of all segments and skills to the plan; empty if the task cannot be covered."""

Bridger = Callable[[Segments, Array], list[np.ndarray | None]]
"""From segments and a key to collision-free way points `[point, joint]` [rad or m] from start to
goal of each segment, or None where none was found."""

Explorer = Callable[[Segments, Array], np.ndarray]
"""From segments and a key to rollouts of the joint agent `[segment, rollout, point, joint]` [rad or
m], each from the segment's start on, wherever it leads; none of them is proven."""

Switcher = Callable[[Combined], np.ndarray]
"""From both motions of a phase to the choice at each point `[STEPS]`: 0 skill, 1 joint agent."""


Executor = Callable[[Scene, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""From a scene and motions `[motion, point, joint]` [rad or m] to the configurations that the arm
passes when it executes them, of the same shape, and `[motion, point]` True where it collides."""


@dataclass(frozen=True)
class PlanResult:
    """A plan, or the reason why there is none."""

    status: Status
    """How planning ended."""
    detail: str
    """A sentence for people: what failed and where."""
    phases: list[Trajectory] = field(default_factory=list)
    """One timed trajectory for each phase between gripper events; empty unless status is OK."""
    skills: list[str] = field(default_factory=list)
    """Skill of each segment."""

    @property
    def shares(self) -> dict[Source, float]:
        """Share of the trajectory's points from each source, from 0 to 1; 0 without any points."""
        sources = np.concatenate([t.sources for t in self.phases]) if self.phases else np.zeros(0)
        return {s: float(np.mean(sources == s)) if sources.size else 0.0 for s in Source}

    @property
    def drl_share(self) -> float:
        """Share of the trajectory's points that came from the joint agent, from 0 to 1."""
        return self.shares[Source.DRL]


Planning = Callable[[Sequence[Task]], list[PlanResult]]
"""From tasks to the plan of each, made together."""


class TaskKind(Protocol):
    """A kind of task: a module with these names, see `workcell.description.TASK_KINDS`.

    The planner knows none of them: it is given a `Task`.
    """

    EXECUTION: str
    """Module that carries such tasks out, an `ExecutionModule`."""
    STUDY: str
    """Module of the study that compares methods on such tasks, see `studies.registry.Study`."""

    def read(self, tables: dict, file: str) -> TaskData:
        """The task data from the tables of a cell's TOML file, without its `kind`.

        Args:
            tables: of the file; `controller` is a `ControllerSpec` already.
            file: name of the file, for messages.

        Raises:
            WorkcellError: a field is missing, unknown, of another type or out of its range.
        """
        ...

    def make_task(
        self,
        cell: Workcell,
        object_name: str,
        object_poses: np.ndarray,
        start: np.ndarray | None = None,
    ) -> Task:
        """The task of one object, from a configuration `[joint]` [rad or m]; home if None.

        Args:
            cell: with data of this kind.
            object_name: which object.
            object_poses: `[object, 7]` where all objects lie: position [m], quaternion.
            start: where the arm stands.
        """
        ...

    def random_task(self, cell: Workcell, seed: int) -> Task:
        """The task of one object of a random scene."""
        ...


@dataclass(frozen=True)
class Judgement:
    """What is measured in a cell at the end of an execution."""

    failure: str = ""
    """Why the task is not done, in few words; empty if it is."""
    measures: dict[str, float] = field(default_factory=dict)
    """Whatever tells good from bad, by a name that ends with its unit: `distance_mm`."""


@dataclass(frozen=True)
class Showcase:
    """A few tasks of a cell, planned and carried out in physics."""

    rows: list[dict]
    """One for each task: name, success, cause, detail, shares of the sources."""
    frames: np.ndarray
    """`[frame, nq]` MuJoCo's `qpos` after each tick."""
    touched: int
    """Number of contacts that were not allowed."""


class ExecutionModule(Protocol):
    """How tasks of one kind are carried out: a module with these names."""

    def judge(self, plant, task: Task) -> Judgement:
        """Is a task done whose plan was carried out, and how well?

        Args:
            plant: the simulated cell, an `execution.plant.Plant`.
            task: what was planned.
        """
        ...

    def show(self, cell: Workcell, plan: Planning, seed: int, count: int) -> Showcase:
        """Plan and carry out `count` tasks of random scenes, drawn from `seed`."""
        ...


class PhysicsEngine(Protocol):
    """Physics that rolls many simulated runs on; see `execution.engines`."""

    def roll(self, models, states, commands) -> tuple[np.ndarray, np.ndarray]:
        """Roll runs on by the steps of their commands.

        Args:
            models: the MuJoCo model of each run.
            states: `[run, state]` full physics states to begin with, in MuJoCo's units.
            commands: `[run, step, command]` controls and active equalities of every step.

        Returns:
            States after each step `[run, step, state]`, and which mover touches which thing then
            `[run, step, mover, thing]`.
        """
        ...
