# SPDX-License-Identifier: MIT
"""Execute a plan in C MuJoCo: track, grip, release, and say what happened."""

from collections.abc import Callable
from dataclasses import dataclass, field

import mujoco
import numpy as np

from hybrid_jax.planner.records import PlanResult
from hybrid_jax.skills.task import Task, require_handling
from hybrid_jax.types import Trajectory, Workcell
from hybrid_jax.workcell.layout import home_qpos, moved_bodies


@dataclass(frozen=True)
class ExecutionConfig:
    """Times and thresholds of an execution."""

    grip_time: float = 0.8
    """Time that closing or opening the gripper takes [s]."""
    dwell: float = 0.3
    """Rest at the end of a phase before the gripper moves [s]."""
    settle: float = 0.6
    """Time that objects get to come to rest at the end [s]."""
    held_within: float = 0.04
    """A held object is lost when it is further than this from where it was gripped [m]."""
    moved_by: float = 0.01
    """Another object counts as disturbed when it moved by more than this [m]."""


@dataclass
class ExecutionReport:
    """What happened to one object's task."""

    placed: bool = False
    """The object lies in its tray, at rest."""
    grasped: bool = False
    """It was still in the gripper at the end of the carrying phase."""
    touched: list[str] = field(default_factory=list)
    """Contacts of the robot or the carried object with the cell, and disturbed objects."""
    tracking_error: float = 0.0
    """Largest joint error while tracking [rad]."""
    object_poses: np.ndarray = field(default_factory=lambda: np.zeros((0, 7)))
    """`[object, 7]` where every object lies afterwards."""
    duration: float = 0.0
    """Simulated time [s]."""

    @property
    def success(self) -> bool:
        """Placed, and nothing else touched."""
        return self.placed and not self.touched


Watcher = Callable[[mujoco.MjData], None]
"""Called after every control step, for pictures."""


class _Run:
    """One execution: model, data and what has been seen so far."""

    def __init__(
        self,
        cell: Workcell,
        task: Task,
        config: ExecutionConfig,
        watch: Watcher | None,
        data: mujoco.MjData | None,
    ):
        self.model, self.layout, self.task = cell.model, cell.source.layout, task
        self.config, self.watch, self.spec = config, watch, require_handling(cell)
        self.data = data if data is not None else start_data(cell, task)
        self.report = ExecutionReport()
        self.object = self.layout.object_names.index(task.object_name)
        self.arm = moved_bodies(self.model, self.layout)
        self.began = self.data.time
        self.carrying = False

    def step(self, q: np.ndarray, grip: float, velocity: np.ndarray | float = 0.0) -> None:
        """One physics step towards a joint target and a gripper command.

        The servos damp the joint's own velocity; feeding the wanted one forward takes their lag.
        """
        servos = list(self.layout.actuators)
        lag = -self.model.actuator_biasprm[servos, 2] / self.model.actuator_gainprm[servos, 0]
        self.data.ctrl[servos] = q + lag * velocity
        self.data.ctrl[self.layout.gripper_actuator] = grip
        mujoco.mj_step(self.model, self.data)
        error = np.abs(self.data.qpos[list(self.layout.qpos)] - q).max()
        self.report.tracking_error = max(self.report.tracking_error, float(error))
        self._look()
        if self.watch:
            self.watch(self.data)

    def _look(self) -> None:
        """Note contacts that should not be."""
        allowed = {self.layout.object_bodies[self.object]}
        support = {self.model.body(name).id for name in self.task.support}
        for contact in self.data.contact[: self.data.ncon]:
            if contact.dist > 0:
                continue
            a, b = (int(self.model.geom_bodyid[g]) for g in contact.geom)
            moving = [self.arm[x] or (self.carrying and x in allowed) for x in (a, b)]
            if moving[0] == moving[1]:
                continue
            mover, other = (a, b) if moving[0] else (b, a)
            wanted = (self.arm[mover] and other in allowed) or (
                mover in allowed and other in support
            )
            if not wanted:
                self._note(f"{self.model.body(mover).name} touched {self.model.body(other).name}")

    def _note(self, text: str) -> None:
        if text not in self.report.touched:
            self.report.touched.append(text)

    def track(self, trajectory: Trajectory, grip: float) -> None:
        """Follow a timed trajectory, then rest."""
        dt = self.model.opt.timestep
        for t in np.arange(0, trajectory.times[-1] + self.config.dwell, dt):
            q, velocity = (
                np.array([np.interp(t, trajectory.times, c) for c in columns.T])
                for columns in (trajectory.positions, trajectory.velocities)
            )
            self.step(q, grip, velocity if t < trajectory.times[-1] else 0.0)

    def hold(self, q: np.ndarray, grip: float, seconds: float) -> None:
        """Keep a configuration while the gripper or the objects move."""
        for _ in range(int(seconds / self.model.opt.timestep)):
            self.step(q, grip)

    def object_in_tool(self) -> np.ndarray:
        """Position of the object in the tool's frame [m]."""
        site = self.layout.tool_site
        offset = self.data.xpos[self.layout.object_bodies[self.object]] - self.data.site_xpos[site]
        return self.data.site_xmat[site].reshape(3, 3).T @ offset

    def poses(self) -> np.ndarray:
        """`[object, 7]` where the objects are."""
        return np.stack([self.data.qpos[a : a + 7].copy() for a in self.layout.object_qpos])

    def in_tray(self) -> bool:
        """Does the object lie in its tray, at rest?"""
        tray = self.spec.tray(self.spec.object(self.task.object_name).tray)
        body = self.model.body(tray.name).id
        local = self.data.xmat[body].reshape(3, 3).T @ (
            self.data.xpos[self.layout.object_bodies[self.object]] - self.data.xpos[body]
        )
        dof = self.model.body_dofadr[self.layout.object_bodies[self.object]]
        slow = np.abs(self.data.qvel[dof : dof + 6]).max() < 0.05
        inside = (np.abs(local[:2]) <= tray.half_size).all() and -0.01 < local[
            2
        ] - tray.floor < 0.06
        return bool(inside and slow)


def start_data(cell: Workcell, task: Task) -> mujoco.MjData:
    """The arm at home, the objects where the task says, the gripper open."""
    model, layout, spec = cell.model, cell.source.layout, require_handling(cell)
    data = mujoco.MjData(model)
    data.qpos[:] = home_qpos(model)
    for address, pose in zip(layout.object_qpos, task.object_poses, strict=True):
        data.qpos[address : address + 7] = pose
    data.ctrl[list(layout.actuators)] = data.qpos[list(layout.qpos)]
    data.ctrl[layout.gripper_actuator] = spec.gripper.open
    mujoco.mj_forward(model, data)
    return data


def execute(
    cell: Workcell,
    task: Task,
    plan: PlanResult,
    config: ExecutionConfig = ExecutionConfig(),
    *,
    watch: Watcher | None = None,
    data: mujoco.MjData | None = None,
) -> ExecutionReport:
    """Execute a plan for one object.

    Args:
        cell: its model is simulated.
        task: the task that was planned.
        plan: with status OK.
        config: times and thresholds.
        watch: called after every step.
        data: simulation to go on with; a fresh one in the task's scene if None.

    Raises:
        ValueError: the plan holds no trajectory, or starts elsewhere than the arm stands.
    """
    if not plan.phases:
        raise ValueError(f"nothing to execute: the plan ended with {plan.status.name}")
    run = _Run(cell, task, config, watch, data)
    away = np.abs(run.data.qpos[list(run.layout.qpos)] - plan.phases[0].positions[0]).max()
    if away > 0.1:
        raise ValueError(f"the arm is {away:.2f} rad away from where the plan starts")
    gripper = run.spec.gripper
    before = run.poses()
    gripped_at = np.zeros(3)
    for phase, trajectory in enumerate(plan.phases):
        run.carrying = task.carrying[task.phases[phase][0]]
        grip = gripper.squeeze if run.carrying else gripper.open
        if phase:
            run.hold(plan.phases[phase - 1].positions[-1], grip, config.grip_time)
        if run.carrying:
            gripped_at = run.object_in_tool()
        run.track(trajectory, grip)
        if run.carrying:
            slip = np.linalg.norm(run.object_in_tool() - gripped_at)
            run.report.grasped = bool(slip < config.held_within)
            run.carrying = False
    run.hold(plan.phases[-1].positions[-1], gripper.open, config.settle)
    report = run.report
    report.placed, report.object_poses = run.in_tray(), run.poses()
    report.duration = run.data.time - run.began
    moved = np.linalg.norm(report.object_poses[:, :3] - before[:, :3], axis=1) > config.moved_by
    for k in np.flatnonzero(moved):
        if k != run.object:
            run._note(f"{run.layout.object_names[k]} was moved")
    return report
