# SPDX-License-Identifier: MIT
"""RL-LfD as the paper executes it: the skills' path by inverse kinematics, whatever it leads into.

Where a pose is out of reach the arm comes as near as it can; nothing is checked for collisions. It
exists to be compared with: `plan_motion` returns no such trajectory.
"""

from collections.abc import Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from hybrid_jax.ik import IkConfig, track_poses
from hybrid_jax.kernels.inputs import single_precision
from hybrid_jax.planner import timing
from hybrid_jax.planner.lfd import skill_paths
from hybrid_jax.planner.records import Planner, PlanResult
from hybrid_jax.planner.smoothing import SmoothingConfig, smooth_paths
from hybrid_jax.skills.task import Task
from hybrid_jax.types import Source, Status, Trajectory

TRACKING = IkConfig(iterations=12)
"""Of the poses of a path, each from the configuration before."""
NO_MARGIN = SmoothingConfig(margin=-1.0, widths=(0.0,))
"""Corners as they were shown."""

_track = jax.jit(lambda cell, poses, start: track_poses(cell, poses, start, TRACKING)[0])


@single_precision
def follow_skills(planner: Planner, tasks: Sequence[Task], *, key) -> list[PlanResult]:
    """Trajectories along the skills' paths of tasks, not checked.

    Args:
        planner: cell, skills, chooser and speeds.
        tasks: what is to be done.
        key: not used: nothing is drawn.
    """
    del key
    found = skill_paths(planner.library, list(tasks), planner.choose, planner.config.skills)
    return [_follow(planner, task, paths[0]) for task, paths in zip(tasks, found, strict=True)]


def _follow(planner: Planner, task: Task, path) -> PlanResult:
    if not path.plan:
        missing = "; ".join(map(str, path.missing))
        return PlanResult(Status.NEED_DEMO, f"record a demonstration for {missing}")
    segments, points = path.poses.shape[:2]
    start = jnp.asarray(task.start, jnp.float32)
    q = np.asarray(_track(planner.cell, jnp.asarray(path.poses).reshape(-1, 8), start))
    q = q.reshape(segments, points, -1)
    phases, begin = [], np.asarray(task.start, float)
    for number, (low, high) in enumerate(task.phases):
        way = np.concatenate([begin[None], q[low:high].reshape(-1, q.shape[-1])])
        phases.append(_timed(planner, way, task.tool_speed(number)))
        begin = phases[-1].positions[-1]
    names = [planner.library.names[k] for _, _, k in path.plan]
    return PlanResult(Status.OK, "the skills' path, not checked", phases, names)


def _timed(planner: Planner, way: np.ndarray, tool_speed: float) -> Trajectory:
    marks = np.full(len(way), Source.LFD, np.uint8)
    free = lambda rows, q, enough: np.full(len(q), np.inf)  # noqa: E731  nothing is measured
    smooth = replace(NO_MARGIN, spacing=planner.config.smoothing.spacing)
    (path,) = smooth_paths(free, [(way, marks)], smooth)
    motion = timing.time_parameterize(
        planner.cell, [path], planner.config.timing, [tool_speed]
    )[0] if path else None  # fmt: skip
    return motion or timing.resting(planner.cell, way[0], way[-1], Source.LFD)
