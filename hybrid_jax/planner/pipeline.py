# SPDX-License-Identifier: MIT
"""The hybrid planner: Algorithm 1 of the paper, online."""

from collections.abc import Callable
from dataclasses import dataclass, field

import jax
import numpy as np
from jax import Array

from hybrid_jax.agents.joint import Bridger
from hybrid_jax.agents.switching import Combined
from hybrid_jax.planner import checking, combining, timing
from hybrid_jax.planner.harvest import PhaseOptions, bridge_ends, phase_options
from hybrid_jax.planner.labelling import Bridge, LabelConfig
from hybrid_jax.planner.lfd import SkillChooser, SkillPath, placed_pose, skill_path
from hybrid_jax.skills.library import SkillConfig, SkillLibrary
from hybrid_jax.skills.task import Task, object_in_tool, require_handling
from hybrid_jax.types import Status, Trajectory, Workcell

Switcher = Callable[[Combined], np.ndarray]
"""Both motions of a phase to the choice at each grid point: 0 skill, 1 joint agent."""


@dataclass(frozen=True)
class PlannerConfig:
    """Settings of the planner."""

    skills: SkillConfig = SkillConfig()
    labels: LabelConfig = LabelConfig()
    finishing: timing.TimingConfig = timing.TimingConfig()
    attempts: int = 8
    """Ways through a phase that are tried, best first."""


@dataclass(frozen=True)
class Planner:
    """A cell with everything that was learned for it. The agents are functions."""

    cell: Workcell
    library: SkillLibrary
    choose: SkillChooser
    """Task planner of RL-LfD."""
    bridge: Bridger | None
    """DRL-Feasibility agent; None plans with skills alone."""
    switch: Switcher
    """Switching agent."""
    scale: float
    """Manipulability that counts as 1 (from the feasibility map)."""
    config: PlannerConfig = PlannerConfig()


@dataclass(frozen=True)
class PlanResult:
    """A plan, or the reason why there is none."""

    status: Status
    detail: str
    """A sentence for people: what failed and where."""
    phases: list[Trajectory] = field(default_factory=list)
    """One timed trajectory for each phase between gripper events; empty unless status is OK."""
    skills: list[str] = field(default_factory=list)
    """Skill of each segment."""

    @property
    def drl_share(self) -> float:
        """Share of the trajectory's points that came from the joint agent."""
        sources = np.concatenate([t.sources for t in self.phases]) if self.phases else np.zeros(1)
        return float(sources.mean())


def plan_motion(planner: Planner, task: Task, *, key: Array) -> PlanResult:
    """Plan a task; every returned trajectory has passed the final check.

    Args:
        planner: cell, skills and agents.
        task: key poses in a scene.
        key: draws IK seeds and rollouts; consumed.
    """
    # Alg. 1, l. 27: call Algorithm 2 to calculate the task-space trajectory traj_LfD
    path = skill_path(planner.library, task, planner.choose, planner.config.skills)
    if not path.plan:
        missing = "; ".join(str(m) for m in path.missing)
        return PlanResult(Status.NEED_DEMO, f"record a demonstration for {missing}")
    names = [planner.library.names[k] for _, _, k in path.plan]
    phases, start = [], np.asarray(planner.cell.home)
    for phase in range(len(path.phases)):
        status, detail, trajectory = _plan_phase(
            planner, task, path, phase, start, jax.random.fold_in(key, phase)
        )
        if status is not Status.OK:
            return PlanResult(status, f"phase {phase}: {detail}", skills=names)
        phases.append(trajectory)
        start = trajectory.positions[-1].astype(np.float32)
    return PlanResult(Status.OK, Status.OK.sentence, phases, names)


def _plan_phase(
    planner: Planner, task: Task, path: SkillPath, phase: int, start: np.ndarray, key: Array
) -> tuple[Status, str, Trajectory | None]:
    """One phase between gripper events: status, sentence, trajectory."""
    key_ik, key_drl = jax.random.split(key)
    # Alg. 1, l. 31-33: inverse kinematics; which segments are feasible (FJ) and which are not
    options = phase_options(
        planner.cell,
        task,
        phase,
        path.phases[phase],
        start,
        planner.scale,
        planner.config.labels,
        key_ik,
    )
    if not options.bridges:
        return Status.TASK_INFEASIBLE, "no collision-free configuration at one of its ends", None
    status, detail = Status.DRL_TIMEOUT, Status.DRL_TIMEOUT.sentence
    for attempt, bridge in enumerate(options.bridges[: planner.config.attempts]):
        # Alg. 1, l. 28-30: call Algorithm 3 on the infeasible segment: traj_DRL
        drl = _joint_motion(planner, options, bridge, jax.random.fold_in(key_drl, attempt))
        if drl is None and bridge.first != bridge.last:
            continue
        # Alg. 1, l. 34-36: concatenate, and let the switching policy choose
        combined = combining.combine(options.cell, bridge, drl, planner.scale)
        q, sources = combining.assemble(combined, planner.switch(combined), bridge, drl)
        trajectory = finish(planner, options, q, sources)
        if trajectory is None:
            status, detail = Status.SEAM_FAILED, Status.SEAM_FAILED.sentence
            continue
        faults = find_faults(planner, task, phase, options, trajectory)
        if not faults:
            return Status.OK, "", trajectory
        status, detail = Status.COLLISION, "; ".join(faults)
    return status, detail, None


def _joint_motion(
    planner: Planner, options: PhaseOptions, bridge: Bridge, key: Array
) -> np.ndarray | None:
    """Way points of the joint agent over the infeasible part; None if there is none to make."""
    if bridge.first == bridge.last or planner.bridge is None:
        return None
    first, last = bridge_ends(bridge)
    drl = planner.bridge(options.cell.scene, bridge.q[first], bridge.q[last], key)
    if drl is None:
        return None
    config = planner.config
    return timing.shortcut(
        options.cell,
        timing.densify(drl, config.finishing.spacing),
        config.labels.margin,
        config.finishing,
    )


def finish(
    planner: Planner, options: PhaseOptions, q: np.ndarray, sources: np.ndarray
) -> Trajectory | None:
    """Smooth and time a path."""
    config = planner.config.finishing
    even = timing.smooth(options.cell, q, config)
    if even is None:
        return None
    nearest = np.abs(even[:, None] - q[None]).max(axis=2).argmin(axis=1)
    return timing.time_parameterize(options.cell, even, sources[nearest], config)


def find_faults(
    planner: Planner, task: Task, phase: int, options: PhaseOptions, trajectory: Trajectory
) -> list[str]:
    """What the final check finds wrong."""
    data = require_handling(planner.cell)
    spec = data.object(task.object_name)
    low, _ = task.phases[phase]
    carrying = task.carrying[low]
    poses = np.array(task.object_poses)
    if not carrying and any(task.carrying[:low]):
        poses[planner.cell.source.layout.object_names.index(task.object_name)] = placed_pose(
            planner.cell, task
        )
    return checking.limit_faults(planner.cell, trajectory) + checking.collision_faults(
        options.cell,
        trajectory,
        task,
        carrying=carrying,
        poses=poses,
        opening=spec.grip if carrying else data.gripper.open,
        held_in_tool=object_in_tool(spec),
    )


def lfd_only(planner: Planner) -> Planner:
    """The same planner without its joint agent: what the skills can do alone."""
    return Planner(
        planner.cell,
        planner.library,
        planner.choose,
        None,
        planner.switch,
        planner.scale,
        planner.config,
    )
