# SPDX-License-Identifier: MIT
"""Joint paths along tool poses, and which of their points are feasible.

These are the paper's FJ and not-FJ (section "Hybrid Motion Planning with RL based Switching
Agent"). Every key pose has a few candidate configurations. From each of them one joint path
follows the next unit segment, and another follows the segment before, backwards.
`planner.branch_selection` chooses among them over the whole task at once. All tasks of a batch are
labelled in one program.
"""

import functools
from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, PRNGKeyArray

from hybrid_jax.ik import IkConfig, solve_ik, track_poses
from hybrid_jax.kernels.collision.clearance import clearance_up_to
from hybrid_jax.kernels.kinematics import manipulability
from hybrid_jax.runtime.kept_programs import kept
from hybrid_jax.types import Record, Scene, Workcell, pytree


@dataclass(frozen=True)
class PathIkConfig:
    """Conditions on a feasible way point, and settings of inverse kinematics."""

    margin: float = 0.004
    """Clearance of a way point [m]."""
    key_margin: float = 0.001
    """Clearance of a key pose, and of `near_key` points beside it [m]: the task asks for these
    poses, and where a gripper works it works close to things."""
    near_key: int = 9
    """Number of way points on each side of a key pose for which `key_margin` holds."""
    least_manipulability: float = 0.1
    """Smallest `man'`, as a share of the map's scale."""
    max_jump: float = 0.3
    """Largest change of a joint between neighbouring points of one branch [rad]."""
    candidates: int = 4
    """Number of configurations of a key pose that are followed: those nearest to home."""
    search: IkConfig = IkConfig(seeds=24, iterations=50)
    """Inverse kinematics of key poses."""
    tracking: IkConfig = IkConfig(iterations=4)
    """Inverse kinematics along a path, each point from the one before."""
    arrived: float = 1e-3
    """Largest distance at which a path counts as ending in a given configuration [rad]."""


@pytree
class Labels(Record):
    """Candidates of the key poses of one task and the joint paths between them."""

    candidates: Array
    """`[key pose, candidate, joint]` configurations [rad or m]."""
    usable: Array
    """`[key pose, candidate]` True if feasible in the scenes before and after the key pose."""
    reached: Array
    """`[key pose - 1]` True if inverse kinematics has a solution, whatever its clearance. The
    start has no entry, and neither has an end that is given as a configuration."""
    kept: Array
    """`[segment, candidate]` True if the path from a candidate is feasible and ends in the
    candidate of the same number at the next key pose."""
    ahead: Array
    """`[segment, candidate, point, joint]` paths from the candidates of the first key pose."""
    ahead_ok: Array
    """`[segment, candidate, point]` True where such a path is feasible."""
    back: Array
    """`[segment, candidate, point, joint]` paths to the candidates of the last key pose, in the
    order of the poses."""
    back_ok: Array
    """`[segment, candidate, point]` True where such a path is feasible."""


def _judge(
    cell: Workcell, q: Array, margin: float | Array, scale: Array, config: PathIkConfig
) -> Array:
    """Which configurations `q` `[point, joint]` are feasible: `[point]`."""
    # no margin exceeds `config.margin`: larger clearances need not be told apart
    gaps = jax.vmap(lambda point: clearance_up_to(cell, point, config.margin))(q)
    manipulabilities = jax.vmap(manipulability, (None, 0))(cell, q)
    return (gaps >= margin) & (manipulabilities >= config.least_manipulability * scale)


def follow(
    cell: Workcell,
    poses: Float[Array, "point 8"],
    start: Float[Array, " n"],
    scale: Array,
    config: PathIkConfig,
) -> tuple[Array, Array]:
    """Follow tool poses from a configuration, and judge each point.

    Args:
        cell: robot and scene.
        poses: `[point, 8]` tool poses, unit dual quaternions.
        start: `[joint]` configuration near the first pose [rad or m].
        scale: `[]` manipulability that counts as 1.
        config: thresholds.

    Returns:
        Joint path `[point, joint]` [rad or m], and which of its points are feasible `[point]`.
    """
    q, reached = track_poses(cell, poses, start, config.tracking)
    # the step from `start` to the first point counts too
    jump = jnp.max(jnp.abs(jnp.diff(q, axis=0, prepend=start[None])), axis=-1)
    point = jnp.arange(len(poses))
    near_key_pose = jnp.minimum(point, len(poses) - 1 - point) < config.near_key
    margin = jnp.where(near_key_pose, config.key_margin, config.margin)
    return q, reached & _judge(cell, q, margin, scale, config) & (jump <= config.max_jump)


@functools.partial(jax.jit, static_argnames="config")
def find_candidates(
    cell: Workcell,
    before: Scene,
    after: Scene,
    pose: Float[Array, "8"],
    scale: Array,
    key: PRNGKeyArray,
    config: PathIkConfig,
) -> tuple[Array, Array, Array]:
    """Candidate configurations of a key pose, those nearest to home first.

    Args:
        cell: robot and fixtures.
        before, after: scenes of the segments before and after the key pose.
        pose: `[8]` tool pose, a unit dual quaternion.
        scale: `[]` manipulability that counts as 1.
        key: draws the seeds of the search; consumed.
        config: thresholds.

    Returns:
        Candidates `[candidate, joint]` [rad or m], which of them are feasible in both scenes
        `[candidate]`, and whether the pose is within reach at all `[]`.
    """
    solved = solve_ik(cell, pose, cell.home, config.search, key=key)
    q, scenes = solved.branches, jax.tree.map(lambda a, b: jnp.stack([a, b]), before, after)

    def judge(scene):
        return _judge(cell.replace(scene=scene), q, config.key_margin, scale, config)

    usable = solved.branch_distinct & jnp.all(jax.vmap(judge)(scenes), axis=0)
    distance = jnp.max(jnp.abs(q - cell.home), axis=-1)
    best = jnp.argsort(jnp.where(usable, distance, jnp.inf))[: config.candidates]
    return q[best], usable[best], solved.found


def label(
    cell: Workcell,
    scenes: Scene,
    poses: Float[Array, "segment point 8"],
    start: Float[Array, " n"],
    end: Float[Array, " n"] | None,
    scale: Array,
    key: PRNGKeyArray,
    config: PathIkConfig,
) -> Labels:
    """Candidates and joint paths of one task, with what is feasible of them.

    Args:
        cell: robot and fixtures.
        scenes: of each unit segment, leaves `[segment, ...]`.
        poses: `[segment, point, 8]` tool poses; the last of a segment is the first of the next.
        start: `[joint]` configuration to start from [rad or m].
        end: `[joint]` configuration to end in; None for any that has the last pose.
        scale: `[]` manipulability that counts as 1.
        key: draws the seeds of the search; consumed.
        config: thresholds.

    Returns:
        Labels of the task; their shapes are those of `Labels`.
    """
    count = poses.shape[0] - (end is not None)
    keys, shape = jax.random.split(key, count), (config.candidates, start.size)
    # after the last segment its own scene stands in for the next one
    next_scenes = jax.tree.map(lambda a: jnp.concatenate([a[1:], a[-1:]]), scenes)
    end_q, end_ok, reached = jax.vmap(
        lambda before, after, pose, key: find_candidates(
            cell, before, after, pose, scale, key, config
        )
    )(_take(scenes, count), _take(next_scenes, count), poses[:count, -1], keys)
    start, first_only = jnp.broadcast_to(start, shape), jnp.arange(config.candidates) == 0
    fixed = jnp.zeros(poses.shape[0], bool)
    if end is not None:
        end_q = jnp.concatenate([end_q, jnp.broadcast_to(end, (1, *shape))])
        end_ok, fixed = jnp.concatenate([end_ok, first_only[None]]), fixed.at[-1].set(True)
    segments = _Segment(scenes, next_scenes, poses, end_q, end_ok, fixed)
    q, usable, linked, paths, ok = _follow_all(cell, segments, (start, first_only), scale, config)
    q, usable = (jnp.concatenate([a[None], b]) for a, b in ((start, q), (first_only, usable)))
    (fwd, back), (fwd_ok, back_ok) = paths, ok
    # back to the order of the poses
    return Labels(q, usable, reached, linked, fwd, fwd_ok, back[:, :, ::-1], back_ok[:, :, ::-1])


@pytree
class _Segment(Record):
    """A unit segment as it is followed; stacked, all leaves have a leading axis `[segment]`."""

    scene: Scene
    """Scene of the segment."""
    beyond: Scene
    """Scene of the next segment."""
    poses: Array
    """`[point, 8]` tool poses."""
    found: Array
    """`[candidate, joint]` candidates of its end from inverse kinematics."""
    fine: Array
    """`[candidate]` which of them are usable."""
    fixed: Array
    """`[]` True if the segment must end in the first of them."""


def _take(scenes: Scene, count: int) -> Scene:
    return jax.tree.map(lambda a: a[:count], scenes)


def _follow_all(
    cell: Workcell, segments: _Segment, first: tuple[Array, Array], scale, config: PathIkConfig
):
    """Follow the unit segments forwards, one after the other, and then backwards.

    Forwards all candidates of the first key pose are followed, backwards those of the last. A path
    that is feasible to its end links its candidate to the next key pose: its last configuration is
    a candidate there. Elsewhere a candidate from inverse kinematics takes its place. Both
    directions are one loop, for the sake of compilation.

    Args:
        cell: robot and fixtures.
        segments: stacked.
        first: candidates of the start `[candidate, joint]`, and which are usable `[candidate]`.
        scale, config: thresholds.

    Returns:
        At the end of each segment the candidates, which are usable, and which were linked; then
        the paths, and which of their points are feasible, each `[direction, segment, ...]`.
    """
    count = segments.fixed.shape[0]
    backward_segments = segments.replace(poses=segments.poses[:, ::-1])
    both_ways = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), segments, backward_segments)
    steps = (both_ways, jnp.arange(2 * count) % count, jnp.arange(2 * count) >= count)

    def advance(carry, step):
        (q, usable), ends = carry
        part, number, backwards = step
        local_cell, next_cell = cell.replace(scene=part.scene), cell.replace(scene=part.beyond)
        starts = jnp.where(backwards, ends[number], q)
        path, ok = jax.vmap(lambda q0: follow(local_cell, part.poses, q0, scale, config))(starts)
        next_ok = _judge(next_cell, path[:, -1], config.key_margin, scale, config)
        # the end of a task may be one configuration, not any that has its pose
        arrived = jnp.max(jnp.abs(path[:, -1] - part.found), axis=-1) <= config.arrived
        linked = usable & jnp.all(ok, axis=-1) & next_ok & (arrived | ~part.fixed)
        end_q = jnp.where((linked & ~part.fixed)[:, None], path[:, -1], part.found)
        usable = jnp.where(part.fixed, part.fine, linked | part.fine)
        ends = jnp.where(backwards, ends, ends.at[number].set(end_q))
        return ((end_q, usable), ends), (end_q, usable, linked, path, ok)

    carry = first, jnp.zeros_like(segments.found)
    q, usable, linked, path, ok = jax.lax.scan(advance, carry, steps)[1]
    path_and_ok = (a.reshape(2, count, *a.shape[1:]) for a in (path, ok))
    return q[:count], usable[:count], linked[:count], *path_and_ok


@kept(static=("config",))
def label_tasks(
    cell: Workcell,
    scenes: Scene,
    poses: Array,
    starts: Array,
    ends: Array | None,
    scale: Array,
    key,
    numbers,
    config: PathIkConfig,
) -> Labels:
    """Candidates and joint paths of several tasks, see `label`.

    Args:
        cell: robot and fixtures.
        scenes: leaves `[task, segment, ...]`.
        poses: `[task, segment, point, 8]` tool poses, unit dual quaternions.
        starts: `[task, joint]` [rad or m].
        ends: `[task, joint]` [rad or m]; None where any configuration of the last pose will do.
        scale: `[]` manipulability that counts as 1.
        key: draws the seeds of the search; consumed.
        numbers: `[task]` numbers that make a key for each task.
        config: thresholds.

    Returns:
        Labels with a leading axis `[task]`.
    """
    label_one = functools.partial(label, config=config)
    keys = jax.vmap(jax.random.fold_in, (None, 0))(key, numbers)
    axes = (None, 0, 0, 0, 0, None, 0)
    return jax.vmap(label_one, axes)(cell, scenes, poses, starts, ends, scale, keys)
