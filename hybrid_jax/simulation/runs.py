# SPDX-License-Identifier: MIT
"""Whole runs in physics: one plan, one scene, or many scenes at once."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import jax
import numpy as np

from hybrid_jax.kernels.inputs import single_precision
from hybrid_jax.keys import fold_in
from hybrid_jax.planner.records import Planner, PlanResult
from hybrid_jax.simulation.disturbances import CALM, Disturbance, disturbed_model
from hybrid_jax.simulation.driving import Planning, drive
from hybrid_jax.simulation.engines import make_engine
from hybrid_jax.simulation.execution import Ending, Execution, ExecutionConfig
from hybrid_jax.simulation.plant import Plant, Touch, ticks
from hybrid_jax.simulation.sensing import sense_cell
from hybrid_jax.simulation.sorting import ObjectReport, Sorting, in_tray
from hybrid_jax.skills.scenes import sample_scene
from hybrid_jax.skills.task import Task
from hybrid_jax.types import Workcell


@dataclass(frozen=True)
class SortingReport:
    """What became of a run."""

    seed: int
    """Of the scene."""
    reports: list[ObjectReport]
    """Of each object."""
    touches: list[Touch]
    """Contacts that should not have been."""
    frames: np.ndarray
    """`[frame, nq]` one for each tick of the execution."""
    seconds: float
    """Simulated [s]."""

    @property
    def success(self) -> bool:
        """Every object lies in its tray, and nothing else was touched."""
        return all(report.success for report in self.reports) and not self.touches


@dataclass(frozen=True)
class ExecutionReport:
    """What became of one plan."""

    ending: Ending
    """How its execution ended."""
    placed: bool
    """The object lies in its tray, at rest."""
    touches: list[Touch]
    """Contacts that should not have been."""
    object_poses: np.ndarray
    """`[object, 7]` where every object lies afterwards."""
    slip: float
    """Largest way of the held object in the tool [m]."""
    frames: np.ndarray
    """`[frame, nq]` one for each tick."""
    seconds: float
    """Simulated [s]."""

    @property
    def success(self) -> bool:
        """Placed, and nothing else touched."""
        return self.placed and not self.touches


def planning(planner: Planner, plan_batch: Callable[..., list[PlanResult]], seed: int) -> Planning:
    """A planner as those who drive runs ask it: every batch gets a random key of its own."""
    key, numbers = jax.random.key(seed), itertools.count()
    return lambda tasks: plan_batch(planner, tasks, key=fold_in(key, next(numbers)))


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
        progress: is told how many runs have ended, and the simulated time of all [s].

    Returns:
        One report a scene: what became of each object, contacts, frames `[frame, nq]`, time [s].

    Raises:
        WorkcellError: the cell has no handling data, or its objects find no room in a scene.
    """
    sensed = sense_cell(cell)
    model, names = disturbed_model(sensed.model, cell, disturbance), list(names or _names(cell))
    tick = ticks(sensed, config.tick)
    plants = [Plant(sensed, sample_scene(cell, seed), tick, model) for seed in seeds]
    runs = [
        Sorting(plant, names, seed, disturbance, config).run()
        for plant, seed in zip(plants, seeds, strict=True)
    ]
    found = drive(runs, make_engine(sensed, engine), plan, progress)
    return [
        SortingReport(seed, reports, plant.touches, np.stack(plant.frames), plant.time)
        for seed, reports, plant in zip(seeds, found, plants, strict=True)
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
        BlownUp: the simulation left the numbers that mean something.
    """
    sensed = sense_cell(cell)
    plant = Plant(sensed, task.object_poses, ticks(sensed, config.tick))
    execution = Execution(plant, task, plan.phases, config)
    ending = drive([execution.run()], make_engine(sensed, engine))[0]
    return ExecutionReport(
        ending, in_tray(plant, task.object_name), plant.touches, plant.objects(),
        execution.slip, np.stack(plant.frames), plant.time,
    )  # fmt: skip
