# SPDX-License-Identifier: MIT
"""A bridger alone: from key pose to key pose, without demonstrations.

With the joint agent this is the paper's "DRL" method: the same task, no skills.
"""

from dataclasses import replace

import jax
import numpy as np

from hybrid_jax.agents.segments import single_segment
from hybrid_jax.errors import InputError
from hybrid_jax.keys import fold_in, split
from hybrid_jax.planner import smoothing
from hybrid_jax.planner.checking import Engine
from hybrid_jax.planner.finishing import find_faults, time_path
from hybrid_jax.planner.labelling import find_candidates
from hybrid_jax.planner.records import Planner, PlanResult
from hybrid_jax.planner.refusing import admit, kernels_touch
from hybrid_jax.planner.scenes import inside, task_scenes
from hybrid_jax.planner.turns import plan_in_turns
from hybrid_jax.skills.task import Task
from hybrid_jax.types import Scene, Source, Status


def joint_agent_only(planner: Planner, task: Task, *, key) -> PlanResult:
    """Plan a task with the planner's bridger alone; checked like every plan."""
    if planner.bridge is None:
        raise InputError("the planner has no bridger")
    return plan_in_turns(planner.cell, [task], lambda near: [_plan(planner, near[0], key)])[0]


def _plan(planner: Planner, task: Task, key) -> PlanResult:
    engine = Engine(planner.cell, planner.config.check)
    task, note, refusal = admit(planner.cell, engine, task)
    if refusal:
        return refusal
    scenes = task_scenes(planner.cell, task)
    touched = kernels_touch(inside(planner.cell, scenes, 0), task.start)
    if touched:
        detail = f"the arm collides where it stands: {touched}"
        return PlanResult(Status.START_INVALID, detail)
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


def _goal(planner: Planner, task: Task, scenes: Scene, k: int, start, key):
    """Configuration at a key pose, the nearest to the start; None if there is none."""
    last = len(task.carrying)
    if k == last and task.end is not None:
        return task.end
    around = (k - 1, min(k, last - 1))
    before, after = (jax.tree.map(lambda a, i=i: a[i], scenes) for i in around)
    found, usable, _ = jax.device_get(find_candidates(
        planner.cell, before, after, task.key_poses[k], planner.scale, key,
        planner.config.labels,
    ))  # fmt: skip
    goals = found[usable]
    return goals[np.abs(goals - start).max(axis=1).argmin()] if len(goals) else None


def _way(planner: Planner, bridge, task: Task, scenes: Scene, k: int, start, key):
    """Joint path to key pose k, or why there is none."""
    key_ik, key_bridge = split(key, 2)
    goal = _goal(planner, task, scenes, k, start, key_ik)
    if goal is None:
        return PlanResult(Status.TASK_INFEASIBLE, f"key pose {k}: no configuration was found")
    cell = inside(planner.cell, scenes, k - 1)
    path = bridge(single_segment(cell.scene, start, goal), key_bridge)[0]
    if path is None:
        return PlanResult(
            Status.DRL_TIMEOUT, f"key pose {k - 1} to {k}: {Status.DRL_TIMEOUT.sentence}"
        )
    return smoothing.shortcut(cell, path, planner.config.labels.margin, planner.config.smoothing)


def _plan_phase(
    planner: Planner, bridge, engine, task: Task, scenes: Scene, phase: int, start, key
):
    """The trajectory of one phase, or why there is none."""
    (low, high), config = task.phases[phase], planner.config
    path = np.asarray(start)[None]
    for k in range(low + 1, high + 1):
        way = _way(planner, bridge, task, scenes, k, path[-1].astype(np.float32), fold_in(key, k))
        if isinstance(way, PlanResult):
            return way
        path = np.concatenate([path, way[1:]])
    cell = inside(planner.cell, scenes, low)
    marks = np.full(len(path), Source.DRL, np.uint8)
    # the corners at key poses must stay
    corners = replace(config.smoothing, widths=(config.smoothing.kept, 0.0))
    trajectory = time_path(
        cell, path, marks, corners, config.timing, task.tool_speed(phase)
    )
    if trajectory is None:
        return PlanResult(Status.SEAM_FAILED, f"phase {phase}: {Status.SEAM_FAILED.sentence}")
    faults = find_faults(cell, engine, task, phase, trajectory)
    if faults:
        return PlanResult(Status.COLLISION, f"phase {phase}: {'; '.join(faults)}")
    return trajectory
