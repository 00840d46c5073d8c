# SPDX-License-Identifier: MIT
"""One simulated cell as its controller sees it: commands go in, readings come out.

A controller is a generator. It yields a request (`PhysicsRequest` or `PlanRequest`) and receives
the answer from `send`. So one engine call serves many runs, and one planner call many tasks.
"""

from collections.abc import Generator
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from hybrid_jax.contracts import PlanResult
from hybrid_jax.execution.contact_sensors import FINGERS, OBJECTS, SensedCell
from hybrid_jax.execution.engines import get_state
from hybrid_jax.tasks.scene_sampling import require_task_data
from hybrid_jax.tasks.task import Task
from hybrid_jax.workcell.layout import home_qpos


@dataclass(frozen=True)
class PhysicsRequest:
    """Request to simulate a plant under some commands."""

    plant: "Plant"
    commands: np.ndarray
    """`[step, command]` controls and active equalities, see `execution.engines`."""


@dataclass(frozen=True)
class PhysicsAnswer:
    """Result of a simulation."""

    states: np.ndarray
    """`[step, state]` MuJoCo's full physics state after each step."""
    touching: np.ndarray
    """`[step, mover, thing]` True where two touch."""


@dataclass(frozen=True)
class PlanRequest:
    """Request for a plan of a task."""

    task: Task


@dataclass(frozen=True)
class PlanAnswer:
    """A planner's answer."""

    result: PlanResult
    seconds: float
    """Share of this task in the time of its batch [s]."""


Steps = Generator[PhysicsRequest | PlanRequest, Any, Any]
"""A controller, or a part of one, as a generator of requests."""


@dataclass(frozen=True)
class Chunk:
    """Commands of one tick."""

    commands: np.ndarray
    """`[step, command]` controls and active equalities."""
    targets: np.ndarray
    """`[step, joint]` configurations that the controls lead to [rad]."""


class BlownUp(Exception):
    """The simulation became unstable."""


@dataclass(frozen=True)
class Touch:
    """A contact that is not allowed."""

    time: float
    """Simulated time [s]."""
    mover: str
    thing: str

    def __str__(self) -> str:
        return f"{self.mover} touched {self.thing} at {self.time:.2f} s"


def ticks(sensed: SensedCell, seconds: float) -> int:
    """Number of physics steps in a time [s], at least 1."""
    return max(1, round(seconds / sensed.model.opt.timestep))


class Plant:
    """State, readings and history of one run."""

    def __init__(
        self,
        sensed: SensedCell,
        object_poses: np.ndarray,
        tick: int,
        model: mujoco.MjModel | None = None,
        start: np.ndarray | None = None,
    ):
        """Put the arm at rest in a scene, the gripper as in the home keyframe.

        Args:
            sensed: the cell.
            object_poses: `[object, 7]` where the objects lie: position [m], quaternion.
            tick: physics steps between two readings.
            model: its numbers may differ from the sensed cell's.
            start: `[joint]` where the arm stands [rad]; at home if None.
        """
        self.sensed, self.model, self.tick = sensed, model or sensed.model, tick
        self.layout, self.spec = sensed.layout, require_task_data(sensed.cell)
        self.dt = float(self.model.opt.timestep)
        self.data = mujoco.MjData(self.model)
        self.servos = list(self.layout.actuators)
        # force of a servo: kp (command - q) - kv dq/dt, so it lags by kv / kp seconds
        self.lag = (
            -self.model.actuator_biasprm[self.servos, 2]
            / self.model.actuator_gainprm[self.servos, 0]
        )
        self.data.qpos[:] = home_qpos(self.model)
        for address, pose in zip(self.layout.object_qpos, object_poses, strict=True):
            self.data.qpos[address : address + 7] = pose
        if start is not None:
            self.data.qpos[list(self.layout.qpos)] = start
        mujoco.mj_forward(self.model, self.data)
        self.state = get_state(self.model, self.data)
        self.welded = np.array(self.model.eq_active0, float)
        self.target = self.data.qpos[list(self.layout.qpos)].copy()
        self.travelled: list[np.ndarray] = []
        self.touches: list[Touch] = []
        self.counted = 0
        """Index of the first touch of the current object: each object notes a pair once."""
        self.frames: list[np.ndarray] = [self.data.qpos.astype(np.float32)]
        self.last: PhysicsAnswer | None = None

    @property
    def time(self) -> float:
        """Simulated [s]."""
        return float(self.state[0])

    def objects(self) -> np.ndarray:
        """Present poses of the objects `[object, 7]`: position [m], quaternion."""
        return np.stack([self.data.qpos[a : a + 7] for a in self.layout.object_qpos])

    def object_in_tool(self, index: int) -> np.ndarray:
        """Position `[3]` of an object in the tool's frame [m]."""
        site = self.layout.tool_site
        offset = self.data.xpos[self.layout.object_bodies[index]] - self.data.site_xpos[site]
        return self.data.site_xmat[site].reshape(3, 3).T @ offset

    def tools(self, every: int) -> list[np.ndarray]:
        """Poses of the tool in the last tick: after each `every` steps, and at its end.

        Args:
            every: physics steps between two poses.

        Returns:
            Poses `[7]`: position [m], quaternion.
        """
        states = self.last.states[every - 1 :: every][:-1] if self.last else []
        poses, site, qpos = [], self.layout.tool_site, self.data.qpos
        for state in [*states, self.state]:
            qpos[:] = state[1 : 1 + self.model.nq]
            mujoco.mj_kinematics(self.model, self.data)
            quat = np.empty(4)
            mujoco.mju_mat2Quat(quat, self.data.site_xmat[site])
            poses.append(np.concatenate([self.data.site_xpos[site], quat]))
        return poses

    def object_speed(self, index: int) -> float:
        """Largest component of an object's linear or angular velocity [m/s or rad/s]."""
        dof = 1 + self.model.nq + self.model.body_dofadr[self.layout.object_bodies[index]]
        return float(np.abs(self.state[dof : dof + 6]).max())

    def pads_on(self, index: int) -> bool:
        """Do the fingers touch an object at the last step?"""
        return self.last is not None and bool(self.last.touching[-1, FINGERS, index])

    def opening(self) -> float:
        """Opening of the finger that is closed further [m]."""
        return min(self.data.qpos[self.model.jnt_qposadr[j]] for j in self.layout.fingers)

    def following_error(self) -> float:
        """Largest distance of a joint from its target [rad]."""
        return float(np.abs(self.data.qpos[list(self.layout.qpos)] - self.target).max())

    def set_object(self, index: int, pose: np.ndarray) -> None:
        """Put an object elsewhere, at rest, as a disturbance.

        Args:
            index: of the object.
            pose: `[7]` position [m], quaternion.
        """
        # a state is `[time, qpos, qvel, act]`
        address = 1 + self.layout.object_qpos[index]
        self.state[address : address + 7] = pose
        dof = 1 + self.model.nq + self.model.body_dofadr[self.layout.object_bodies[index]]
        self.state[dof : dof + 6] = 0.0

    def chunks(self, q: np.ndarray, velocity: np.ndarray, grip: float) -> list[Chunk]:
        """Cut joint targets and a gripper command into ticks.

        The last target is held until its tick ends. The servos damp the joint's own velocity, so
        the target's velocity times their lag is added to the command.

        Args:
            q: `[step, joint]` targets [rad].
            velocity: `[step, joint]` velocities of the targets [rad/s].
            grip: command of the gripper [m].

        Returns:
            One chunk a tick, with commands `[step, command]`.
        """
        padding = -len(q) % self.tick
        q = np.concatenate([q, np.repeat(q[-1:], padding, axis=0)])
        velocity = np.concatenate([velocity, np.zeros((padding, q.shape[1]))])
        rows = np.zeros((len(q), self.model.nu + self.model.neq))
        rows[:, self.servos] = q + self.lag * velocity
        if self.layout.gripper_actuator >= 0:
            rows[:, self.layout.gripper_actuator] = grip
        slices = (slice(i, i + self.tick) for i in range(0, len(q), self.tick))
        return [Chunk(rows[tick_steps], q[tick_steps]) for tick_steps in slices]

    def step(self, chunk: Chunk, allowed: np.ndarray) -> Steps:
        """Simulate one tick, and note contacts that are not allowed.

        Args:
            chunk: commands of the tick.
            allowed: `[mover, thing]` True where a contact is allowed.
        """
        chunk.commands[:, self.model.nu :] = self.welded
        self.accept((yield PhysicsRequest(self, chunk.commands)), allowed)
        self.target = chunk.targets[-1]
        self.travelled.append(chunk.targets)

    def accept(self, rolled: PhysicsAnswer, allowed: np.ndarray) -> None:
        """Take over the engine's states, and note contacts that are not allowed.

        Args:
            rolled: `[step, state]` states and `[step, mover, thing]` contacts of a tick.
            allowed: `[mover, thing]` True where a contact is allowed.

        Raises:
            BlownUp: states that are not finite, or an engine that started anew.
        """
        # C MuJoCo resets a simulation that explodes, and its clock with it
        end_time = self.time + len(rolled.states) * self.dt
        if not np.isfinite(rolled.states).all() or abs(rolled.states[-1, 0] - end_time) > 1e-6:
            raise BlownUp(f"the simulation blew up after {self.time:.2f} s")
        start_time, self.state, self.last = self.time, rolled.states[-1].copy(), rolled
        self.data.qpos[:] = self.state[1 : 1 + self.model.nq]
        mujoco.mj_kinematics(self.model, self.data)
        self.frames.append(self.data.qpos.astype(np.float32))
        noted = {(touch.mover, touch.thing) for touch in self.touches[self.counted :]}
        for row, column in np.argwhere((rolled.touching & ~allowed).any(axis=0)):
            names = self.sensed.movers[row], self.sensed.things[column]
            if names not in noted:
                step = int(np.argmax(rolled.touching[:, row, column]))
                self.touches.append(Touch(start_time + (step + 1) * self.dt, *names))

    def resting(self, index: int) -> np.ndarray:
        """Contacts that are allowed while no object is carried.

        The fingers may touch the object that they reach for or leave; objects touch what they lie
        on.

        Args:
            index: of the object that the fingers may touch.

        Returns:
            `[mover, thing]` True where a contact is allowed.
        """
        allowed = np.zeros((len(self.sensed.movers), len(self.sensed.things)), bool)
        allowed[OBJECTS:] = True
        allowed[FINGERS, index] = True
        return allowed
