# SPDX-License-Identifier: MIT
"""Joint paths along tool poses, and which of their points are feasible.

These are the paper's FJ and not-FJ (section "Hybrid Motion Planning with RL based Switching
Agent"). Every key pose has a few candidate configurations. From each of them one joint path
follows the next unit segment, and another follows the segment before, backwards.
`planner.branch_selection` chooses among them over the whole task at once. All tasks of a batch are
labelled together: the host leads through three programs (inverse kinematics, tracking, clearance)
that tasks of any number and every judge share, and measures only what can still matter.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Float, PRNGKeyArray

from hybrid_jax.ik import track_paths
from hybrid_jax.planner.key_pose_ik import Judge, PathIkConfig, draw_seeds, find_candidates
from hybrid_jax.types import Record, Scene, Workcell, pytree


@pytree
class Labels(Record):
    """Candidates of the key poses of one task and the joint paths between them, on the host."""

    candidates: np.ndarray
    """`[key pose, candidate, joint]` configurations [rad or m]."""
    usable: np.ndarray
    """`[key pose, candidate]` True if feasible in the scenes before and after the key pose."""
    reached: np.ndarray
    """`[key pose - 1]` True if inverse kinematics has a solution, whatever its clearance. The
    start has no entry, and neither has an end that is given as a configuration."""
    kept: np.ndarray
    """`[segment, candidate]` True if the path from a candidate is feasible and ends in the
    candidate of the same number at the next key pose."""
    ahead: np.ndarray
    """`[segment, candidate, point, joint]` paths from the candidates of the first key pose."""
    ahead_ok: np.ndarray
    """`[segment, candidate, point]` True up to the first point at which such a path is infeasible,
    or its candidate unusable."""
    back: np.ndarray
    """`[segment, candidate, point, joint]` paths to the candidates of the last key pose, in the
    order of the poses."""
    back_ok: np.ndarray
    """`[segment, candidate, point]` the same for these, from their last points backwards."""


def _follow(
    judge: Judge, scene: np.ndarray, poses: np.ndarray, starts: np.ndarray, usable: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Follow tool poses from configurations, as far as that is feasible.

    Args:
        judge: what points are judged by.
        scene: `[path]` number of the scene of each path.
        poses: `[path, point, 8]` tool poses, unit dual quaternions.
        starts: `[path, joint]` configurations near the first poses [rad or m].
        usable: `[path]` whether it matters what comes of it.

    Returns:
        Joint paths `[path, point, joint]` [rad or m], and `[path, point]` True up to the first
        point that is infeasible.
    """
    config, used = judge.config, np.flatnonzero(usable)
    q = np.repeat(starts[:, None], poses.shape[1], axis=1)
    ok = np.zeros(q.shape[:2], bool)
    if not used.size:
        return q, ok
    q[used], reached, manipulabilities = track_paths(
        judge.cell.chain, poses[used], starts[used], config.tracking
    )
    # the step from the start to the first point counts too
    jump = np.abs(np.diff(q, axis=1, prepend=starts[:, None])).max(axis=-1)
    ok[used] = reached & judge.is_dexterous(manipulabilities) & (jump[used] <= config.max_jump)
    ok = np.logical_and.accumulate(ok, axis=1)
    number = np.arange(ok.shape[1])
    near_key_pose = np.minimum(number, ok.shape[1] - 1 - number) < config.near_key
    margin = np.where(near_key_pose, config.key_margin, config.margin)
    path, point = np.nonzero(ok)
    ok[path, point] = judge.keep(scene[path], q[path, point], margin[point])
    return q, np.logical_and.accumulate(ok, axis=1)


@dataclass(frozen=True)
class _Ends:
    """Candidates of inverse kinematics at the ends of the unit segments of several tasks."""

    q: np.ndarray
    """`[task, segment, candidate, joint]` configurations [rad or m]."""
    usable: np.ndarray
    """`[task, segment, candidate]` which of them are usable."""
    reached: np.ndarray
    """`[task, key pose]` see `Labels.reached`."""
    fixed: np.ndarray
    """`[segment]` True where a segment must end in its first candidate."""


def _ends(judge: Judge, poses: np.ndarray, ends, key: PRNGKeyArray, numbers) -> _Ends:
    """The ends of all segments; arguments are as those of `label_tasks`."""
    tasks, segments = poses.shape[:2]
    seeds = np.concatenate([draw_seeds(judge, segments, key, number) for number in numbers])
    # after the last segment its own scene stands in for the next one
    before = np.arange(tasks * segments).reshape(tasks, segments)
    after = np.concatenate([before[:, 1:], before[:, -1:]], axis=1)
    around = np.stack([before, after], axis=-1).reshape(-1, 2)
    found = find_candidates(judge, around, poses[:, :, -1].reshape(-1, 8), seeds)
    q, usable, reached = (a.reshape(tasks, segments, *a.shape[1:]) for a in found)
    fixed = np.zeros(segments, bool)
    if ends is not None:
        q[:, -1], usable[:, -1] = ends[:, None], _only_first(tasks, usable.shape[-1])
        fixed[-1], reached = True, reached[:, :-1]
    return _Ends(q, usable, reached, fixed)


def _only_first(tasks: int, candidates: int) -> np.ndarray:
    return np.broadcast_to(np.arange(candidates) == 0, (tasks, candidates))


def label_tasks(
    cell: Workcell,
    scenes: Scene,
    poses: Float[np.ndarray, "task segment point 8"],
    starts: Float[np.ndarray, "task n"],
    ends: Float[np.ndarray, "task n"] | None,
    scale: float,
    key: PRNGKeyArray,
    numbers: Sequence[int],
    config: PathIkConfig,
) -> Labels:
    """Candidates and joint paths of several tasks, with what is feasible of them.

    Forwards all candidates of the first key pose are followed, backwards those of the last. A path
    that is feasible to its end links its candidate to the next key pose: its last configuration is
    a candidate there. Elsewhere a candidate from inverse kinematics takes its place.

    Args:
        cell: robot and fixtures.
        scenes: of each unit segment, leaves `[task, segment, ...]`.
        poses: `[task, segment, point, 8]` tool poses, unit dual quaternions; the last of a segment
            is the first of the next.
        starts: `[task, joint]` configurations to start from [rad or m].
        ends: `[task, joint]` to end in; None where any configuration of the last pose will do.
        scale: manipulability that counts as 1.
        key: draws the seeds of the search; consumed.
        numbers: `[task]` numbers that make a key for each task.
        config: thresholds.

    Returns:
        Labels on the host, with a leading axis `[task]`.
    """
    tasks, segments = poses.shape[:2]
    count = tasks * segments  # -1 is no size where a cell has no objects
    flat_scenes = jax.tree.map(lambda a: a.reshape(count, *a.shape[2:]), jax.device_get(scenes))
    judge = Judge(cell, flat_scenes, scale, config)
    scene = np.arange(tasks * segments).reshape(tasks, segments)
    found = _ends(judge, poses, ends, key, numbers)
    q, usable, linked, ahead, ahead_ok = _follow_forwards(judge, scene, poses, starts, found)
    back, back_ok = _follow_segments(judge, scene, poses[:, :, ::-1], q[:, 1:], usable[:, 1:])
    # back to the order of the poses
    back, back_ok = back[:, :, :, ::-1], back_ok[:, :, :, ::-1]
    return Labels(q, usable, found.reached, linked, ahead, ahead_ok, back, back_ok)


def _follow_forwards(judge: Judge, scene: np.ndarray, poses: np.ndarray, starts, found: _Ends):
    """The candidates of all key poses, and the paths from them to the next ones.

    Args:
        judge: what points are judged by.
        scene: `[task, segment]` number of the scene of each segment.
        poses: `[task, segment, point, 8]` tool poses.
        starts: `[task, joint]` configurations to start from [rad or m].
        found: candidates from inverse kinematics.

    Returns:
        `candidates`, `usable`, `kept`, `ahead` and `ahead_ok` as in `Labels`.
    """
    tasks, segments, candidates = found.usable.shape
    q = np.repeat(np.asarray(starts, np.float32)[:, None], candidates, axis=1)
    key_poses, legs = [(q, _only_first(tasks, candidates))], []
    for number in range(segments):
        path, ok = _follow_segments(judge, scene[:, number], poses[:, number], *key_poses[-1])
        beyond = scene[:, min(number + 1, segments - 1)]
        linked = _links(judge, found, number, beyond, path, ok)
        key_poses.append(_continued(found, number, path, linked))
        legs.append((linked, path, ok))
    return [np.stack(rows, axis=1) for rows in (*zip(*key_poses), *zip(*legs))]  # noqa: B905


def _follow_segments(judge: Judge, scene, poses, starts, usable):
    """`_follow` for leading axes of any number; each segment has several candidates.

    Args:
        judge: what points are judged by.
        scene: `[...]` number of the scene of each segment.
        poses: `[..., point, 8]` tool poses.
        starts: `[..., candidate, joint]` configurations [rad or m].
        usable: `[..., candidate]` which of them matter.

    Returns:
        Paths `[..., candidate, point, joint]`, and `[..., candidate, point]` what is feasible.
    """
    candidates = usable.shape[-1]
    rows = np.repeat(np.arange(scene.size), candidates)
    flat_poses = poses.reshape(-1, *poses.shape[-2:])
    flat_starts = starts.reshape(-1, starts.shape[-1])
    path, ok = _follow(
        judge, scene.reshape(-1)[rows], flat_poses[rows], flat_starts, usable.reshape(-1)
    )
    return path.reshape(*usable.shape, *path.shape[1:]), ok.reshape(*usable.shape, -1)


def _links(judge: Judge, found: _Ends, number: int, beyond, path, ok) -> np.ndarray:
    """Which paths `[task, candidate]` of a segment link its candidates to the next key pose."""
    link, last = ok.all(axis=-1), path[:, :, -1]
    if found.fixed[number]:
        # the end of a task may be one configuration, not any that has its pose
        away = np.abs(last - found.q[:, number]).max(axis=-1)
        link &= away <= judge.config.arrived
    task, candidate = np.nonzero(link)
    link[task, candidate] = judge.keep(beyond[task], last[task, candidate], judge.config.key_margin)
    return link


def _continued(found: _Ends, number: int, path, link) -> tuple[np.ndarray, np.ndarray]:
    """Candidates after a segment `[task, candidate, joint]`, and which of them are usable."""
    q, usable = found.q[:, number], found.usable[:, number]
    if found.fixed[number]:
        return q, usable
    return np.where(link[..., None], path[:, :, -1], q), link | usable
