# SPDX-License-Identifier: MIT
"""Lay a chosen skill over a segment of a task: which of its points meet which key poses."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.skills.distance import BETAS
from hybrid_jax.skills.library import SkillConfig, SkillLibrary
from hybrid_jax.skills.mapping import MAPS, resample


def match_indices(
    library: SkillLibrary, key_poses: np.ndarray, a: int, b: int, skill: int, config: SkillConfig
) -> list[int]:
    """Points of a demonstration that stand for key poses a..b: the matching behind the cost."""
    demo = library.poses[skill]
    seen = dq.mul(dq.conj(demo[:-1]), jnp.broadcast_to(demo[-1], demo[:-1].shape))
    distance = jax.vmap(BETAS[config.distance], (None, 0))
    goal = jnp.asarray(key_poses[b])
    terms = np.stack(
        [
            np.asarray(distance(dq.mul(dq.conj(jnp.asarray(key_poses[p])), goal), seen))
            for p in range(a, b)
        ]
    )
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


def map_segment(
    library: SkillLibrary,
    key_poses: np.ndarray,
    a: int,
    b: int,
    skill: int,
    config: SkillConfig,
    points: int,
) -> np.ndarray:
    """Map a skill onto key poses a..b; `points` poses for each unit segment, `[n, 8]`.

    A skill that covers several unit segments is cut where it passes the key poses, so that each
    of them is met exactly.
    """
    whole = [0, library.poses.shape[1] - 1]
    cuts = whole if b == a + 1 else match_indices(library, key_poses, a, b, skill, config)
    return np.concatenate(
        [
            np.asarray(
                _map_piece(
                    library.poses[skill],
                    low,
                    high,
                    key_poses[a + k],
                    key_poses[a + k + 1],
                    config.map,
                    points,
                )
            )
            for k, (low, high) in enumerate(zip(cuts[:-1], cuts[1:], strict=True))
        ]
    )


@functools.partial(jax.jit, static_argnames=("mapping", "points"))
def _map_piece(
    demo: Array, low: Array, high: Array, start: Array, goal: Array, mapping: str, points: int
) -> Float[Array, "points 8"]:
    """Map the part of a demonstration between two of its points; the rest collapses onto them."""
    inside = jnp.clip(jnp.arange(demo.shape[0]), low, high)
    return MAPS[mapping](resample(demo[inside], points), start, goal)
