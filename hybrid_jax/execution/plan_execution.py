# SPDX-License-Identifier: MIT
"""Carry out one plan: follow its phases, grip, check, release, and say how it ended."""

import enum
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hybrid_jax.errors import InputError
from hybrid_jax.execution.contact_sensors import OBJECTS
from hybrid_jax.execution.plant import Plant, Steps
from hybrid_jax.tasks.task import Task, yaw_of
from hybrid_jax.types import Trajectory


@dataclass(frozen=True)
class ExecutionConfig:
    """Times and thresholds of an execution."""

    tick: float = 0.05
    """Time between two readings of the cell [s]; the servos work at every physics step."""
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
    """An object counts as moved beyond this distance from where it lay at planning time [m]."""
    turned_by: float = 0.05
    """An object counts as moved beyond this change of its heading [rad]."""
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
        """Prepare an execution.

        Args:
            plant: the cell.
            task: what was planned.
            phases: trajectories of the plan, with `[point, joint]` positions [rad].
            config: times and thresholds.

        Raises:
            InputError: there is nothing to carry out, or it starts elsewhere than the arm stands.
        """
        if not phases:
            raise InputError("nothing to execute: the plan holds no trajectory")
        distance = np.abs(plant.target - phases[0].positions[0]).max()
        if distance > 0.01:
            raise InputError(f"the arm is {distance:.2f} rad away from where the plan starts")
        self.plant, self.task, self.phases, self.config = plant, task, phases, config
        self.object = plant.layout.object_names.index(task.object_name)
        gripper = plant.spec.gripper
        opening, self.closed = (gripper.open, gripper.squeeze) if gripper else (0.0, 0.0)
        self.opened = opening if task.opening is None else task.opening
        """Commands of the gripper [m]; without one they are sent to nobody."""
        self.seen = plant.objects()
        self.lying = self._lying()
        self.disturb: Callable[[int], None] | None = None
        """Called once, half way to the grasp, with the index of the object to be gripped."""
        self.following = phases[0]
        self.gripped_at = np.zeros(3)
        self.slip = 0.0
        """Largest distance of the held object from where it was gripped, in the tool [m]."""

    def _lying(self) -> np.ndarray:
        """`[mover, thing]` what objects touch before the arm moves; nothing before the first step.

        Without the rows of arm and fingers.
        """
        last = self.plant.last
        shape = (len(self.plant.sensed.movers), len(self.plant.sensed.things))
        lying = np.zeros(shape, bool) if last is None else last.touching[-1].copy()
        lying[:OBJECTS] = False
        return lying

    def run(self) -> Steps:
        """Go from the plan's start to its end, or to the first failure; returns an `Ending`."""
        for number, trajectory in enumerate(self.phases):
            low = self.task.phases[number][0]
            held, carried_before = self.task.carrying[low], any(self.task.carrying[:low])
            if held:
                yield from self.close()
                if not self.gripped():
                    yield from self.open()
                    return Ending.MISSED
                ending = yield from self.follow(trajectory, self.closed, self.lost)
            else:
                if carried_before:
                    yield from self.open()
                monitor = (lambda time: None) if carried_before else self.hindered
                ending = yield from self.follow(trajectory, self.opened, monitor)
            if ending:
                if held:
                    yield from self.open()
                return ending
        yield from self.hold(self.opened, self.config.settle)
        return Ending.DONE

    def follow(self, trajectory: Trajectory, grip: float, watch) -> Steps:
        """Follow a trajectory, then rest.

        Args:
            trajectory: `[point, joint]` positions [rad] over time [s].
            grip: command of the gripper [m].
            watch: from the time in the trajectory [s] to an `Ending`, or None to go on.

        Returns:
            None at the end; the arm brakes, and the `Ending` is returned, as soon as there is one.
        """
        plant, elapsed, self.following = self.plant, 0.0, trajectory
        times = np.arange(plant.dt, trajectory.times[-1] + self.config.dwell, plant.dt)
        for chunk in plant.chunks(*targets(trajectory, times), grip):
            yield from plant.step(chunk, self.allowed(grip))
            elapsed += len(chunk.targets) * plant.dt
            ending = watch(elapsed)
            if ending:
                yield from self.stop(trajectory, elapsed, grip)
                return ending
        return None

    def stop(self, trajectory: Trajectory, now: float, grip: float) -> Steps:
        """Brake evenly along the path.

        Args:
            trajectory: that is followed.
            now: time in it at which braking begins [s].
            grip: command of the gripper [m].
        """
        plant, brake = self.plant, self.config.brake
        braking = np.arange(plant.dt, brake + plant.dt / 2, plant.dt)
        # the rate of the trajectory's time falls linearly to zero: the arm stays on the path
        q, velocity = targets(trajectory, now + braking - braking**2 / (2 * brake))
        for chunk in plant.chunks(q, velocity * (1 - braking / brake)[:, None], grip):
            yield from plant.step(chunk, self.allowed(grip))

    def hold(self, grip: float, seconds: float) -> Steps:
        """Keep the configuration for some seconds while the gripper or the objects move.

        Args:
            grip: command of the gripper [m].
            seconds: duration [s].
        """
        q = np.repeat(self.plant.target[None], max(1, round(seconds / self.plant.dt)), axis=0)
        for chunk in self.plant.chunks(q, np.zeros_like(q), grip):
            yield from self.plant.step(chunk, self.reaching())

    def close(self) -> Steps:
        """Close the gripper, and note where in the tool the object is gripped."""
        yield from self.hold(self.closed, self.config.grip_time)
        self.gripped_at = self.plant.object_in_tool(self.object)
        if self.config.weld:
            self._weld(1.0)

    def open(self) -> Steps:
        """Open the gripper."""
        self._weld(0.0)
        yield from self.hold(self.opened, self.config.grip_time)

    def _weld(self, active: float) -> None:
        name = f"weld {self.task.object_name}"
        self.plant.welded[self.plant.model.equality(name).id] = active

    def gripped(self) -> bool:
        """Is the object between the pads?"""
        hold = self.task.require_hold()
        centred = np.linalg.norm(self.gripped_at - hold.in_tool[:3]) < self.config.grasp_error
        not_closed = self.plant.opening() > hold.opening / 2
        return self.config.weld or bool(centred and not_closed and self.plant.pads_on(self.object))

    def lost(self, time: float) -> Ending | None:
        """Does the object no longer move with the tool?

        Args:
            time: in the trajectory [s].

        Returns:
            A drop, at a switch between skill and joint agent or elsewhere; None if it is held.
        """
        slip = float(np.linalg.norm(self.plant.object_in_tool(self.object) - self.gripped_at))
        self.slip = max(self.slip, slip)
        if slip < self.config.lost_at:
            return None
        sources, times = self.following.sources, self.following.times
        switches = times[1:][sources[1:] != sources[:-1]]
        elapsed = time - switches
        at_switch = ((elapsed >= 0) & (elapsed < self.config.switch_time)).any()
        return Ending.DROPPED_AT_SWITCH if at_switch else Ending.DROPPED

    def hindered(self, time: float) -> Ending | None:
        """Is the arm blocked, or does an object lie elsewhere than at planning time?

        Args:
            time: in the trajectory [s].
        """
        if self.disturb and time > self.phases[0].times[-1] / 2:
            self.disturb(self.object)
            self.disturb = None
        if self.plant.following_error() > self.config.following_error:
            return Ending.BLOCKED
        poses = self.plant.objects()
        displacement = np.linalg.norm(poses[:, :3] - self.seen[:, :3], axis=1)
        rotation = np.array([yaw_of(a) - yaw_of(b) for a, b in zip(poses, self.seen, strict=True)])
        rotation = np.abs((rotation + np.pi) % (2 * np.pi) - np.pi)
        displaced = (displacement > self.config.moved_by) | (rotation > self.config.turned_by)
        return Ending.MOVED if displaced.any() else None

    def reaching(self) -> np.ndarray:
        """`[mover, thing]` contacts allowed while fingers reach for the object, close and open.

        The object may touch what it touched before and what it is lifted from or put on: fingers
        must not push it into a neighbour or a wall.
        """
        allowed, columns = self.plant.resting(self.object), self.plant.sensed.things
        if self.task.hold is None:  # nobody grips it: it goes on lying as all others do
            return allowed
        row = OBJECTS + self.object
        allowed[row] = allowed[OBJECTS:, self.object] = False
        allowed[row, [columns.index(body) for body in self.task.hold.support]] = True
        return allowed | self.lying

    def allowed(self, grip: float) -> np.ndarray:
        """Contacts that are allowed at present.

        A held object may touch only what it is lifted from or put on, and only there.

        Args:
            grip: command of the gripper [m]: whether it is open.

        Returns:
            `[mover, thing]` True where a contact is allowed.
        """
        allowed, columns = self.reaching(), self.plant.sensed.things
        if grip == self.opened:
            return allowed
        row = OBJECTS + self.object
        allowed[row] = allowed[OBJECTS:, self.object] = False
        position, support = self.plant.objects()[self.object, :3], self.task.require_hold().support
        ends = self.seen[self.object], self.task.placed_pose
        # it is lifted from the first and put on the last; they may be one
        for body, end in zip(support[:1] + support[-1:], ends, strict=bool(support)):
            near = np.linalg.norm(position - end[:3]) < self.config.near
            allowed[row, columns.index(body)] |= near
        return allowed


def targets(trajectory: Trajectory, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Configurations and velocities of a trajectory at given times.

    Args:
        trajectory: `[point, joint]` positions [rad] and velocities [rad/s].
        times: `[time]` [s]; before the start and after the end the arm rests.

    Returns:
        Configurations `[time, joint]` [rad] and velocities `[time, joint]` [rad/s].
    """
    moving = (times >= 0) & (times < trajectory.times[-1])
    # `np.interp` holds the end values outside of the trajectory, where the velocity must be 0
    q, velocity = (
        np.stack([np.interp(times, trajectory.times, c) for c in columns.T], axis=1)
        for columns in (trajectory.positions, trajectory.velocities)
    )
    return q, velocity * moving[:, None]
