# SPDX-License-Identifier: MIT
"""The skill library: how well each demonstrated skill covers each segment of a task."""

import functools
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax import Array
from jaxtyping import Bool, Float

from hybrid_jax.errors import UnknownNameError
from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.skills.demonstration import Demonstration, clean
from hybrid_jax.skills.mapping import BETAS, MAPS, resample
from hybrid_jax.skills.task import Task
from hybrid_jax.types import pytree

MAX_KEY_POSES = 8
"""Key poses that a task may have (`K_max`)."""
MAX_SKILLS = 32
"""Skills that a library may hold (`h_max`)."""


@dataclass(frozen=True)
class SkillConfig:
    """How skills are judged and mapped."""

    map: str = "aligned"
    """Map to new ends, a key of `mapping.MAPS`."""
    distance: str = "screw"
    """Distance of features, a key of `mapping.BETAS`."""
    tolerance: float = 0.30
    """`Delta_beta`: a skill further away than this never moves the robot [m]."""

    def __post_init__(self):
        for kind, name, known in (("map", self.map, MAPS), ("distance", self.distance, BETAS)):
            if name not in known:
                raise UnknownNameError(f"skill {kind}", name, known)
        if not self.tolerance > 0:
            raise ValueError(f"tolerance must be positive, got {self.tolerance}")


@pytree
class SkillLibrary:
    """Cleaned demonstrations, padded to `MAX_SKILLS`."""

    poses: Array
    """`[skill, point, 8]`."""
    valid: Array
    """`[skill]` True for a slot that holds a skill."""
    closed: Array
    """`[skill]` True where the gripper holds an object."""
    names: tuple[str, ...] = struct.field(pytree_node=False)


@pytree
class SegmentCosts:
    """What covering key poses a..b of a task with skill k costs; infinite where inadmissible."""

    cost: Array
    """`[a, b, skill]` sum of feature distances [m]; inf where a term exceeds the tolerance."""
    nearest: Array
    """`[a, b, skill]` the same without the tolerance."""


def build_library(demos: list[Demonstration]) -> SkillLibrary:
    """Clean demonstrations and stack them.

    Raises:
        ValueError: no demonstration, or more than `MAX_SKILLS`.
    """
    if not 0 < len(demos) <= MAX_SKILLS:
        raise ValueError(f"a library holds 1 to {MAX_SKILLS} skills, got {len(demos)}")
    poses = np.stack([clean(d) for d in demos])
    empty = MAX_SKILLS - len(demos)
    filler = np.broadcast_to(np.array(dq.IDENTITY, np.float32), (empty, *poses.shape[1:]))
    return SkillLibrary(
        poses=jnp.asarray(np.concatenate([poses, filler]), jnp.float32),
        valid=jnp.arange(MAX_SKILLS) < len(demos),
        closed=jnp.array([d.closed for d in demos] + [False] * empty),
        names=tuple(d.name for d in demos),
    )


def without(library: SkillLibrary, names: set[str]) -> SkillLibrary:
    """The library with some skills taken out."""
    keep = jnp.array(
        [i >= len(library.names) or library.names[i] not in names for i in range(MAX_SKILLS)]
    )
    return library.replace(valid=library.valid & keep)


def _monotone_costs(terms: Float[Array, "l b skill i"], limit: float) -> Float[Array, "a b skill"]:
    """Cheapest monotone matching of task features l = a..b-1 to demo features, the first fixed."""
    terms = jnp.where(terms <= limit, terms, jnp.inf)
    count = terms.shape[0]
    rows = []
    for a in range(count):
        best = jnp.full(terms.shape[1:], jnp.inf).at[..., 0].set(terms[a, ..., 0])
        row = jnp.full((count, terms.shape[2]), jnp.inf)
        for b in range(a + 1, count):
            row = row.at[b].set(jnp.min(best[b], axis=-1))
            before = jax.lax.cummin(best, axis=2)
            before = jnp.concatenate(
                [jnp.full_like(before[..., :1], jnp.inf), before[..., :-1]], -1
            )
            best = before + terms[b]
        rows.append(row)
    return jnp.stack(rows)


def segment_costs(
    library: SkillLibrary,
    key_poses: Float[Array, "K 8"],
    carrying: Bool[Array, "K"],
    count: Array,
    config: SkillConfig,
) -> SegmentCosts:
    """Costs of all segments and skills of one padded task (paper, eqs. of `beta` and `r_t`).

    Args:
        library: the skills.
        key_poses: padded to `MAX_KEY_POSES`.
        carrying: for the unit segment that starts at each key pose.
        count: how many key poses are real.
        config: distance and tolerance.
    """
    size = key_poses.shape[0]
    distance = BETAS[config.distance]
    ends = jnp.broadcast_to(library.poses[:, -1:], library.poses[:, :-1].shape)
    demo = dq.mul(dq.conj(library.poses[:, :-1]), ends)
    grid = jnp.broadcast_to(key_poses[:, None], (size, size, 8))
    wanted = dq.mul(dq.conj(grid), jnp.swapaxes(grid, 0, 1))  # [l, b, 8]
    compare = jax.vmap(
        jax.vmap(jax.vmap(jax.vmap(distance, (None, 0)), (None, 0)), (0, None)), (0, None)
    )
    terms = compare(wanted, demo)  # [l, b, skill, i]
    index = jnp.arange(size)
    held = jnp.cumsum(jnp.concatenate([jnp.zeros(1), carrying.astype(jnp.float32)]))[:size]
    inside = held[None] - held[:, None]  # carried unit segments in a..b
    length = (index[None] - index[:, None]).astype(jnp.float32)
    real = (length > 0) & (index[None] < count)
    grip = jnp.where(library.closed, (inside == length)[..., None], (inside == 0)[..., None])
    usable = real[..., None] & grip & library.valid
    costs = [
        jnp.where(usable, _monotone_costs(terms, limit), jnp.inf)
        for limit in (config.tolerance, 1e6)
    ]
    return SegmentCosts(*costs)


def pad_task(task: Task) -> tuple[np.ndarray, np.ndarray, int]:
    """Key poses, carrying flags and count, padded to `MAX_KEY_POSES`."""
    count = len(task.key_poses)
    if not 2 <= count <= MAX_KEY_POSES:
        raise ValueError(f"a task has 2 to {MAX_KEY_POSES} key poses, got {count}")
    poses = np.concatenate([task.key_poses, task.key_poses[-1:].repeat(MAX_KEY_POSES - count, 0)])
    carrying = np.zeros(MAX_KEY_POSES, bool)
    carrying[: count - 1] = task.carrying
    return poses.astype(np.float32), carrying, count


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
