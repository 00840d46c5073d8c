# SPDX-License-Identifier: MIT
"""Where RL-LfD takes over from the joint agent: the paper's Algorithm 3 with its target area.

The agent leads from D_(i-1) into an area around D_(j+1). From the pose D'_(j+1) where it stops, the
rest of the skill is mapped anew onto the segment's end. The agent is random, so there are many such
poses; the one whose way on has the fewest infeasible points is taken, which is the paper's prime
criterion (section "Hybrid Motion Planning with RL based Switching Agent").
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from hybrid_jax.contracts import Explorer, Segments
from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels.batching import padded_chunks
from hybrid_jax.kernels.kinematics import tool_pose
from hybrid_jax.planner.key_pose_ik import Judge
from hybrid_jax.planner.lfd import POINTS
from hybrid_jax.planner.skill_following import Followed, follow, starting_point
from hybrid_jax.planner.smoothing import at_places
from hybrid_jax.runtime.kept_programs import kept
from hybrid_jax.skills.mapping import MAPS
from hybrid_jax.types import Scene, Workcell

STATES_PER_CALL = 64
"""States of rollouts whose ways on are mapped in one call."""


@dataclass(frozen=True)
class HandoverConfig:
    """How RL-LfD and the joint agent take turns on a segment."""

    radius: float = 0.25
    """Distance of the tool from D_(j+1) within which the agent may stop [m]."""
    tries: int = 4
    """Gaps of a segment for which the agent is called: what is mapped anew may have one again."""
    island: int = 4
    """Feasible stretches with fewer points than this, between infeasible points, are part of the
    gap."""
    clear: float = 0.008
    """Clearance below which a point counts as COL for the switching agent [m]: servos do not keep
    to a path exactly, and the joint agent keeps as much."""
    states: int = 640
    """States of all rollouts in the target area that are considered at most."""


@dataclass(frozen=True)
class Handover:
    """The agent's way over a gap, and how RL-LfD goes on."""

    way: np.ndarray
    """`[point, joint]` from before the gap to where the agent stops [rad or m]."""
    rest: Followed
    """The rest of the skill, mapped anew, from that configuration on."""


@kept(static=("mapping",))
def _mapped(rest, starts, mapping: str):
    """The poses `[point, 8]` from new starts `[n, 8]` to their own end: `[n, point, 8]`."""
    return jax.vmap(MAPS[mapping], (None, 0, None))(rest, starts, rest[-1])


@kept
def _tool_poses(cell: Workcell, q):
    """Tool poses `[n, 8]` at configurations `[n, joint]`."""
    return jax.vmap(tool_pose, (None, 0))(cell, q)


def _resampled(poses: np.ndarray) -> np.ndarray:
    """A path of poses `[point, 8]` with `POINTS` points, evenly spaced by number."""
    places = np.linspace(0.0, len(poses) - 1.0, POINTS)
    signs = np.cumprod(np.where(np.sum(poses[1:, :4] * poses[:-1, :4], axis=1) < 0, -1.0, 1.0))
    aligned = poses * np.concatenate([[1.0], signs])[:, None]
    # neighbours are close: the normalised chord is the screw between them
    return np.asarray(dq.normalize(jnp.asarray(at_places(aligned, places), jnp.float32)))


def _in_batches(function, q: np.ndarray) -> np.ndarray:
    """A function of rows `[n, joint]`, in calls of one size."""
    parts = [
        np.asarray(function(q[index]))[:count]
        for index, count in padded_chunks(len(q), STATES_PER_CALL)
    ]
    return np.concatenate(parts)


def _distances(cell: Workcell, rollouts: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Distance `[rollout, point]` [m] of the tool from a pose `[8]` on rollouts `[..., joint]`."""
    flat = rollouts.reshape(-1, rollouts.shape[-1])
    poses = _in_batches(lambda q: _tool_poses(cell, q), flat)
    away = dq.position(jnp.asarray(poses)) - dq.position(jnp.asarray(centre))
    return np.linalg.norm(np.asarray(away), axis=1).reshape(rollouts.shape[:2])


def nearest_state(
    cell: Workcell, rollouts: np.ndarray, centre: np.ndarray, config: HandoverConfig
) -> tuple[int, int]:
    """The first state in the target area of a rollout, else the one that comes nearest.

    Args:
        cell: the robot.
        rollouts: `[rollout, point, joint]` [rad or m].
        centre: `[8]` pose in the middle of the target area.
        config: its radius.

    Returns:
        Number of the rollout and of its point.
    """
    away = _distances(cell, rollouts, centre)
    first = np.where(away < config.radius, np.arange(away.shape[1]), away.shape[1]).min(axis=1)
    rollout = int(np.argmin(first))
    if first[rollout] < away.shape[1]:
        return rollout, int(first[rollout])
    i, k = np.unravel_index(np.argmin(away), away.shape)
    return int(i), int(k)


def _in_target_area(
    cell: Workcell, rollouts: np.ndarray, centre: np.ndarray, config: HandoverConfig
) -> list[tuple[int, int]]:
    """States of rollouts `[rollout, point, joint]` in the target area around a pose `[8]`.

    Returns:
        Number of the rollout and of the point of each, without repeated states.
    """
    inside = _distances(cell, rollouts, centre) < config.radius
    # a state that repeats the last one, as after a blocked move, is no other state
    inside[:, 1:] &= np.abs(np.diff(rollouts, axis=1)).max(axis=2) > 1e-6
    found = np.argwhere(inside)
    chosen = np.linspace(0, len(found) - 1, min(config.states, len(found))).round().astype(int)
    return [(int(i), int(k)) for i, k in found[chosen]]


def hand_over(
    judge: Judge,
    scene: Scene,
    number: int,
    path: Followed,
    gap: tuple[int, int],
    explore: Explorer,
    key: jax.Array,
    config: HandoverConfig,
    mapping: str,
) -> tuple[int, Handover] | None:
    """Let the agent lead over a gap, and choose where RL-LfD goes on.

    Args:
        judge: scenes and thresholds.
        scene: of the segment, without a leading axis.
        number: of that scene in the judge's.
        path: the skill's path, which the arm cannot follow all along.
        gap: numbers of its first and last infeasible point; the last is not the path's end.
        explore: rollouts of the agent.
        key: consumed.
        config: target area.
        mapping: name of the map of skills.

    Returns:
        The point of the path that the agent starts from, and the hand-over with the fewest
        infeasible points behind it, the shortest of these; None if no rollout comes near.
    """
    begin = starting_point(path, gap[0])
    goal, rest = gap[1] + 1, _resampled(path.poses[gap[1] + 1 :])
    ends = path.q[begin], path.q[goal]
    segment = jax.tree.map(lambda a: np.asarray(a)[None], Segments(scene, *ends))
    rollouts = explore(segment, key)[0]
    states = _in_target_area(judge.cell, rollouts, path.poses[goal], config)
    if not states:
        return None
    q = np.stack([rollouts[state] for state in states])
    poses = _in_batches(lambda q: _mapped(rest, _tool_poses(judge.cell, q), mapping), q)
    ways_on = follow(judge, np.full(len(q), number), poses, q, key_pose_first=False)
    infeasible = [int((~way.feasible).sum()) for way in ways_on]
    lengths = [
        np.abs(np.diff(rollouts[i, : k + 1], axis=0)).sum() + np.abs(np.diff(way.q, axis=0)).sum()
        for (i, k), way in zip(states, ways_on, strict=True)
    ]
    best = int(np.lexsort((lengths, infeasible))[0])
    i, k = states[best]
    way = np.concatenate([path.q[begin][None], rollouts[i, : k + 1]])
    return begin, Handover(way, ways_on[best])
