# SPDX-License-Identifier: MIT
"""Tasks of any kind in physics, each once and in a scene of its own."""

import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from types import ModuleType

import numpy as np

from hybrid_jax.contracts import Judgement, Planning, PlanResult, Showcase
from hybrid_jax.errors import InputError
from hybrid_jax.execution.contact_sensors import SensedCell, sense_cell
from hybrid_jax.execution.engines import make_engine
from hybrid_jax.execution.plan_execution import Ending, Execution, ExecutionConfig
from hybrid_jax.execution.plant import BlownUp, PlanRequest, Plant, Steps, Touch, ticks
from hybrid_jax.execution.scheduler import drive
from hybrid_jax.kernels.argument_checks import single_precision
from hybrid_jax.tasks.registry import kind_of, random_task
from hybrid_jax.tasks.task import Task
from hybrid_jax.types import Source, Status, Workcell


@dataclass(frozen=True)
class ExecutionReport:
    """Outcome of one plan."""

    ending: Ending
    """How its execution ended."""
    judgement: Judgement
    """Whether the task is done, as its kind judges it."""
    touches: list[Touch]
    """Contacts that were not allowed."""
    object_poses: np.ndarray
    """`[object, 7]` where every object lies afterwards: position [m], quaternion."""
    slip: float
    """Largest distance of the held object from where it was gripped, in the tool's frame [m]."""
    frames: np.ndarray = field(repr=False)
    """`[frame, nq]` MuJoCo's `qpos` after each tick."""
    seconds: float
    """Simulated [s]."""

    @property
    def success(self) -> bool:
        """Carried out to its end, the task is done, and nothing else was touched."""
        return self.ending is Ending.DONE and not self.judgement.failure and not self.touches


@dataclass
class TaskReport:
    """Outcome of one task: planned and carried out once."""

    seed: int
    """The task is the random task of this seed."""
    name: str
    """Object of the task."""
    cause: str = "no plan"
    """Cause of failure; empty for a success."""
    detail: str = ""
    """A sentence about the cause."""
    measures: dict[str, float] = field(default_factory=dict)
    """What the task's kind measures at the end."""
    planning_s: float = 0.0
    cycle_s: float = 0.0
    """Simulated [s]."""
    shares: dict[str, float] = field(default_factory=dict)
    """Share of the plan's points from each source."""
    touches: list[Touch] = field(default_factory=list)
    """Contacts that were not allowed."""
    frames: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)), repr=False)
    """`[frame, nq]` MuJoCo's `qpos` after each tick."""


def execution_of(cell: Workcell) -> ModuleType:
    """Module that carries out tasks of the cell's kind, a `contracts.ExecutionModule`.

    Raises:
        WorkcellError: the cell has no task data.
    """
    return importlib.import_module(kind_of(cell).EXECUTION)


def _plant_of(sensed: SensedCell, task: Task, config: ExecutionConfig) -> Plant:
    """The cell in a task's scene, the arm where the task begins."""
    start = np.asarray(task.start, float)
    return Plant(sensed, task.object_poses, ticks(sensed, config.tick), start=start)


@single_precision
def execute(
    cell: Workcell,
    task: Task,
    plan: PlanResult,
    config: ExecutionConfig = ExecutionConfig(),
    engine: str = "auto",
) -> ExecutionReport:
    """Carry out one plan in the scene of its task.

    Args:
        cell: that the plan was made in, with task data.
        task: that was planned.
        plan: with status OK.
        config: times and thresholds.
        engine: mujoco (in C, on all cores), mjx, or auto; see `engines.make_engine`.

    Returns:
        What happened: outcome, contacts, frames `[frame, nq]`, time [s].

    Raises:
        InputError: the plan holds no trajectory, or starts elsewhere than the task.
        BlownUp: the simulation became unstable.
    """
    if not plan.phases:
        raise InputError("nothing to execute: the plan holds no trajectory")
    sensed = sense_cell(cell)
    plant = _plant_of(sensed, task, config)
    execution = Execution(plant, task, plan.phases, config)
    ending = drive([execution.run()], make_engine(sensed, engine))[0]
    return ExecutionReport(
        ending,
        execution_of(cell).judge(plant, task),
        plant.touches,
        plant.objects(),
        execution.slip,
        np.stack(plant.frames),
        plant.time,
    )


def _attempt(plant: Plant, task: Task, seed: int, config: ExecutionConfig) -> Steps:
    """Plan a task, carry the plan out, and judge what came of it; returns a `TaskReport`."""
    report = TaskReport(seed, task.object_name)
    answer = yield PlanRequest(task)
    result, report.planning_s = answer.result, answer.seconds
    if result.status is not Status.OK:
        report.detail = f"{result.status.name}: {result.detail}"
        return report
    report.shares = {source.name: round(result.shares[source], 3) for source in Source}
    try:
        ending = yield from Execution(plant, task, result.phases, config).run()
        judgement = execution_of(plant.sensed.cell).judge(plant, task)
        report.measures = judgement.measures
        report.cause = "" if ending is Ending.DONE else ending.value
        report.cause = report.cause or judgement.failure
    except BlownUp as error:
        report.cause, report.detail = "numerical", str(error)
    report.touches, report.cycle_s = plant.touches, plant.time
    if report.touches and not report.cause:
        report.cause, report.detail = "collision", "; ".join(map(str, report.touches))
    report.frames = np.stack(plant.frames)
    return report


@single_precision
def carry_out_tasks(
    cell: Workcell,
    plan: Planning,
    seeds: Sequence[int],
    config: ExecutionConfig = ExecutionConfig(),
    engine: str = "auto",
    progress: Callable[[int, float], None] = lambda ended, seconds: None,
) -> list[TaskReport]:
    """Plan random tasks of the cell's kind and carry them out, all side by side.

    Args:
        cell: with task data.
        plan: makes the plans.
        seeds: of the tasks.
        config: times and thresholds.
        engine: mujoco (in C, on all cores), mjx, or auto; see `engines.make_engine`.
        progress: is called with the number of ended runs and the simulated time of all runs [s].

    Returns:
        One report a task, with frames `[frame, nq]`.

    Raises:
        WorkcellError: the cell has no task data, or its objects find no room in a scene.
    """
    if not seeds:
        raise InputError("no tasks to carry out: give at least one seed")
    sensed = sense_cell(cell)
    tasks = [random_task(cell, seed) for seed in seeds]
    runs = [
        _attempt(_plant_of(sensed, task, config), task, seed, config)
        for task, seed in zip(tasks, seeds, strict=True)
    ]
    return drive(runs, make_engine(sensed, engine), plan, progress)


def show(cell: Workcell, plan: Planning, seed: int, count: int) -> Showcase:
    """Plan and carry out `count` random tasks, see `contracts.ExecutionModule`."""
    reports = carry_out_tasks(cell, plan, range(seed, seed + count))
    rows = [
        {
            "name": report.name,
            "success": not report.cause,
            "cause": report.cause,
            "detail": report.detail,
            "shares": report.shares,
            "planning_s": report.planning_s,
            "cycle_s": report.cycle_s,
        }
        for report in reports
    ]
    shown = [report.frames for report in reports if report.frames.size]
    frames = np.concatenate(shown) if shown else np.zeros((0, cell.model.nq))
    return Showcase(rows, frames, sum(len(report.touches) for report in reports))
