# SPDX-License-Identifier: MIT
"""One simulated cell as its controller sees it: commands go in, readings come out.

Whoever controls a plant is a generator: it yields what it wants (`Roll`: physics; `Plan`: a
planner's answer) and gets it sent back. So one engine call serves many runs, and one planner call
many tasks.
"""

from collections.abc import Generator
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from hybrid_jax.planner.records import PlanResult
from hybrid_jax.simulation.engines import get_state
from hybrid_jax.simulation.sensing import FINGERS, OBJECTS, SensedCell
from hybrid_jax.skills.scenes import require_task_data
from hybrid_jax.skills.task import Task
from hybrid_jax.workcell.layout import home_qpos


@dataclass(frozen=True)
class Roll:
    """A wish: physics under these commands."""

    plant: "Plant"
    commands: np.ndarray
    """`[step, command]`"""


@dataclass(frozen=True)
class Rolled:
    """Physics as it went."""

    states: np.ndarray
    """`[step, state]`"""
    touching: np.ndarray
    """`[step, mover, thing]`"""


@dataclass(frozen=True)
class Plan:
    """A wish: a plan for a task."""

    task: Task


@dataclass(frozen=True)
class Planned:
    """A planner's answer."""

    result: PlanResult
    seconds: float
    """Share of this task in the time of its batch [s]."""


Steps = Generator[Roll | Plan, Any, Any]
"""A piece of control."""


@dataclass(frozen=True)
class Chunk:
    """What is commanded in one tick."""

    commands: np.ndarray
    """`[step, command]`"""
    targets: np.ndarray
    """`[step, joint]` [rad]"""


class BlownUp(Exception):
    """The simulation left the numbers that mean something."""


@dataclass(frozen=True)
class Touch:
    """A contact that should not be."""

    time: float
    mover: str
    thing: str

    def __str__(self) -> str:
        return f"{self.mover} touched {self.thing} at {self.time:.2f} s"


def ticks(sensed: SensedCell, seconds: float) -> int:
    """Physics steps in some time."""
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
        """The arm at rest, the gripper open.

        Args:
            sensed: the cell.
            object_poses: `[object, 7]` where the objects lie.
            tick: physics steps between two readings.
            model: its numbers may differ from the sensed cell's.
            start: `[joint]` where the arm stands [rad]; at home if None.
        """
        self.sensed, self.model, self.tick = sensed, model or sensed.model, tick
        self.layout, self.spec = sensed.layout, require_task_data(sensed.cell)
        self.dt = float(self.model.opt.timestep)
        self.data = mujoco.MjData(self.model)
        self.servos = list(self.layout.actuators)
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
        """Touches before this one are another object's: a pair is noted once for each object."""
        self.frames: list[np.ndarray] = [self.data.qpos.astype(np.float32)]
        self.last: Rolled | None = None

    @property
    def time(self) -> float:
        """Simulated [s]."""
        return float(self.state[0])

    def objects(self) -> np.ndarray:
        """`[object, 7]` where the objects are."""
        return np.stack([self.data.qpos[a : a + 7] for a in self.layout.object_qpos])

    def object_in_tool(self, index: int) -> np.ndarray:
        """Position of an object in the tool's frame [m]."""
        site = self.layout.tool_site
        offset = self.data.xpos[self.layout.object_bodies[index]] - self.data.site_xpos[site]
        return self.data.site_xmat[site].reshape(3, 3).T @ offset

    def tools(self, every: int) -> list[np.ndarray]:
        """Poses `[7]` of the tool in the last tick: after each `every` steps, and at its end."""
        states = self.last.states[every - 1 :: every][:-1] if self.last else []
        found, site, qpos = [], self.layout.tool_site, self.data.qpos
        for state in [*states, self.state]:
            qpos[:] = state[1 : 1 + self.model.nq]
            mujoco.mj_kinematics(self.model, self.data)
            turn = np.empty(4)
            mujoco.mju_mat2Quat(turn, self.data.site_xmat[site])
            found.append(np.concatenate([self.data.site_xpos[site], turn]))
        return found

    def object_speed(self, index: int) -> float:
        """Largest component of an object's velocity [m/s or rad/s]."""
        dof = 1 + self.model.nq + self.model.body_dofadr[self.layout.object_bodies[index]]
        return float(np.abs(self.state[dof : dof + 6]).max())

    def pads_on(self, index: int) -> bool:
        """Do the fingers touch an object now?"""
        return self.last is not None and bool(self.last.touching[-1, FINGERS, index])

    def opening(self) -> float:
        """Of the narrower finger [m]."""
        return min(self.data.qpos[self.model.jnt_qposadr[j]] for j in self.layout.fingers)

    def following_error(self) -> float:
        """How far the arm is from its target [rad]."""
        return float(np.abs(self.data.qpos[list(self.layout.qpos)] - self.target).max())

    def set_object(self, index: int, pose: np.ndarray) -> None:
        """Put an object elsewhere, at rest: a disturbance."""
        address = 1 + self.layout.object_qpos[index]
        self.state[address : address + 7] = pose
        dof = 1 + self.model.nq + self.model.body_dofadr[self.layout.object_bodies[index]]
        self.state[dof : dof + 6] = 0.0

    def chunks(self, q: np.ndarray, velocity: np.ndarray, grip: float) -> list[Chunk]:
        """Joint targets `[step, joint]` and a gripper command, cut into ticks.

        The last target is held until its tick ends. The servos damp the joint's own velocity;
        feeding the wanted one forward takes their lag.
        """
        missing = -len(q) % self.tick
        q = np.concatenate([q, np.repeat(q[-1:], missing, axis=0)])
        velocity = np.concatenate([velocity, np.zeros((missing, q.shape[1]))])
        rows = np.zeros((len(q), self.model.nu + self.model.neq))
        rows[:, self.servos] = q + self.lag * velocity
        if self.layout.gripper_actuator >= 0:
            rows[:, self.layout.gripper_actuator] = grip
        parts = (slice(i, i + self.tick) for i in range(0, len(q), self.tick))
        return [Chunk(rows[part], q[part]) for part in parts]

    def step(self, chunk: Chunk, allowed: np.ndarray) -> Steps:
        """Physics for one tick; contacts other than those `allowed` are noted."""
        chunk.commands[:, self.model.nu :] = self.welded
        self.accept((yield Roll(self, chunk.commands)), allowed)
        self.target = chunk.targets[-1]
        self.travelled.append(chunk.targets)

    def accept(self, rolled: Rolled, allowed: np.ndarray) -> None:
        """Take over what the engine did; note contacts that should not be.

        Raises:
            BlownUp: states that are not finite, or an engine that started anew.
        """
        wanted = self.time + len(rolled.states) * self.dt
        if not np.isfinite(rolled.states).all() or abs(rolled.states[-1, 0] - wanted) > 1e-6:
            raise BlownUp(f"the simulation blew up after {self.time:.2f} s")
        before, self.state, self.last = self.time, rolled.states[-1].copy(), rolled
        self.data.qpos[:] = self.state[1 : 1 + self.model.nq]
        mujoco.mj_kinematics(self.model, self.data)
        self.frames.append(self.data.qpos.astype(np.float32))
        known = {(touch.mover, touch.thing) for touch in self.touches[self.counted :]}
        for mover, thing in np.argwhere((rolled.touching & ~allowed).any(axis=0)):
            names = self.sensed.movers[mover], self.sensed.things[thing]
            if names not in known:
                step = int(np.argmax(rolled.touching[:, mover, thing]))
                self.touches.append(Touch(before + (step + 1) * self.dt, *names))

    def resting(self, index: int) -> np.ndarray:
        """`[mover, thing]` the contacts that may be while no object is carried.

        The fingers may touch the object that they reach for or leave; objects touch what they lie
        on.
        """
        allowed = np.zeros((len(self.sensed.movers), len(self.sensed.things)), bool)
        allowed[OBJECTS:] = True
        allowed[FINGERS, index] = True
        return allowed
