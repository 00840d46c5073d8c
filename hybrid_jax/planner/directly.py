# SPDX-License-Identifier: MIT
"""A bridger alone: from gripper event to gripper event, without demonstrations.

With the joint agent this is the paper's "DRL" method. It has no skills, so it goes straight for
the next configuration in one piece.
"""

import jax
import numpy as np

from hybrid_jax.agents.segments import single_segment
from hybrid_jax.keys import fold_in, split
from hybrid_jax.planner import smoothing
from hybrid_jax.planner.checking import Engine
from hybrid_jax.planner.finishing import find_faults, time_path
from hybrid_jax.planner.labelling import find_candidates
from hybrid_jax.planner.records import Planner, PlanResult
from hybrid_jax.planner.refusing import admit
from hybrid_jax.planner.scenes import inside, task_scenes
from hybrid_jax.skills.task import Task
from hybrid_jax.types import Scene, Source, Status


def joint_agent_only(planner: Planner, task: Task, *, key) -> PlanResult:
    """Plan a task with the planner's bridger alone; checked like every plan."""
    if planner.bridge is None:
        raise ValueError("the planner has no bridger")
    engine = Engine(planner.cell, planner.config.check)
    task, note, refusal = admit(planner.cell, engine, task)
    if refusal:
        return refusal
    scenes = task_scenes(planner.cell, task)
    phases, start = [], np.asarray(task.start)
    for phase in range(len(task.phases)):
        key_phase = fold_in(key, phase)
        found = _plan_phase(
            planner, planner.bridge, engine, task, scenes, phase, start, key_phase
        )
        if isinstance(found, PlanResult):
            return found
        phases.append(found)
        start = found.positions[-1].astype(np.float32)
    return PlanResult(Status.OK, f"{Status.OK.sentence} {note}".strip(), phases)


def _goal(planner: Planner, task: Task, scenes: Scene, phase: int, start, key):
    """Configuration at the end of a phase, the nearest to the start; None if there is none."""
    low, high = task.phases[phase]
    if high == len(task.carrying):
        return np.asarray(planner.cell.home)
    before, after = (jax.tree.map(lambda a, i=i: a[i], scenes) for i in (low, high))
    found, usable, _ = jax.device_get(find_candidates(
        planner.cell, before, after, task.key_poses[high], planner.scale, key,
        planner.config.labels,
    ))  # fmt: skip
    goals = found[usable]
    return goals[np.abs(goals - start).max(axis=1).argmin()] if len(goals) else None


def _plan_phase(
    planner: Planner, bridge, engine, task: Task, scenes: Scene, phase: int, start, key
):
    """The trajectory of one phase, or why there is none."""
    key_ik, key_bridge = split(key, 2)
    goal, low = _goal(planner, task, scenes, phase, start, key_ik), task.phases[phase][0]
    if goal is None:
        return PlanResult(Status.TASK_INFEASIBLE, f"phase {phase}: no configuration at its end")
    cell = inside(planner.cell, scenes, low)
    path = bridge(single_segment(cell.scene, start, goal), key_bridge)[0]
    if path is None:
        return PlanResult(
            Status.DRL_TIMEOUT, f"phase {phase}: {Status.DRL_TIMEOUT.sentence}"
        )
    short = smoothing.shortcut(
        cell, path, planner.config.labels.margin, planner.config.smoothing
    )
    marks, config = np.full(len(short), Source.DRL, np.uint8), planner.config
    trajectory = time_path(cell, short, marks, config.smoothing, config.timing)
    if trajectory is None:
        return PlanResult(Status.SEAM_FAILED, f"phase {phase}: {Status.SEAM_FAILED.sentence}")
    faults = find_faults(cell, engine, task, phase, trajectory, passing=False)
    if faults:
        return PlanResult(Status.COLLISION, f"phase {phase}: {'; '.join(faults)}")
    return trajectory
