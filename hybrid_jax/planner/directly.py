# SPDX-License-Identifier: MIT
"""The joint-space agent alone: from key pose to key pose, without demonstrations.

The paper's "DRL" method. It has no skills, so between gripper events it goes straight for the
next configuration in one piece.
"""

import jax
import jax.numpy as jnp
import numpy as np

from hybrid_jax.planner import pipeline, timing
from hybrid_jax.planner.harvest import PhaseOptions
from hybrid_jax.planner.labelling import end_branches
from hybrid_jax.planner.lfd import phase_cell
from hybrid_jax.skills.task import Task
from hybrid_jax.types import Status


def joint_agent_only(planner: pipeline.Planner, task: Task, *, key) -> pipeline.PlanResult:
    """Plan a task with the joint agent alone; checked like every plan."""
    if planner.bridge is None:
        raise ValueError("the planner has no joint agent")
    phases, start = [], np.asarray(planner.cell.home)
    for phase, (low, high) in enumerate(task.phases):
        carrying = task.carrying[low]
        placed = not carrying and any(task.carrying[:low])
        cell = phase_cell(planner.cell, task, carrying, placed)
        key_ik, key_drl = jax.random.split(jax.random.fold_in(key, phase))
        if high == len(task.carrying):
            goals = np.asarray(cell.home)[None]
        else:
            found, free = end_branches(
                cell,
                jnp.asarray(task.key_poses[high]),
                jnp.asarray(start),
                key=key_ik,
                config=planner.config.labels,
            )
            goals = np.asarray(found)[np.asarray(free)]
        if not len(goals):
            return pipeline.PlanResult(Status.TASK_INFEASIBLE, f"phase {phase}: no configuration")
        goal = goals[np.abs(goals - start).max(axis=1).argmin()]
        path = planner.bridge(cell.scene, start, goal, key_drl)
        if path is None:
            return pipeline.PlanResult(
                Status.DRL_TIMEOUT, f"phase {phase}: {Status.DRL_TIMEOUT.sentence}"
            )
        short = timing.shortcut(
            cell,
            timing.densify(path, planner.config.finishing.spacing),
            planner.config.labels.margin,
            planner.config.finishing,
        )
        options = PhaseOptions(cell, task.key_poses[low : high + 1], [])
        trajectory = pipeline.finish(planner, options, short, np.ones(len(short), np.uint8))
        if trajectory is None:
            return pipeline.PlanResult(Status.SEAM_FAILED, f"phase {phase}: smoothing failed")
        faults = pipeline.find_faults(planner, task, phase, options, trajectory)
        if faults:
            return pipeline.PlanResult(Status.COLLISION, f"phase {phase}: {'; '.join(faults)}")
        phases.append(trajectory)
        start = trajectory.positions[-1].astype(np.float32)
    return pipeline.PlanResult(Status.OK, Status.OK.sentence, phases)
