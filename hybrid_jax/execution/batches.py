# SPDX-License-Identifier: MIT
"""Whole runs in physics: one plan, one scene, or many scenes at once."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import jax
import numpy as np

from hybrid_jax.contracts import Planning, PlanResult
from hybrid_jax.execution.contact_sensors import sense_cell
from hybrid_jax.execution.disturbances import CALM, Disturbance, disturbed_model
from hybrid_jax.execution.engines import make_engine
from hybrid_jax.execution.handling import ObjectReport, Sorting, in_tray
from hybrid_jax.execution.plan_execution import Ending, Execution, ExecutionConfig
from hybrid_jax.execution.plant import Plant, Touch, ticks
from hybrid_jax.execution.scheduler import drive
from hybrid_jax.kernels.argument_checks import single_precision
from hybrid_jax.runtime.keys import fold_in
from hybrid_jax.tasks.scene_sampling import sample_scene
from hybrid_jax.tasks.task import Task
from hybrid_jax.types import Workcell


@dataclass(frozen=True)
class SortingReport:
    """Outcome of one run over a whole scene."""

    seed: int
    """Seed of the scene."""
    reports: list[ObjectReport]
    """One for each object."""
    touches: list[Touch]
    """Contacts that were not allowed."""
    frames: np.ndarray
    """`[frame, nq]` MuJoCo's `qpos` after each tick of the execution."""
    seconds: float
    """Simulated [s]."""

    @property
    def success(self) -> bool:
        """Every object lies in its tray, and nothing else was touched."""
        return all(report.success for report in self.reports) and not self.touches


@dataclass(frozen=True)
class ExecutionReport:
    """Outcome of one plan."""

    ending: Ending
    """How its execution ended."""
    placed: bool
    """The object lies in its tray, at rest."""
    touches: list[Touch]
    """Contacts that were not allowed."""
    object_poses: np.ndarray
    """`[object, 7]` where every object lies afterwards: position [m], quaternion."""
    slip: float
    """Largest distance of the held object from where it was gripped, in the tool's frame [m]."""
    frames: np.ndarray
    """`[frame, nq]` MuJoCo's `qpos` after each tick."""
    seconds: float
    """Simulated [s]."""

    @property
    def success(self) -> bool:
        """Placed, and nothing else touched."""
        return self.placed and not self.touches


def planning(plan: Callable[..., list[PlanResult]], seed: int) -> Planning:
    """A planner in the form that the scheduler calls; every batch gets its own random key.

    Args:
        plan: maps tasks, and a random key given as `key=`, to plans.
        seed: of the keys.

    Returns:
        A function from tasks to plans.
    """
    key, numbers = jax.random.key(seed), itertools.count()
    return lambda tasks: plan(tasks, key=fold_in(key, next(numbers)))


@single_precision
def sort_scenes(
    cell: Workcell,
    plan: Planning,
    seeds: Sequence[int],
    names: Sequence[str] | None = None,
    disturbance: Disturbance = CALM,
    config: ExecutionConfig = ExecutionConfig(),
    engine: str = "auto",
    progress: Callable[[int, float], None] = lambda ended, seconds: None,
) -> list[SortingReport]:
    """Sort the objects of random scenes, all scenes side by side.

    Args:
        cell: with task data.
        plan: makes the plans.
        seeds: of the scenes.
        names: objects to sort, in the order in which they are tried; all if None.
        disturbance: what differs from what the planner is told.
        config: times and thresholds.
        engine: host (C MuJoCo), device (MJX) or auto.
        progress: is called with the number of ended runs and the simulated time of all runs [s].

    Returns:
        One report a scene: what became of each object, contacts, frames `[frame, nq]`, time [s].

    Raises:
        WorkcellError: the cell has no handling data, or its objects find no room in a scene.
    """
    sensed = sense_cell(cell)
    model, names = disturbed_model(sensed.model, cell, disturbance), list(names or _names(cell))
    tick = ticks(sensed, config.tick)
    # all runs share one model: MJX rolls runs of one model only
    plants = [Plant(sensed, sample_scene(cell, seed), tick, model) for seed in seeds]
    runs = [
        Sorting(plant, names, seed, disturbance, config).run()
        for plant, seed in zip(plants, seeds, strict=True)
    ]
    outcomes = drive(runs, make_engine(sensed, engine), plan, progress)
    return [
        SortingReport(seed, reports, plant.touches, np.stack(plant.frames), plant.time)
        for seed, reports, plant in zip(seeds, outcomes, plants, strict=True)
    ]


def _names(cell: Workcell) -> list[str]:
    return [spec.name for spec in cell.source.task.objects]


def sort_scene(
    cell: Workcell, plan: Planning, seed: int, names: Sequence[str] | None = None
) -> SortingReport:
    """Sort the objects of one random scene; see `sort_scenes`."""
    return sort_scenes(cell, plan, [seed], names)[0]


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
        cell: that the plan was made in.
        task: that was planned.
        plan: with status OK.
        config: times and thresholds.
        engine: host (C MuJoCo), device (MJX) or auto.

    Returns:
        What happened: outcome, contacts, frames `[frame, nq]`, time [s].

    Raises:
        ValueError: the plan holds no trajectory, or starts elsewhere than at home.
        BlownUp: the simulation became unstable.
    """
    sensed = sense_cell(cell)
    plant = Plant(sensed, task.object_poses, ticks(sensed, config.tick))
    execution = Execution(plant, task, plan.phases, config)
    ending = drive([execution.run()], make_engine(sensed, engine))[0]
    return ExecutionReport(
        ending,
        in_tray(plant, task.object_name),
        plant.touches,
        plant.objects(),
        execution.slip,
        np.stack(plant.frames),
        plant.time,
    )
