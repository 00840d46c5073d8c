# SPDX-License-Identifier: MIT
"""Sort all objects of a cell into their trays: plan, carry out, look, and try again."""

import itertools
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from hybrid_jax.simulation.disturbances import CALM, Disturbance, measured, push
from hybrid_jax.simulation.execution import Ending, Execution, ExecutionConfig
from hybrid_jax.simulation.plant import BlownUp, Plan, Plant, Steps, Touch
from hybrid_jax.skills.handling import handling_task
from hybrid_jax.types import Source, Status

AGAIN = Ending.MOVED, Ending.BLOCKED, Ending.MISSED
"""Endings after which the object is tried again."""
ON_FLOOR, ROUNDING = 0.005, 0.001
"""An object lies in its tray if its lowest point is this near to the floor [m], and nothing of it
stands out over the rim by more than this [m]."""
LEANING = np.radians(15.0)
"""An object that is tilted by more than this cannot be gripped from above [rad]."""


@dataclass
class ObjectReport:
    """What became of one object."""

    name: str
    placed: bool = False
    """It lies in its tray at the end, whatever was touched on the way."""
    success: bool = False
    """It lies in its tray, at rest, and nothing that should not be touched was touched."""
    cause: str = "no plan"
    """Why not; empty for a success."""
    detail: str = ""
    """The sentence to it."""
    asked: int = 0
    """Plans that were asked for, ..."""
    tries: int = 0
    """... and that were carried out."""
    planning_s: float = 0.0
    """Time of all plans [s]."""
    cycle_s: float = 0.0
    """Simulated time [s]."""
    shares: dict[str, float] = field(default_factory=dict)
    """Share of the last plan's points from each source, ..."""
    way_rad: float = 0.0
    """... its way: sum over the phases of the joints' common length [rad], ..."""
    motion_s: float = 0.0
    """... and how long its motions take [s]."""


class Sorting:
    """One run: all objects of a scene."""

    def __init__(
        self,
        plant: Plant,
        names: list[str],
        seed: int,
        disturbance: Disturbance = CALM,
        config: ExecutionConfig = ExecutionConfig(),
    ):
        """Args:
        plant: the cell, with the arm at home.
        names: objects, in the order in which they are tried.
        seed: of the disturbances.
        disturbance: what differs from what the planner is told.
        config: times and thresholds.
        """
        self.plant, self.disturbance, self.config = plant, disturbance, config
        self.rng = np.random.default_rng(seed)
        self.reports = {name: ObjectReport(name) for name in names}
        self.pushed = names[self.rng.integers(len(names))] if disturbance.push else None
        self.grasps = dict.fromkeys(names, 0)
        self.touches: dict[str, list[Touch]] = {name: [] for name in names}

    def run(self) -> Steps:
        """Until every object was carried or given up; returns the reports."""
        try:
            yield from self._all()
        except BlownUp as error:
            for report in self.reports.values():
                report.success, report.cause, report.detail = False, "numerical", str(error)
        else:
            for report in self.reports.values():
                self._judge(report)
        return list(self.reports.values())

    def _all(self) -> Steps:
        """Whoever finds no plan waits until another object is out of the way."""
        waiting = list(self.reports)
        while waiting:
            left = []
            for name in waiting:
                planned = yield from self._one(self.reports[name])
                if not planned:
                    left.append(name)
            if len(left) == len(waiting):
                left = [name for name in left if self._next_grasp(name)]
            waiting = left

    def _next_grasp(self, name: str) -> bool:
        """Take another grasp for an object; False if there is none left."""
        self.grasps[name] += 1
        left = self.grasps[name] < len(self.plant.spec.object(name).grasps)
        self.grasps[name] *= left
        return left

    def _one(self, report: ObjectReport) -> Steps:
        """Bring one object to its tray, or give it up; False if there is no plan for it now."""
        began, self.plant.counted = self.plant.time, len(self.plant.touches)
        ended = False
        while not ended:
            execution = yield from self._plan(report)
            if execution is None:
                break
            report.tries += 1
            ending = yield from execution.run()
            report.cause, report.detail = ending.value, ""
            if ending is Ending.DONE:
                self.plant.travelled.clear()
                report.cause = ""
            else:
                yield from self._retreat(report.name)
            ended = ending not in AGAIN or report.tries >= self.config.tries
            if ending is Ending.MISSED:
                self._next_grasp(report.name)
        self.touches[report.name] += self.plant.touches[self.plant.counted :]
        report.cycle_s += self.plant.time - began
        return ended

    def _plan(self, report: ObjectReport) -> Steps:
        """An execution of a plan from where everything is now; None if there is no plan."""
        if self._leans(report.name):
            report.detail = "the object no longer stands upright"
            return None
        poses = measured(self.plant.objects(), self.disturbance, self.rng)
        task = handling_task(
            self.plant.sensed.cell, report.name, poses,
            start=self.plant.target, grasp=self.grasps[report.name],
        )  # fmt: skip
        report.asked += 1
        answer = yield Plan(task)
        report.planning_s += answer.seconds
        result = answer.result
        if result.status is not Status.OK:
            report.detail = f"{result.status.name}: {result.detail}"
            return None
        shares = result.shares
        report.shares = {source.name: round(shares[source], 3) for source in Source}
        steps = [np.diff(phase.positions, axis=0) for phase in result.phases]
        report.way_rad = round(float(sum(np.linalg.norm(s, axis=1).sum() for s in steps)), 3)
        report.motion_s = round(float(sum(phase.times[-1] for phase in result.phases)), 3)
        execution = Execution(self.plant, task, result.phases, self.config)
        if self.pushed == report.name:
            execution.disturb = self._push
        return execution

    def _leans(self, name: str) -> bool:
        """Is an object tilted, so that it cannot be gripped from above?"""
        index = self.plant.layout.object_names.index(name)
        turn = Rotation.from_quat(self.plant.objects()[index, 3:], scalar_first=True)
        return bool(turn.as_matrix()[2, 2] < np.cos(LEANING))

    def _push(self, index: int) -> None:
        """Somebody moves the object that the arm reaches for."""
        if push(self.plant, index, self.disturbance.push, self.rng):
            self.pushed = None

    def _retreat(self, name: str) -> Steps:
        """Back home along everything that was travelled, with open fingers.

        From there the next approach comes from above again, wherever the object lies by then.
        """
        plant, index = self.plant, self.plant.layout.object_names.index(name)
        q = np.concatenate(plant.travelled)[::-1]
        moving = np.abs(np.diff(q, axis=0, prepend=q[:1])).max(axis=1) > 0
        q = np.concatenate([q[:1], q[moving], np.repeat(q[-1:], plant.tick, axis=0)])
        velocity = np.gradient(q, plant.dt, axis=0)
        for chunk in plant.chunks(q, velocity, plant.spec.gripper.open):
            yield from plant.step(chunk, plant.resting(index))
        plant.travelled.clear()

    def _judge(self, report: ObjectReport) -> None:
        """Say at the end whether an object lies in its tray, and why not."""
        lies, touches = in_tray(self.plant, report.name), self.touches[report.name]
        if touches:
            report.cause, report.detail = "collision", "; ".join(map(str, touches))
        if not report.cause and not lies:
            report.cause, report.detail = "wrong place", "it does not lie in its tray at the end"
        report.placed, report.success = lies, lies and not report.cause


def in_tray(plant: Plant, name: str) -> bool:
    """Does an object lie in its tray: all of it within the rim, on the floor, at rest?"""
    tray, model = plant.spec.tray(plant.spec.object(name).tray), plant.model
    body, index = model.body(tray.name).id, plant.layout.object_names.index(name)
    corners = np.concatenate([
        _corners(plant, geom)
        for geom in range(model.ngeom)
        if model.geom_bodyid[geom] == plant.layout.object_bodies[index]
    ])  # fmt: skip
    local = (corners - plant.data.xpos[body]) @ plant.data.xmat[body].reshape(3, 3)
    inside = (np.abs(local[:, :2]) <= np.add(tray.half_size, ROUNDING)).all()
    lies = abs(local[:, 2].min() - tray.floor) < ON_FLOOR
    return bool(inside and lies and plant.object_speed(index) < 0.05)


def _corners(plant: Plant, geom: int) -> np.ndarray:
    """`[8, 3]` corners of a geom's bounding box in the world [m]."""
    model, data = plant.model, plant.data
    middle, half = np.split(model.geom_aabb[geom], 2)
    local = middle + half * np.array(list(itertools.product((-1, 1), repeat=3)))
    return data.geom_xpos[geom] + local @ data.geom_xmat[geom].reshape(3, 3).T
