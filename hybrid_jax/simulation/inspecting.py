# SPDX-License-Identifier: MIT
"""Brush a part: plan, carry out, and measure where the brush was (paper's second study)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np

from hybrid_jax.planner.checking import pose_row
from hybrid_jax.simulation.disturbances import CALM, Disturbance, disturbed_model, measured
from hybrid_jax.simulation.driving import Planning, drive
from hybrid_jax.simulation.engines import make_engine
from hybrid_jax.simulation.execution import ExecutionConfig, targets
from hybrid_jax.simulation.plant import BlownUp, Plan, Plant, Steps, Touch, ticks
from hybrid_jax.simulation.sensing import SensedCell, sense_cell
from hybrid_jax.skills.inspection import (
    brush_errors,
    inspection_task,
    random_start,
    require_inspection,
)
from hybrid_jax.skills.scenes import sample_scene
from hybrid_jax.types import Source, Status, Trajectory, Workcell
from hybrid_jax.workcell.geometry import pose_of

TOGETHER = 100
"""Trials that are simulated side by side."""
EXACT = 0.001, np.radians(0.5)
"""The strictest tolerance of a key pose that is asked for [m], [rad]."""
MEASURED = 5
"""Physics steps from one measurement of the brush to the next."""


@dataclass(frozen=True)
class Trial:
    """One part to be brushed, in one scene."""

    part: str
    seed: int
    """Of the scene and of the start."""


@dataclass
class InspectionReport:
    """What became of one trial."""

    trial: Trial
    cause: str = "no plan"
    """Why it failed; empty if it was carried out."""
    detail: str = ""
    """The sentence to it."""
    away: list[float] = field(default_factory=list)
    """How far the tool was from each key pose at which the arm came to rest [m]."""
    turned: list[float] = field(default_factory=list)
    """Largest Euler angle between the two [rad]."""
    brush_angles: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """`[point]` between brush and normal along the stroke [rad]."""
    stand_offs: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """`[point]` of its tips from the face [m]."""
    touches: list[Touch] = field(default_factory=list)
    """Contacts of the arm."""
    frames: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    """`[frame, nq]` one for each tick."""
    seconds: float = 0.0
    """Simulated [s]."""
    planning_s: float = 0.0
    shares: dict[str, float] = field(default_factory=dict)
    """Share of the plan's points from each source."""

    def succeeded(self, position: float, rotation: float) -> bool:
        """Was every key pose met within these tolerances [m], [rad], without a contact?"""
        carried_out = not self.cause and not self.touches
        return carried_out and bool(max(self.away) <= position and max(self.turned) <= rotation)


class Inspecting:
    """One trial in one plant."""

    def __init__(
        self,
        plant: Plant,
        trial: Trial,
        disturbance: Disturbance = CALM,
        config: ExecutionConfig = ExecutionConfig(),
    ):
        """Args:
        plant: the cell, with the arm where the trial begins.
        trial: what is brushed.
        disturbance: what differs from what the planner is told.
        config: times.
        """
        self.plant, self.trial, self.disturbance, self.config = plant, trial, disturbance, config
        self.report = InspectionReport(trial)

    def run(self) -> Steps:
        """Plan and carry out; returns the report."""
        report, plant = self.report, self.plant
        try:
            yield from self._brush()
        except BlownUp as error:
            report.cause, report.detail = "numerical", str(error)
        report.touches, report.seconds = plant.touches, plant.time
        report.frames = np.stack(plant.frames)
        if report.touches and not report.cause:
            report.cause, report.detail = "collision", "; ".join(map(str, report.touches))
        return report

    def _brush(self) -> Steps:
        plant, report, cell = self.plant, self.report, self.plant.sensed.cell
        rng = np.random.default_rng(self.trial.seed)
        seen = measured(plant.objects(), self.disturbance, rng)
        task = inspection_task(cell, self.trial.part, seen, plant.target)
        answer = yield Plan(task)
        report.planning_s = answer.seconds
        result = answer.result
        if result.status is not Status.OK:
            report.detail = f"{result.status.name}: {result.detail}"
            return
        report.shares = {s.name: round(result.shares[s], 3) for s in Source}
        for (_, high), trajectory in zip(task.phases, result.phases, strict=True):
            # the parts may lie elsewhere than was seen, or have been moved
            truth = inspection_task(cell, self.trial.part, plant.objects(), task.start)
            tools = yield from self._follow(trajectory)
            self._compare(truth.key_poses[high], tools[-1])
            if high == len(task.carrying):  # the rest at its end is no part of the stroke
                self._judge_stroke(tools[: int(trajectory.times[-1] / (MEASURED * plant.dt))])
        report.cause = ""

    def _follow(self, trajectory: Trajectory) -> Steps:
        """Along a trajectory, then at rest; returns the tool's poses `[point, 7]` on the way."""
        plant, tools = self.plant, []
        part = plant.layout.object_names.index(self.trial.part)
        times = np.arange(plant.dt, trajectory.times[-1] + self.config.dwell, plant.dt)
        for chunk in plant.chunks(*targets(trajectory, times), 0.0):
            yield from plant.step(chunk, plant.resting(part))
            tools += plant.tools(MEASURED)
        return np.array(tools)

    def _compare(self, wanted: np.ndarray, tool: np.ndarray) -> None:
        """Note how far the tool `[7]` is from a key pose `[8]`."""
        row = pose_row(wanted)
        apart = pose_of(row[:3], row[3:]).inv() * pose_of(tool[:3], tool[3:])
        self.report.away.append(float(np.linalg.norm(apart.translation)))
        self.report.turned.append(float(np.abs(apart.rotation.as_euler("xyz")).max()))

    def _judge_stroke(self, tools: np.ndarray) -> None:
        plant, data = self.plant, require_inspection(self.plant.sensed.cell)
        index = plant.layout.object_names.index(self.trial.part)
        face = data.face(data.part(self.trial.part).face)
        found = brush_errors(face, plant.objects()[index], tools)
        self.report.brush_angles, self.report.stand_offs = found


def inspect_parts(
    cell: Workcell,
    plan: Planning,
    trials: Sequence[Trial],
    disturbance: Disturbance = CALM,
    config: ExecutionConfig = ExecutionConfig(),
    engine: str = "auto",
    progress: Callable[[int, float], None] = lambda ended, seconds: None,
) -> list[InspectionReport]:
    """Carry out trials, `TOGETHER` of them side by side.

    Args:
        cell: with inspection data.
        plan: makes the plans.
        trials: parts and seeds.
        disturbance: what differs from what the planner is told.
        config: times.
        engine: host (C MuJoCo), device (MJX) or auto.
        progress: is told how many trials have ended, and the simulated time of all.
    """
    sensed, found, simulated = sense_cell(cell), [], 0.0
    rolling, model = make_engine(sensed, engine), disturbed_model(sensed.model, cell, disturbance)
    for first in range(0, len(trials), TOGETHER):
        some = trials[first : first + TOGETHER]
        runs = [
            Inspecting(plant_of(sensed, trial, config, model), trial, disturbance, config).run()
            for trial in some
        ]
        found += drive(runs, rolling, plan)
        simulated += sum(report.seconds for report in found[first:])
        progress(len(found), simulated)
    return found


def plant_of(
    sensed: SensedCell, trial: Trial, config: ExecutionConfig, model: mujoco.MjModel
) -> Plant:
    """The cell in a trial's scene, the arm where it starts."""
    start = random_start(sensed.cell, np.random.default_rng([trial.seed, 2]))
    scene = sample_scene(sensed.cell, trial.seed)
    return Plant(sensed, scene, ticks(sensed, config.tick), model, start)
