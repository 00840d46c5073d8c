# SPDX-License-Identifier: MIT
"""RL-LfD as the paper executes it: inverse kinematics along the skills' path, without any check.

Where a pose is out of reach the arm comes as near as it can, and collisions do not matter. This is
for comparison only: `plan_motion` returns no such trajectory.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from hybrid_jax.contracts import PlanResult
from hybrid_jax.ik import IkConfig, track_poses
from hybrid_jax.kernels.argument_checks import single_precision
from hybrid_jax.planner.lfd import skill_paths
from hybrid_jax.planner.records import Planner
from hybrid_jax.planner.unchecked_timing import executable
from hybrid_jax.tasks.task import Task
from hybrid_jax.types import Source, Status

TRACKING = IkConfig(iterations=12)
"""Inverse kinematics along a path, each point from the one before."""
_track = jax.jit(lambda cell, poses, start: track_poses(cell, poses, start, TRACKING)[0])


@single_precision
def follow_skills(planner: Planner, tasks: Sequence[Task], *, key) -> list[PlanResult]:
    """Unchecked trajectories along the skills' paths of tasks.

    Args:
        planner: cell, skills, chooser and speeds.
        tasks: what is to be done.
        key: not used: nothing is drawn.

    Returns:
        One result for each task: trajectories with positions `[point, joint]` [rad or m], or the
        demonstration that is missing.
    """
    del key
    task_paths = skill_paths(planner.library, list(tasks), planner.choose, planner.config.skills)
    return [_follow(planner, task, paths[0]) for task, paths in zip(tasks, task_paths, strict=True)]


def _follow(planner: Planner, task: Task, path) -> PlanResult:
    """Trajectories along the skills' path of one task."""
    if not path.plan:
        missing = "; ".join(map(str, path.missing))
        return PlanResult(Status.NEED_DEMO, f"record a demonstration for {missing}")
    segments, points = path.poses.shape[:2]
    start = jnp.asarray(task.start, jnp.float32)
    q = np.asarray(_track(planner.cell, jnp.asarray(path.poses).reshape(-1, 8), start))
    q = q.reshape(segments, points, -1)
    phases, begin = [], np.asarray(task.start, float)
    for number, (low, high) in enumerate(task.phases):
        way_points = np.concatenate([begin[None], q[low:high].reshape(-1, q.shape[-1])])
        marks = np.full(len(way_points), Source.LFD, np.uint8)
        # nothing is measured: corners stay as they were demonstrated
        phases.append(executable(planner, None, way_points, marks, task.tool_speed(number)))
        # the next phase begins exactly where this one ends
        begin = phases[-1].positions[-1]
    names = [planner.library.names[k] for _, _, k in path.plan]
    return PlanResult(Status.OK, "the skills' path, not checked", phases, names)
