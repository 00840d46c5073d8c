# SPDX-License-Identifier: MIT
"""Handling in physics: sort the objects of many scenes at once, and judge what was handled."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field

import numpy as np

from hybrid_jax.contracts import Judgement, Planning, Showcase
from hybrid_jax.execution.contact_sensors import sense_cell
from hybrid_jax.execution.disturbances import CALM, Disturbance, disturbed_model
from hybrid_jax.execution.engines import make_engine
from hybrid_jax.execution.plan_execution import ExecutionConfig
from hybrid_jax.execution.plant import Plant, Touch, ticks
from hybrid_jax.execution.scheduler import drive
from hybrid_jax.execution.sorting import ObjectReport, Sorting, in_tray
from hybrid_jax.kernels.argument_checks import single_precision
from hybrid_jax.tasks.handling import require_handling
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
    frames: np.ndarray = field(repr=False)
    """`[frame, nq]` MuJoCo's `qpos` after each tick of the execution."""
    seconds: float
    """Simulated [s]."""

    @property
    def success(self) -> bool:
        """Every object lies in its tray, and nothing else was touched."""
        return all(report.success for report in self.reports) and not self.touches


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
        engine: mujoco (in C, on all cores), mjx, or auto; see `engines.make_engine`.
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
    return [spec.name for spec in require_handling(cell).objects]


def sort_scene(
    cell: Workcell, plan: Planning, seed: int, names: Sequence[str] | None = None
) -> SortingReport:
    """Sort the objects of one random scene; see `sort_scenes`."""
    return sort_scenes(cell, plan, [seed], names)[0]


def judge(plant: Plant, task: Task) -> Judgement:
    """Does the task's object lie in its tray, at rest? See `contracts.ExecutionModule`."""
    placed = in_tray(plant, task.object_name)
    return Judgement("" if placed else "wrong place")


def show(cell: Workcell, plan: Planning, seed: int, count: int) -> Showcase:
    """Sort the last `count` objects of one scene, one after the other."""
    names = list(cell.source.layout.object_names)[-count:]
    report = sort_scene(cell, plan, seed, names)
    return Showcase([asdict(entry) for entry in report.reports], report.frames, len(report.touches))
