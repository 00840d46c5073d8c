# SPDX-License-Identifier: MIT
"""Control of one scene: sort its objects into their trays, plan, carry out, and try again."""

import itertools
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from hybrid_jax.execution.disturbances import CALM, Disturbance, measured, push
from hybrid_jax.execution.plan_execution import Ending, Execution, ExecutionConfig
from hybrid_jax.execution.plant import BlownUp, PlanRequest, Plant, Steps, Touch
from hybrid_jax.tasks.handling import make_task
from hybrid_jax.types import Source, Status

AGAIN = Ending.MOVED, Ending.BLOCKED, Ending.MISSED
"""Endings after which the object is tried again."""
ON_FLOOR, ROUNDING = 0.005, 0.001
"""Tolerances of `in_tray`: distance of an object's lowest point from the tray's floor [m], and how
far it may stand out over the rim [m]."""
LEANING = np.radians(15.0)
"""An object that is tilted by more than this cannot be gripped from above [rad]."""


@dataclass
class ObjectReport:
    """Outcome of one object."""

    name: str
    placed: bool = False
    """It lies in its tray at the end, whatever was touched on the way."""
    success: bool = False
    """It lies in its tray, at rest, and nothing that should not be touched was touched."""
    cause: str = "no plan"
    """Cause of failure; empty for a success."""
    detail: str = ""
    """A sentence about the cause."""
    asked: int = 0
    """Number of plans that were requested."""
    tries: int = 0
    """Number of plans that were carried out."""
    planning_s: float = 0.0
    """Time of all plans [s]."""
    cycle_s: float = 0.0
    """Simulated time [s]."""
    shares: dict[str, float] = field(default_factory=dict)
    """Share of the last plan's points from each source."""
    way_rad: float = 0.0
    """Length of the last plan's path in joint space, over all phases [rad]."""
    motion_s: float = 0.0
    """Duration of the last plan's motions [s]."""


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
        """Prepare a run.

        Args:
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
        """Go on until every object was carried or given up; returns the reports."""
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
        """Try all objects in turn; one without a plan waits until another is out of the way."""
        waiting = list(self.reports)
        while waiting:
            unplanned = []
            for name in waiting:
                ended = yield from self._one(self.reports[name])
                if not ended:
                    unplanned.append(name)
            # nothing has moved, so the same requests would fail again: take other grasps
            if len(unplanned) == len(waiting):
                unplanned = [name for name in unplanned if self._next_grasp(name)]
            waiting = unplanned

    def _next_grasp(self, name: str) -> bool:
        """Take the next grasp of an object; False, and the first grasp again, after the last."""
        following = self.grasps[name] + 1
        available = following < len(self.plant.spec.object(name).grasps)
        self.grasps[name] = following if available else 0
        return available

    def _one(self, report: ObjectReport) -> Steps:
        """Bring one object to its tray, or give it up; False if there is no plan at present."""
        start_time, self.plant.counted = self.plant.time, len(self.plant.touches)
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
        report.cycle_s += self.plant.time - start_time
        return ended

    def _plan(self, report: ObjectReport) -> Steps:
        """Plan from the present state; returns the plan's execution, None if there is no plan."""
        if self._leans(report.name):
            report.detail = "the object no longer stands upright"
            return None
        poses = measured(self.plant.objects(), self.disturbance, self.rng)
        task = make_task(
            self.plant.sensed.cell,
            report.name,
            poses,
            start=self.plant.target,
            grasp=self.grasps[report.name],
        )
        report.asked += 1
        answer = yield PlanRequest(task)
        report.planning_s += answer.seconds
        result = answer.result
        if result.status is not Status.OK:
            report.detail = f"{result.status.name}: {result.detail}"
            return None
        shares = result.shares
        report.shares = {source.name: round(shares[source], 3) for source in Source}
        increments = [np.diff(phase.positions, axis=0) for phase in result.phases]
        report.way_rad = round(float(sum(np.linalg.norm(s, axis=1).sum() for s in increments)), 3)
        report.motion_s = round(float(sum(phase.times[-1] for phase in result.phases)), 3)
        execution = Execution(self.plant, task, result.phases, self.config)
        if self.pushed == report.name:
            execution.disturb = self._push
        return execution

    def _leans(self, name: str) -> bool:
        """Is an object tilted too far to be gripped from above?"""
        index = self.plant.layout.object_names.index(name)
        rotation = Rotation.from_quat(self.plant.objects()[index, 3:], scalar_first=True)
        return bool(rotation.as_matrix()[2, 2] < np.cos(LEANING))

    def _push(self, index: int) -> None:
        """Push the object that the arm reaches for; again with the next plan where it fails."""
        if push(self.plant, index, self.disturbance.push, self.rng):
            self.pushed = None

    def _retreat(self, name: str) -> Steps:
        """Go back home along the travelled path, with open fingers.

        From there the next approach comes from above again, wherever the object lies by then.
        """
        plant, index = self.plant, self.plant.layout.object_names.index(name)
        q = np.concatenate(plant.travelled)[::-1]
        # without the rests on the way; the last target is held for one tick
        moving = np.abs(np.diff(q, axis=0, prepend=q[:1])).max(axis=1) > 0
        q = np.concatenate([q[:1], q[moving], np.repeat(q[-1:], plant.tick, axis=0)])
        velocity = np.gradient(q, plant.dt, axis=0)
        for chunk in plant.chunks(q, velocity, plant.spec.gripper.open):
            yield from plant.step(chunk, plant.resting(index))
        plant.travelled.clear()

    def _judge(self, report: ObjectReport) -> None:
        """Note at the end whether an object lies in its tray, and why not."""
        placed, touches = in_tray(self.plant, report.name), self.touches[report.name]
        if touches:
            report.cause, report.detail = "collision", "; ".join(map(str, touches))
        if not report.cause and not placed:
            report.cause, report.detail = "wrong place", "it does not lie in its tray at the end"
        report.placed, report.success = placed, placed and not report.cause


def in_tray(plant: Plant, name: str) -> bool:
    """Does an object lie in its tray: all of it within the rim, on the floor, at rest?"""
    tray, model = plant.spec.tray(plant.spec.object(name).tray), plant.model
    body, index = model.body(tray.name).id, plant.layout.object_names.index(name)
    corners = np.concatenate(
        [
            _corners(plant, geom)
            for geom in range(model.ngeom)
            if model.geom_bodyid[geom] == plant.layout.object_bodies[index]
        ]
    )
    # columns of `xmat` are the tray's axes in the world: this product goes into the tray's frame
    corners_in_tray = (corners - plant.data.xpos[body]) @ plant.data.xmat[body].reshape(3, 3)
    within_rim = (np.abs(corners_in_tray[:, :2]) <= np.add(tray.half_size, ROUNDING)).all()
    on_floor = abs(corners_in_tray[:, 2].min() - tray.floor) < ON_FLOOR
    return bool(within_rim and on_floor and plant.object_speed(index) < 0.05)


def _corners(plant: Plant, geom: int) -> np.ndarray:
    """`[8, 3]` corners of a geom's bounding box in the world [m]."""
    model, data = plant.model, plant.data
    centre, half_extents = np.split(model.geom_aabb[geom], 2)
    corners = centre + half_extents * np.array(list(itertools.product((-1, 1), repeat=3)))
    return data.geom_xpos[geom] + corners @ data.geom_xmat[geom].reshape(3, 3).T
