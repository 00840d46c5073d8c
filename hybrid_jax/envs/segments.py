# SPDX-License-Identifier: MIT
"""Problems of the joint agent: from one configuration to another, each in its own scene."""

import jax
import jax.numpy as jnp
import numpy as np

from hybrid_jax.contracts import Segments, take
from hybrid_jax.errors import SegmentError
from hybrid_jax.kernels.collision.clearance import clearance
from hybrid_jax.kernels.collision.motion_validation import (
    FAR_ENOUGH,
    clearances_in_scenes,
)
from hybrid_jax.types import Scene, Workcell

PAIRS = 4096
"""Number of random start/goal pairs from the whole work space."""
ROOM = 0.01
"""Least clearance of the ends of these pairs [m]."""


def single_segment(scene: Scene, start, goal) -> Segments:
    """One problem with ends `[joint]` [rad], as segments with a leading axis of 1."""
    rows = jax.tree.map(lambda a: jnp.asarray(a)[None], (scene, start, goal))
    return Segments(*rows)


def join(parts: list[Segments]) -> Segments:
    """Several sets of segments, concatenated along the leading axis."""
    return jax.tree.map(lambda *a: jnp.concatenate(a), *parts)


def free_pairs(cell: Workcell, scenes: Segments, count: int = PAIRS) -> Segments:
    """Random start/goal pairs from the whole work space, free in their scene.

    Every joint is within half a turn of home: further turns would only repeat poses.

    Args:
        cell: robot and fixtures.
        scenes: segments whose scenes are drawn from.
        count: how many pairs.

    Returns:
        Segments with ends `[count, joint]` [rad].
    """
    rng, home = np.random.default_rng(0), np.asarray(cell.home)
    low, high = np.asarray(cell.joint_limits, np.float32).T
    low, high = np.maximum(low, home - np.pi), np.minimum(high, home + np.pi)
    gap = jax.jit(jax.vmap(lambda scene, q: clearance(cell.replace(scene=scene), q)))
    batches, size = [], 0
    while size < count:
        # always `PAIRS` samples at once, so that `gap` compiles once
        index = rng.integers(0, scenes.start.shape[0], PAIRS)
        scene = take(scenes, index).scene
        ends = rng.uniform(low, high, (2, PAIRS, len(low))).astype(np.float32)
        free = np.flatnonzero(np.all([gap(scene, q) > ROOM for q in ends], axis=0))
        batches.append(take(Segments(scene, *jnp.asarray(ends)), free))
        size += len(free)
    return take(join(batches), slice(count))


def with_room(cell: Workcell, segments: Segments, margin: float) -> Segments:
    """The segments whose ends have at least a clearance of `margin` [m].

    An agent that keeps the margin cannot reach the ends of the others.

    Args:
        cell: robot and fixtures.
        segments: with ends `[segment, joint]` [rad].
        margin: [m].
    """
    indices = np.arange(len(segments.start))
    gaps = [
        clearances_in_scenes(cell, segments.scene, indices, np.asarray(q), FAR_ENOUGH + margin)
        for q in (segments.start, segments.goal)
    ]
    return take(segments, np.flatnonzero(np.min(gaps, axis=0) >= margin))


def refuse_infeasible(cell: Workcell, segments: Segments, margin: float) -> None:
    """Raise if an end of a segment violates the joint limits or has less clearance than `margin`.

    Args:
        cell: robot and fixtures.
        segments: with ends `[segment, joint]` [rad].
        margin: [m].

    Raises:
        SegmentError: names the segment, its end, and the joint or the clearance.
    """
    low, high = np.asarray(cell.joint_limits).T
    indices = np.arange(len(segments.start))
    for end in ("start", "goal"):
        q = np.asarray(getattr(segments, end))
        gaps = clearances_in_scenes(cell, segments.scene, indices, q, FAR_ENOUGH + margin)
        # a finite difference within float32's rounding is no violation
        outside = ~((q >= low - 1e-5) & (q <= high + 1e-5))
        for i, joint in np.argwhere(outside)[:1]:
            raise SegmentError(
                f"segment {i}: joint {cell.joint_names[joint]!r} of its {end} is {q[i, joint]:.4g},"
                f" outside its limits {low[joint]:.4g} to {high[joint]:.4g}"
            )
        for i in np.flatnonzero(~(gaps >= margin))[:1]:
            raise SegmentError(
                f"segment {i}: the clearance of its {end} is {1000 * gaps[i]:.1f} mm, "
                f"less than the {1000 * margin:.1f} mm to be kept"
            )
