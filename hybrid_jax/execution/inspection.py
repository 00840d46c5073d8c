# SPDX-License-Identifier: MIT
"""Brush a part: plan, carry out, and measure where the brush was (paper's second study)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np

from hybrid_jax.contracts import Judgement, Planning, Showcase
from hybrid_jax.execution.contact_sensors import SensedCell, sense_cell
from hybrid_jax.execution.disturbances import CALM, Disturbance, disturbed_model, measured
from hybrid_jax.execution.engines import make_engine
from hybrid_jax.execution.plan_execution import ExecutionConfig, targets
from hybrid_jax.execution.plant import BlownUp, PlanRequest, Plant, Steps, Touch, ticks
from hybrid_jax.execution.scheduler import drive
from hybrid_jax.tasks.inspection import (
    brush_errors,
    make_task,
    random_start,
    require_inspection,
)
from hybrid_jax.tasks.scene_sampling import sample_scene
from hybrid_jax.tasks.task import Task
from hybrid_jax.types import Source, Status, Trajectory, Workcell
from hybrid_jax.workcell.poses import pose_of, pose_row

TRIALS_PER_BATCH = 100
"""Trials that are simulated side by side."""
EXACT = 0.001, np.radians(0.5)
"""Strictest tolerance of a key pose in the study [m], [rad]."""
MEASURED = 5
"""Physics steps from one measurement of the brush to the next."""


@dataclass(frozen=True)
class Trial:
    """One part to be brushed, in one scene."""

    part: str
    seed: int
    """Seed of the scene and of the start configuration."""


@dataclass
class InspectionReport:
    """Outcome of one trial."""

    trial: Trial
    cause: str = "no plan"
    """Why it failed; empty if it was carried out."""
    detail: str = ""
    """A sentence about the cause."""
    away: list[float] = field(default_factory=list)
    """Distance of the tool from each key pose at which the arm came to rest [m]."""
    turned: list[float] = field(default_factory=list)
    """Largest Euler angle between the tool and each of these key poses [rad]."""
    brush_angles: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """`[point]` angle between the brush and the face's normal along the stroke [rad]."""
    stand_offs: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """`[point]` distance of the brush's tips from the face along the stroke [m]."""
    touches: list[Touch] = field(default_factory=list)
    """Contacts that were not allowed."""
    frames: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    """`[frame, nq]` MuJoCo's `qpos` after each tick."""
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
        """Prepare a trial.

        Args:
            plant: the cell, with the arm where the trial begins.
            trial: part and seed.
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
        poses = measured(plant.objects(), self.disturbance, rng)
        task = make_task(cell, self.trial.part, poses, plant.target)
        answer = yield PlanRequest(task)
        report.planning_s = answer.seconds
        result = answer.result
        if result.status is not Status.OK:
            report.detail = f"{result.status.name}: {result.detail}"
            return
        report.shares = {s.name: round(result.shares[s], 3) for s in Source}
        for (_, high), trajectory in zip(task.phases, result.phases, strict=True):
            # judged by the true poses: the planner saw measured ones, and parts may have moved
            truth = make_task(cell, self.trial.part, plant.objects(), task.start)
            tool_poses = yield from self._follow(trajectory)
            self._compare(truth.key_poses[high], tool_poses[-1])
            if high == len(task.carrying):  # without the dwell at its end
                self._judge_stroke(tool_poses[: int(trajectory.times[-1] / (MEASURED * plant.dt))])
        report.cause = ""

    def _follow(self, trajectory: Trajectory) -> Steps:
        """Follow a trajectory, then rest; returns the tool's poses `[point, 7]` on the way."""
        plant, tool_poses = self.plant, []
        part = plant.layout.object_names.index(self.trial.part)
        times = np.arange(plant.dt, trajectory.times[-1] + self.config.dwell, plant.dt)
        for chunk in plant.chunks(*targets(trajectory, times), 0.0):
            yield from plant.step(chunk, plant.resting(part))
            tool_poses += plant.tools(MEASURED)
        return np.array(tool_poses)

    def _compare(self, key_pose: np.ndarray, tool: np.ndarray) -> None:
        """Note the error of a tool pose `[7]` against a key pose `[8]`."""
        distance, angle = _tool_error(key_pose, tool)
        self.report.away.append(distance)
        self.report.turned.append(angle)

    def _judge_stroke(self, tools: np.ndarray) -> None:
        plant, data = self.plant, require_inspection(self.plant.sensed.cell)
        index = plant.layout.object_names.index(self.trial.part)
        face = data.face(data.part(self.trial.part).face)
        errors = brush_errors(face, plant.objects()[index], tools)
        self.report.brush_angles, self.report.stand_offs = errors


def inspect_parts(
    cell: Workcell,
    plan: Planning,
    trials: Sequence[Trial],
    disturbance: Disturbance = CALM,
    config: ExecutionConfig = ExecutionConfig(),
    engine: str = "auto",
    progress: Callable[[int, float], None] = lambda ended, seconds: None,
) -> list[InspectionReport]:
    """Carry out trials of inspection, `TRIALS_PER_BATCH` of them side by side.

    Args:
        cell: with inspection data.
        plan: makes the plans.
        trials: parts and seeds.
        disturbance: what differs from what the planner is told.
        config: times.
        engine: mujoco (in C, on all cores), mjx, or auto; see `engines.make_engine`.
        progress: is called with the number of ended trials and the simulated time of all [s].

    Returns:
        One report a trial: errors at key poses [m], [rad], `[point]` brush angles [rad] and
        distances [m] along the stroke, contacts, frames `[frame, nq]`.
    """
    sensed, reports, simulated = sense_cell(cell), [], 0.0
    physics, model = make_engine(sensed, engine), disturbed_model(sensed.model, cell, disturbance)
    for first in range(0, len(trials), TRIALS_PER_BATCH):
        batch = trials[first : first + TRIALS_PER_BATCH]
        runs = [
            Inspecting(plant_of(sensed, trial, config, model), trial, disturbance, config).run()
            for trial in batch
        ]
        reports += drive(runs, physics, plan)
        simulated += sum(report.seconds for report in reports[first:])
        progress(len(reports), simulated)
    return reports


def plant_of(
    sensed: SensedCell, trial: Trial, config: ExecutionConfig, model: mujoco.MjModel
) -> Plant:
    """The cell in a trial's scene, the arm in the trial's random start configuration."""
    # another stream of random numbers than that of the measurement errors
    start = random_start(sensed.cell, np.random.default_rng([trial.seed, 2]))
    scene = sample_scene(sensed.cell, trial.seed)
    return Plant(sensed, scene, ticks(sensed, config.tick), model, start)


def _tool_error(key_pose: np.ndarray, tool: np.ndarray) -> tuple[float, float]:
    """Distance [m] and largest Euler angle [rad] of a tool pose `[7]` from a key pose `[8]`."""
    row = pose_row(key_pose)
    error = pose_of(row[:3], row[3:]).inv() * pose_of(tool[:3], tool[3:])
    angle = np.abs(error.rotation.as_euler("xyz")).max()
    return float(np.linalg.norm(error.translation)), float(angle)


def judge(plant: Plant, task: Task) -> Judgement:
    """Does the brush stand at the end of its stroke? See `contracts.ExecutionModule`."""
    distance, angle = _tool_error(task.key_poses[-1], plant.tools(MEASURED)[-1])
    failure = "" if distance <= EXACT[0] and angle <= EXACT[1] else "inexact"
    return Judgement(failure, {"away_mm": 1e3 * distance, "turned_deg": float(np.degrees(angle))})


def show(cell: Workcell, plan: Planning, seed: int, count: int) -> Showcase:
    """Brush `count` parts, each in its own scene."""
    parts = [spec.name for spec in require_inspection(cell).parts]
    trials = [Trial(parts[3 * i % len(parts)], seed + i) for i in range(count)]
    reports = inspect_parts(cell, plan, trials)
    rows = [
        {
            "name": r.trial.part,
            "success": r.succeeded(*EXACT),
            "cause": r.cause,
            "detail": r.detail,
            "shares": r.shares,
            "planning_s": r.planning_s,
            "cycle_s": r.seconds,
        }
        for r in reports
    ]
    frames = np.concatenate([r.frames for r in reports])
    return Showcase(rows, frames, sum(len(r.touches) for r in reports))
