# SPDX-License-Identifier: MIT
"""Lay a chosen skill over a segment of a task: which of its points meet which key poses."""

import functools
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels.batching import padded_chunks
from hybrid_jax.skills.distance import BETAS, features
from hybrid_jax.skills.library import SkillConfig, SkillLibrary
from hybrid_jax.skills.mapping import MAPS, resample

TOGETHER = 8
"""Pieces that are mapped in one call."""


def match_indices(
    library: SkillLibrary, key_poses: np.ndarray, a: int, b: int, skill: int, config: SkillConfig
) -> list[int]:
    """Points of a demonstration that stand for key poses a..b: the matching behind the cost."""
    demo = library.poses[skill]
    seen = features(demo)
    starts = jnp.asarray(key_poses[a:b])
    wanted = dq.mul(dq.conj(starts), jnp.broadcast_to(key_poses[b], starts.shape))
    terms = np.asarray(BETAS[config.distance](wanted.T[:, :, None], seen.T[:, None]))
    best, choice = np.full(terms.shape, np.inf), np.zeros(terms.shape, int)
    best[0, 0] = terms[0, 0]
    for r in range(1, len(terms)):
        for i in range(1, terms.shape[1]):
            choice[r, i] = int(np.argmin(best[r - 1, :i]))
            best[r, i] = terms[r, i] + best[r - 1, choice[r, i]]
    index = [int(np.argmin(best[-1]))]
    for r in range(len(terms) - 1, 0, -1):
        index.append(int(choice[r, index[-1]]))
    return index[::-1] + [demo.shape[0] - 1]


@dataclass(frozen=True)
class Piece:
    """Part of a demonstration between two of its points, and the key poses it is to join."""

    skill: int
    low: int
    high: int
    start: np.ndarray
    """`[8]`."""
    goal: np.ndarray
    """`[8]`."""


def cut_segment(
    library: SkillLibrary, key_poses: np.ndarray, a: int, b: int, skill: int, config: SkillConfig
) -> list[Piece]:
    """The piece of a skill for each unit segment of key poses a..b.

    A skill that covers several unit segments is cut where it passes the key poses, so that each
    of them is met exactly.
    """
    whole = [0, library.poses.shape[1] - 1]
    cuts = whole if b == a + 1 else match_indices(library, key_poses, a, b, skill, config)
    return [
        Piece(skill, low, high, key_poses[a + k], key_poses[a + k + 1])
        for k, (low, high) in enumerate(zip(cuts[:-1], cuts[1:], strict=True))
    ]


def map_pieces(
    library: SkillLibrary, pieces: list[Piece], config: SkillConfig, points: int
) -> Float[np.ndarray, "piece points 8"]:
    """Tool poses of pieces, mapped onto their key poses; those of many tasks in few calls."""
    columns = [np.array([getattr(p, name) for p in pieces]) for name in
               ("skill", "low", "high", "start", "goal")]  # fmt: skip
    found = [np.zeros((0, points, 8), np.float32)]
    for index, count in padded_chunks(len(pieces), TOGETHER):
        rows = (column[index] for column in columns)
        found.append(np.asarray(_map_pieces(library.poses, *rows, config.map, points))[:count])
    return np.concatenate(found)


def _map_piece(
    demos: Array, skill: Array, low: Array, high: Array, start: Array, goal: Array,
    mapping: str, points: int,
) -> Float[Array, "points 8"]:  # fmt: skip
    """Map the part of a demonstration between two of its points; the rest collapses onto them."""
    inside = jnp.clip(jnp.arange(demos.shape[1]), low, high)
    return MAPS[mapping](resample(demos[skill, inside], points), start, goal)


@functools.partial(jax.jit, static_argnums=(6, 7))
def _map_pieces(demos, skill, low, high, start, goal, mapping: str, points: int) -> Array:
    one = functools.partial(_map_piece, mapping=mapping, points=points)
    return jax.vmap(one, (None, 0, 0, 0, 0, 0))(demos, skill, low, high, start, goal)
