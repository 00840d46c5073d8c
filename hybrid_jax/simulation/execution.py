# SPDX-License-Identifier: MIT
"""Carry out one plan: follow its phases, grip, look, release, and say how it ended."""

import enum
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hybrid_jax.errors import InputError
from hybrid_jax.planner.scenes import placed_pose
from hybrid_jax.simulation.plant import Plant, Steps
from hybrid_jax.simulation.sensing import OBJECTS
from hybrid_jax.skills.handling import object_in_tool
from hybrid_jax.skills.task import Task, yaw_of
from hybrid_jax.types import Trajectory


@dataclass(frozen=True)
class ExecutionConfig:
    """Times and thresholds of an execution."""

    tick: float = 0.05
    """Time between two looks at the cell [s]; the servos work at every physics step."""
    grip_time: float = 0.8
    """Time that closing or opening the gripper takes [s]."""
    dwell: float = 0.3
    """Rest at the end of a phase before the gripper moves [s]."""
    settle: float = 0.6
    """Time that objects get to come to rest at the end [s]."""
    brake: float = 0.3
    """Time in which a motion is brought to rest along its path [s]."""
    lost_at: float = 0.02
    """A held object is lost when it is further than this from where it was gripped [m]."""
    moved_by: float = 0.005
    """An object was moved when it is further than this from where it was planned for [m], ..."""
    turned_by: float = 0.05
    """... or turned by more than this [rad]."""
    following_error: float = 0.02
    """A joint that is further than this from its target on the way to a grasp is blocked [rad]."""
    grasp_error: float = 0.025
    """A grasp is missed when the object is further than this from where it should be in it [m]."""
    near: float = 0.03
    """A held object may touch its support where it is this close to where it lies on it [m]."""
    switch_time: float = 0.3
    """A drop belongs to a switch between skill and joint agent within this time after it [s]."""
    tries: int = 4
    """Plans that are carried out for one object at most."""
    weld: bool = False
    """Hold objects by a weld instead of by friction."""


class Ending(enum.Enum):
    """How carrying out a plan ended."""

    DONE = "carried out"
    MOVED = "an object moved on the way to the grasp"
    BLOCKED = "something stood in the arm's way"
    MISSED = "missed grasp"
    DROPPED = "drop in transfer"
    DROPPED_AT_SWITCH = "drop at a switch"


class Execution:
    """One plan for one object in one plant."""

    def __init__(
        self,
        plant: Plant,
        task: Task,
        phases: list[Trajectory],
        config: ExecutionConfig = ExecutionConfig(),
    ):
        """Args:
            plant: the cell.
            task: what was planned.
            phases: of the plan.
            config: times and thresholds.

        Raises:
            InputError: there is nothing to carry out, or it starts elsewhere than the arm stands.
        """
        if not phases:
            raise InputError("nothing to execute: the plan holds no trajectory")
        away = np.abs(plant.target - phases[0].positions[0]).max()
        if away > 0.01:
            raise InputError(f"the arm is {away:.2f} rad away from where the plan starts")
        self.plant, self.task, self.phases, self.config = plant, task, phases, config
        self.object = plant.layout.object_names.index(task.object_name)
        self.gripper = plant.spec.gripper
        self.seen = plant.objects()
        self.lying = self._lying()
        self.disturb: Callable[[int], None] | None = None
        """Called once, half way to the grasp, with the object that is reached for."""
        self.following = phases[0]
        self.gripped_at = np.zeros(3)
        self.slip = 0.0
        """Largest way of the held object in the tool [m]."""

    def _lying(self) -> np.ndarray:
        """`[mover, thing]` what objects touch before anything has moved."""
        last = self.plant.last
        shape = (len(self.plant.sensed.movers), len(self.plant.sensed.things))
        lying = np.zeros(shape, bool) if last is None else last.touching[-1].copy()
        lying[:OBJECTS] = False
        return lying

    def run(self) -> Steps:
        """From the plan's start to its end, or to what went wrong; returns an `Ending`."""
        for number, trajectory in enumerate(self.phases):
            low = self.task.phases[number][0]
            held, ever = self.task.carrying[low], any(self.task.carrying[:low])
            if held:
                yield from self.close()
                if not self.gripped():
                    yield from self.open()
                    return Ending.MISSED
                ending = yield from self.follow(trajectory, self.gripper.squeeze, self.lost)
            else:
                if ever:
                    yield from self.open()
                watch = (lambda time: None) if ever else self.hindered
                ending = yield from self.follow(trajectory, self.gripper.open, watch)
            if ending:
                if held:
                    yield from self.open()
                return ending
        yield from self.hold(self.gripper.open, self.config.settle)
        return Ending.DONE

    def follow(self, trajectory: Trajectory, grip: float, watch) -> Steps:
        """Along a trajectory, then at rest; brakes and returns an `Ending` if `watch` sees one."""
        plant, now, self.following = self.plant, 0.0, trajectory
        times = np.arange(plant.dt, trajectory.times[-1] + self.config.dwell, plant.dt)
        for chunk in plant.chunks(*targets(trajectory, times), grip):
            yield from plant.step(chunk, self.allowed(grip))
            now += len(chunk.targets) * plant.dt
            ending = watch(now)
            if ending:
                yield from self.stop(trajectory, now, grip)
                return ending
        return None

    def stop(self, trajectory: Trajectory, now: float, grip: float) -> Steps:
        """To rest along the path, ever slower."""
        plant, brake = self.plant, self.config.brake
        since = np.arange(plant.dt, brake + plant.dt / 2, plant.dt)
        q, velocity = targets(trajectory, now + since - since**2 / (2 * brake))
        for chunk in plant.chunks(q, velocity * (1 - since / brake)[:, None], grip):
            yield from plant.step(chunk, self.allowed(grip))

    def hold(self, grip: float, seconds: float) -> Steps:
        """Keep the configuration while the gripper or the objects move."""
        q = np.repeat(self.plant.target[None], max(1, round(seconds / self.plant.dt)), axis=0)
        for chunk in self.plant.chunks(q, np.zeros_like(q), grip):
            yield from self.plant.step(chunk, self.reaching())

    def close(self) -> Steps:
        """Grip."""
        yield from self.hold(self.gripper.squeeze, self.config.grip_time)
        self.gripped_at = self.plant.object_in_tool(self.object)
        if self.config.weld:
            self._weld(1.0)

    def open(self) -> Steps:
        """Let go."""
        self._weld(0.0)
        yield from self.hold(self.gripper.open, self.config.grip_time)

    def _weld(self, active: float) -> None:
        name = f"weld {self.task.object_name}"
        self.plant.welded[self.plant.model.equality(name).id] = active

    def gripped(self) -> bool:
        """Is the object between the pads?"""
        spec = self.plant.spec.object(self.task.object_name)
        wanted = object_in_tool(spec, self.task.grasp)[:3]
        close = np.linalg.norm(self.gripped_at - wanted) < self.config.grasp_error
        between = self.plant.opening() > spec.grip / 2
        return self.config.weld or bool(close and between and self.plant.pads_on(self.object))

    def lost(self, time: float) -> Ending | None:
        """Does the object no longer move with the tool?"""
        slip = float(np.linalg.norm(self.plant.object_in_tool(self.object) - self.gripped_at))
        self.slip = max(self.slip, slip)
        if slip < self.config.lost_at:
            return None
        marks, times = self.following.sources, self.following.times
        switches = times[1:][marks[1:] != marks[:-1]]
        since = time - switches
        at_switch = ((since >= 0) & (since < self.config.switch_time)).any()
        return Ending.DROPPED_AT_SWITCH if at_switch else Ending.DROPPED

    def hindered(self, time: float) -> Ending | None:
        """Is the arm blocked, or does an object lie elsewhere than it was planned for?"""
        if self.disturb and time > self.phases[0].times[-1] / 2:
            self.disturb(self.object)
            self.disturb = None
        if self.plant.following_error() > self.config.following_error:
            return Ending.BLOCKED
        now = self.plant.objects()
        away = np.linalg.norm(now[:, :3] - self.seen[:, :3], axis=1)
        turn = np.array([yaw_of(a) - yaw_of(b) for a, b in zip(now, self.seen, strict=True)])
        turn = np.abs((turn + np.pi) % (2 * np.pi) - np.pi)
        far = (away > self.config.moved_by) | (turn > self.config.turned_by)
        return Ending.MOVED if far.any() else None

    def reaching(self) -> np.ndarray:
        """`[mover, thing]` contacts that may be while fingers reach for the object, close and open.

        The object may touch what it touched before and what it is lifted from or put on: fingers
        must not push it into a neighbour or a wall.
        """
        allowed, things = self.plant.resting(self.object), self.plant.sensed.things
        row = OBJECTS + self.object
        allowed[row] = allowed[OBJECTS:, self.object] = False
        allowed[row, [things.index(support) for support in self.task.support]] = True
        return allowed | self.lying

    def allowed(self, grip: float) -> np.ndarray:
        """`[mover, thing]` contacts that may be now.

        A held object may touch only what it is lifted from or put on, and only there.
        """
        allowed, things = self.reaching(), self.plant.sensed.things
        if grip == self.gripper.open:
            return allowed
        row = OBJECTS + self.object
        allowed[row] = allowed[OBJECTS:, self.object] = False
        position = self.plant.objects()[self.object, :3]
        ends = self.seen[self.object], placed_pose(self.plant.sensed.cell, self.task)
        for support, end in zip(self.task.support, ends, strict=True):
            allowed[row, things.index(support)] = (
                np.linalg.norm(position - end[:3]) < self.config.near
            )
        return allowed


def targets(trajectory: Trajectory, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Configurations and velocities `[time, joint]`; at rest before and after."""
    inside = (times >= 0) & (times < trajectory.times[-1])
    q, velocity = (
        np.stack([np.interp(times, trajectory.times, c) for c in columns.T], axis=1)
        for columns in (trajectory.positions, trajectory.velocities)
    )
    return q, velocity * inside[:, None]
