# SPDX-License-Identifier: MIT
"""Match a chosen skill to a segment of a task, and map it onto the segment's key poses."""

import functools
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels.batching import padded_chunks
from hybrid_jax.kernels.pose_paths import resample
from hybrid_jax.runtime.kept_programs import kept
from hybrid_jax.skills.feature_distance import BETAS, features
from hybrid_jax.skills.library import SkillConfig, SkillLibrary
from hybrid_jax.skills.mapping import MAPS

PIECES_PER_CALL = 8
"""Number of pieces that are mapped in one call."""


def match_indices(
    library: SkillLibrary, key_poses: np.ndarray, a: int, b: int, skill: int, config: SkillConfig
) -> list[int]:
    """Points of a demonstration that stand for key poses a..b: the matching behind the cost.

    Args:
        library: the skills.
        key_poses: `[pose, 8]` of the task.
        a, b: first and last key pose of the segment.
        skill: number of the skill.
        config: distance of features.

    Returns:
        Number of a point for each key pose, increasing; that of b is the last point.
    """
    demo = library.poses[skill]
    demo_features = features(demo)
    starts = jnp.asarray(key_poses[a:b])
    task_features = dq.mul(dq.conj(starts), jnp.broadcast_to(key_poses[b], starts.shape))
    terms = np.asarray(
        BETAS[config.distance](task_features.T[:, :, None], demo_features.T[:, None])
    )
    least, previous = np.full(terms.shape, np.inf), np.zeros(terms.shape, int)
    # dynamic program: `least[r, i]` is the cheapest matching of features 0..r that ends at point i
    least[0, 0] = terms[0, 0]
    for r in range(1, len(terms)):
        for i in range(1, terms.shape[1]):
            previous[r, i] = int(np.argmin(least[r - 1, :i]))
            least[r, i] = terms[r, i] + least[r - 1, previous[r, i]]
    matched = [int(np.argmin(least[-1]))]
    for r in range(len(terms) - 1, 0, -1):
        matched.append(int(previous[r, matched[-1]]))
    return matched[::-1] + [demo.shape[0] - 1]


@dataclass(frozen=True)
class Piece:
    """Part of a demonstration between two of its points, and the key poses that it is to join."""

    skill: int
    """Number of the skill."""
    low: int
    """First point of the part."""
    high: int
    """Last point of the part."""
    start: np.ndarray
    """`[8]` key pose at which it is to begin."""
    goal: np.ndarray
    """`[8]` key pose at which it is to end."""


def cut_segment(
    library: SkillLibrary, key_poses: np.ndarray, a: int, b: int, skill: int, config: SkillConfig
) -> list[Piece]:
    """The piece of a skill for each unit segment of key poses a..b.

    A skill that covers several unit segments is cut where it passes the key poses, so that each
    of them is met exactly.

    Args:
        library: the skills.
        key_poses: `[pose, 8]` of the task.
        a, b: first and last key pose of the segment.
        skill: number of the skill.
        config: distance of features.
    """
    both_ends = [0, library.poses.shape[1] - 1]
    cuts = both_ends if b == a + 1 else match_indices(library, key_poses, a, b, skill, config)
    return [
        Piece(skill, low, high, key_poses[a + k], key_poses[a + k + 1])
        for k, (low, high) in enumerate(zip(cuts[:-1], cuts[1:], strict=True))
    ]


def map_pieces(
    library: SkillLibrary, pieces: list[Piece], config: SkillConfig, points: int
) -> Float[np.ndarray, "piece points 8"]:
    """Tool poses of pieces, mapped onto their key poses.

    Args:
        library: the skills.
        pieces: of any number of tasks.
        config: name of the map.
        points: how many poses each piece gets.

    Returns:
        `[piece, points, 8]` unit dual quaternions.
    """
    columns = [
        np.array([getattr(p, name) for p in pieces])
        for name in ("skill", "low", "high", "start", "goal")
    ]
    # an empty part first, for the case that there are no pieces
    mapped = [np.zeros((0, points, 8), np.float32)]
    for index, count in padded_chunks(len(pieces), PIECES_PER_CALL):
        arguments = (column[index] for column in columns)
        mapped.append(
            np.asarray(_map_pieces(library.poses, *arguments, config.map, points))[:count]
        )
    return np.concatenate(mapped)


def _map_piece(
    demos: Array,
    skill: Array,
    low: Array,
    high: Array,
    start: Array,
    goal: Array,
    mapping: str,
    points: int,
) -> Float[Array, "points 8"]:
    """Map the part of a demonstration between two of its points.

    The points before and after it collapse onto its ends, so that shapes do not depend on its
    length.
    """
    indices = jnp.clip(jnp.arange(demos.shape[1]), low, high)
    return MAPS[mapping](resample(demos[skill, indices], points), start, goal)


@kept(static=("mapping", "points"))
def _map_pieces(demos, skill, low, high, start, goal, mapping: str, points: int) -> Array:
    map_piece = functools.partial(_map_piece, mapping=mapping, points=points)
    return jax.vmap(map_piece, (None, 0, 0, 0, 0, 0))(demos, skill, low, high, start, goal)
