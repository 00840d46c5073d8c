# SPDX-License-Identifier: MIT
"""Follow a skill's path by inverse kinematics on one branch, and find its infeasible segments."""

from dataclasses import dataclass

import numpy as np

from hybrid_jax.ik import track_paths
from hybrid_jax.planner.key_pose_ik import Judge
from hybrid_jax.planner.lfd import SkillPath


@dataclass(frozen=True)
class Followed:
    """A path of tool poses that the arm follows, without a check."""

    poses: np.ndarray
    """`[point, 8]` tool poses."""
    q: np.ndarray
    """`[point, joint]` configurations, each from the one before [rad or m]."""
    feasible: np.ndarray
    """`[point]` True where the arm is at the pose, dexterous, and keeps the margin."""
    roomy: np.ndarray
    """`[point]` True where it keeps the margin that holds away from key poses."""


def follow(
    judge: Judge, scene: np.ndarray, poses: np.ndarray, starts: np.ndarray, key_pose_first: bool
) -> list[Followed]:
    """Follow tool poses by inverse kinematics, each point from the one before.

    Args:
        judge: scenes and thresholds.
        scene: `[path]` number of the scene of each path.
        poses: `[path, point, 8]` unit dual quaternions, up to a key pose.
        starts: `[path, joint]` configurations before the first points [rad or m].
        key_pose_first: do the paths begin at a key pose, where less clearance is asked for?

    Returns:
        The followed paths; after a point out of reach they go on from the closest approach.
    """
    config, (count, points) = judge.config, poses.shape[:2]
    q, reached, manipulability = track_paths(
        judge.cell.chain, poses, np.asarray(starts, np.float32), config.tracking
    )
    number = np.arange(points)
    near = number[::-1] < config.near_key
    near |= (number < config.near_key) & key_pose_first
    gap = judge.clearances(np.repeat(scene, points), q.reshape(count * points, -1))
    gap = gap.reshape(count, points)
    ok = reached & judge.is_dexterous(manipulability)
    margins = np.array([config.key_margin, config.margin], np.float32)  # as clearances are
    ok &= gap >= np.where(near, *margins)
    # the step from the start to the first point counts too
    steps = np.diff(q, axis=1, prepend=np.asarray(starts, np.float32)[:, None])
    ok &= np.abs(steps).max(axis=2) <= config.max_jump
    return [Followed(*row) for row in zip(poses, q, ok, gap >= margins[1], strict=True)]


def first_gap(feasible: np.ndarray, island: int) -> tuple[int, int] | None:
    """The first infeasible segment (i, j) of a path; None if there is none.

    Args:
        feasible: `[point]`.
        island: feasible stretches of fewer points do not end it.
    """
    infeasible = np.flatnonzero(~feasible)
    if not infeasible.size:
        return None
    ends = np.flatnonzero(np.diff(infeasible) > island)
    last = infeasible[ends[0]] if ends.size else infeasible[-1]
    return int(infeasible[0]), int(last)


def starting_point(path: Followed, first: int) -> int:
    """D_(i-1): the last point before a gap with room for the agent, or the one right before it."""
    roomy = np.flatnonzero(path.roomy[:first] & path.feasible[:first])
    return int(roomy[-1]) if roomy.size else max(first - 1, 0)


def follow_all(judge: Judge, path: SkillPath, start: np.ndarray) -> list[Followed]:
    """All segments of a skill path, followed one after the other from a configuration `[joint]`."""
    followed, q = [], start
    for number, poses in enumerate(path.poses):
        (found,) = follow(judge, np.array([number]), poses[None], q[None], key_pose_first=True)
        followed.append(found)
        q = found.q[-1]
    return followed


def fewest_infeasible(judge: Judge, paths: list[SkillPath], start: np.ndarray) -> SkillPath:
    """The prime criterion: of several traj_LfD, the one with the fewest infeasible points."""
    if len(paths) == 1:
        return paths[0]
    counts = [
        sum(int((~part.feasible).sum()) for part in follow_all(judge, path, start))
        for path in paths
    ]
    return paths[int(np.argmin(counts))]
