# SPDX-License-Identifier: MIT
"""From tool poses to joint paths, and which of their points are feasible.

The paper's FJ and not-FJ (section "Hybrid Motion Planning with RL based Switching Agent"). Every
key pose has a few candidate configurations. From each of them a joint path follows the poses of
the next unit segment, and one follows those of the segment before backwards; `planner.routing`
chooses among them over the whole task at once. All tasks of a batch are labelled in one program.
"""

import functools
from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, PRNGKeyArray

from hybrid_jax.ik import IkConfig, solve_ik, track_poses
from hybrid_jax.kernels.collision import clearance_up_to
from hybrid_jax.kernels.kinematics import manipulability
from hybrid_jax.types import Scene, Workcell, pytree


@dataclass(frozen=True)
class LabelConfig:
    """What makes a way point feasible."""

    margin: float = 0.004
    """Clearance to keep [m], ..."""
    key_margin: float = 0.001
    """... and that a key pose, and `near_key` points beside it, must keep: it is what the task asks
    for, and where a gripper works it works close to things."""
    near_key: int = 9
    """Way points."""
    least_manipulability: float = 0.1
    """Smallest `man'`, as a share of the map's scale."""
    max_jump: float = 0.3
    """Largest change of a joint between neighbours on one branch [rad]."""
    candidates: int = 4
    """Configurations of a key pose that are followed, those nearest to home."""
    search: IkConfig = IkConfig(seeds=24, iterations=50)
    """Search for them."""
    tracking: IkConfig = IkConfig(iterations=4)
    """Following a path."""
    arrived: float = 1e-3
    """A path that must end in one configuration has done so this near to it [rad]."""


@pytree
class Labels:
    """Candidates of the key poses of one task and the joint paths between them."""

    candidates: Array
    """`[key pose, candidate, joint]`."""
    usable: Array
    """`[key pose, candidate]` feasible in the scenes before and after the key pose."""
    reached: Array
    """`[key pose]` an arm without limits on clearance and manipulability could be there."""
    kept: Array
    """`[segment, candidate]` the path from a candidate is feasible and ends in the candidate of
    the same number of the next key pose."""
    ahead: Array
    """`[segment, candidate, point, joint]` from the candidates of the segment's first pose."""
    ahead_ok: Array
    """`[segment, candidate, point]` is the point feasible?"""
    back: Array
    """`[segment, candidate, point, joint]` from those of its last, in the order of the poses."""
    back_ok: Array
    """`[segment, candidate, point]`."""


def _judge(
    cell: Workcell, q: Array, margin: float | Array, scale: Array, config: LabelConfig
) -> Array:
    """Which configurations `[point, joint]` are feasible."""
    gap = jax.vmap(lambda one: clearance_up_to(cell, one, config.margin))(q)
    man = jax.vmap(manipulability, (None, 0))(cell, q)
    return (gap >= margin) & (man >= config.least_manipulability * scale)


def follow(
    cell: Workcell,
    poses: Float[Array, "point 8"],
    start: Float[Array, "n"],
    scale: Array,
    config: LabelConfig,
) -> tuple[Array, Array]:
    """Joint path `[point, joint]` along poses from a configuration; which points are feasible."""
    q, found = track_poses(cell, poses, start, config.tracking)
    jump = jnp.max(jnp.abs(jnp.diff(q, axis=0, prepend=start[None])), axis=-1)
    point = jnp.arange(len(poses))
    beside = jnp.minimum(point, len(poses) - 1 - point) < config.near_key
    margin = jnp.where(beside, config.key_margin, config.margin)
    return q, found & _judge(cell, q, margin, scale, config) & (jump <= config.max_jump)


@functools.partial(jax.jit, static_argnames="config")
def find_candidates(
    cell: Workcell,
    before: Scene,
    after: Scene,
    pose: Float[Array, "8"],
    scale: Array,
    key: PRNGKeyArray,
    config: LabelConfig,
) -> tuple[Array, Array, Array]:
    """Configurations of a key pose, those nearest to home first.

    Returns:
        Candidates `[candidate, joint]`, which of them are feasible in the scenes before and after
        the key pose `[candidate]`, and whether the pose is within reach at all.
    """
    solved = solve_ik(cell, pose, cell.home, config.search, key=key)
    q, both = solved.branches, jax.tree.map(lambda a, b: jnp.stack([a, b]), before, after)

    def judge(scene):
        return _judge(cell.replace(scene=scene), q, config.key_margin, scale, config)

    usable = solved.branch_distinct & jnp.all(jax.vmap(judge)(both), axis=0)
    away = jnp.max(jnp.abs(q - cell.home), axis=-1)
    best = jnp.argsort(jnp.where(usable, away, jnp.inf))[: config.candidates]
    return q[best], usable[best], solved.found


def label(
    cell: Workcell,
    scenes: Scene,
    poses: Float[Array, "segment point 8"],
    start: Float[Array, "n"],
    end: Float[Array, "n"] | None,
    scale: Array,
    key: PRNGKeyArray,
    config: LabelConfig,
) -> Labels:
    """Label one task.

    Args:
        cell: robot and fixtures.
        scenes: of each unit segment.
        poses: of each unit segment; the last of one is the first of the next.
        start: configuration to start from.
        end: configuration to end in; None for any that has the last pose.
        scale: manipulability that counts as 1.
        key: draws the seeds of the search; consumed.
        config: thresholds.
    """
    searched = poses.shape[0] - (end is not None)
    keys, wide = jax.random.split(key, searched), (config.candidates, start.size)
    beyond = jax.tree.map(lambda a: jnp.concatenate([a[1:], a[-1:]]), scenes)
    found, fine, reached = jax.vmap(lambda before, after, pose, key: find_candidates(
        cell, before, after, pose, scale, key, config
    ))(_take(scenes, searched), _take(beyond, searched), poses[:searched, -1], keys)  # fmt: skip
    start, only = jnp.broadcast_to(start, wide), jnp.arange(config.candidates) == 0
    fixed = jnp.zeros(poses.shape[0], bool)
    if end is not None:
        found = jnp.concatenate([found, jnp.broadcast_to(end, (1, *wide))])
        fine, fixed = jnp.concatenate([fine, only[None]]), fixed.at[-1].set(True)
    segments = _Segment(scenes, beyond, poses, found, fine, fixed)
    q, usable, kept, paths, ok = _follow_all(cell, segments, (start, only), scale, config)
    q, usable = (jnp.concatenate([a[None], b]) for a, b in ((start, q), (only, usable)))
    (ahead, back), (ahead_ok, back_ok) = paths, ok
    return Labels(
        q, usable, reached, kept, ahead, ahead_ok, back[:, :, ::-1], back_ok[:, :, ::-1]
    )


@pytree
class _Segment:
    """A unit segment as it is followed; all of them with a leading axis."""

    scene: Scene
    beyond: Scene
    """Scene of the next segment."""
    poses: Array
    """`[point, 8]`."""
    found: Array
    """`[candidate, joint]` candidates of its end that the search found, ..."""
    fine: Array
    """... and which of them are usable."""
    fixed: Array
    """Is the first of them the one to end in?"""


def _take(scenes: Scene, count: int) -> Scene:
    return jax.tree.map(lambda a: a[:count], scenes)


def _follow_all(
    cell: Workcell, segments: _Segment, first: tuple[Array, Array], scale, config: LabelConfig
):
    """Follow the unit segments one after the other, from all candidates of their first pose, then
    each of them backwards, from those of its last.

    A path that is feasible to its end carries its candidate on to the next key pose; elsewhere
    one that the search found takes its place. Both ways are one loop, for the sake of compilation.

    Args:
        cell: robot and fixtures.
        segments: stacked.
        first: candidates of the start, and which are usable.
        scale, config: thresholds.

    Returns:
        Candidates and which are usable at the end of each segment; which were carried on; paths
        ahead and back, and which of their points are feasible, both along a leading axis.
    """
    count = segments.fixed.shape[0]
    turned = segments.replace(poses=segments.poses[:, ::-1])
    twice = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), segments, turned)
    steps = (twice, jnp.arange(2 * count) % count, jnp.arange(2 * count) >= count)

    def advance(carry, step):
        (q, usable), ends = carry
        part, number, backwards = step
        inside, onward = cell.replace(scene=part.scene), cell.replace(scene=part.beyond)
        begin = jnp.where(backwards, ends[number], q)
        path, ok = jax.vmap(lambda one: follow(inside, part.poses, one, scale, config))(begin)
        there = _judge(onward, path[:, -1], config.key_margin, scale, config)
        # the end of a task may be one configuration, not any that has its pose
        arrived = jnp.max(jnp.abs(path[:, -1] - part.found), axis=-1) <= config.arrived
        kept = usable & jnp.all(ok, axis=-1) & there & (arrived | ~part.fixed)
        after = jnp.where((kept & ~part.fixed)[:, None], path[:, -1], part.found)
        usable = jnp.where(part.fixed, part.fine, kept | part.fine)
        ends = jnp.where(backwards, ends, ends.at[number].set(after))
        return ((after, usable), ends), (after, usable, kept, path, ok)

    carry = first, jnp.zeros_like(segments.found)
    q, usable, kept, path, ok = jax.lax.scan(advance, carry, steps)[1]
    both = (a.reshape(2, count, *a.shape[1:]) for a in (path, ok))
    return q[:count], usable[:count], kept[:count], *both


@functools.partial(jax.jit, static_argnames="config")
def label_tasks(
    cell: Workcell, scenes: Scene, poses: Array, starts: Array, ends: Array | None, scale: Array,
    key, numbers, config: LabelConfig,
) -> Labels:  # fmt: skip
    """`label` for several tasks: what belongs to a task has a leading axis."""
    one = functools.partial(label, config=config)
    keys = jax.vmap(jax.random.fold_in, (None, 0))(key, numbers)
    each = (None, 0, 0, 0, 0, None, 0)
    return jax.vmap(one, each)(cell, scenes, poses, starts, ends, scale, keys)
