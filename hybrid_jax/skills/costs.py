# SPDX-License-Identifier: MIT
"""How well each skill covers each segment of a task (paper, `r_t` and `beta`)."""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float

from hybrid_jax.errors import InputError
from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.skills.distance import BETAS, features
from hybrid_jax.skills.library import MAX_SKILLS, SkillConfig, SkillLibrary
from hybrid_jax.skills.task import Task
from hybrid_jax.types import pytree

MAX_KEY_POSES = 8
"""Key poses that a task may have (`K_max`)."""


@pytree
class SegmentCosts:
    """What covering key poses a..b of a task with skill k costs, and the screws behind it.

    A screw (v [m], w [rad]) leads from a feature of the task to one of the demonstration; its size
    is what the distance measures.
    """

    count: Array
    """Key poses that are real; the others are padding."""
    cost: Array
    """`[a, b, skill]` sum of feature distances [m]; inf where a term exceeds the tolerance."""
    nearest: Array
    """`[a, b, skill]` the same without the tolerance."""
    first: Array
    """`[a, b, skill, 6]` from the feature of the segment's start to the demonstration's first."""
    near: Array
    """`[l, b, skill, 6]` from that of a key pose within the segment to the nearest one."""


def pad_task(task: Task) -> tuple[np.ndarray, np.ndarray, int]:
    """Key poses that skills must cover, carrying flags and count, padded to `MAX_KEY_POSES`."""
    (shown, held), count = task.shown, len(task.shown[0])
    if not 2 <= count <= MAX_KEY_POSES:
        raise InputError(f"a task has 2 to {MAX_KEY_POSES} key poses, got {count}")
    poses = np.concatenate([shown, shown[-1:].repeat(MAX_KEY_POSES - count, 0)])
    carrying = np.zeros(MAX_KEY_POSES, bool)
    carrying[: count - 1] = held
    return poses.astype(np.float32), carrying, count


def pad_costs(costs: SegmentCosts) -> SegmentCosts:
    """Costs of a task with fewer key poses or skills than there may be, padded, on the host."""

    def pad(values: np.ndarray, fill: float) -> np.ndarray:
        missing = [MAX_KEY_POSES - values.shape[0]] * 2 + [MAX_SKILLS - values.shape[2]]
        wide = [(0, n) for n in missing] + [(0, 0)] * (values.ndim - 3)
        return np.pad(values, wide, constant_values=fill)

    inf, still = np.inf, 0.0
    return SegmentCosts(
        costs.count, pad(costs.cost, inf), pad(costs.nearest, inf),
        pad(costs.first, still), pad(costs.near, still),
    )  # fmt: skip


def _monotone_costs(terms: Float[Array, "i l b skill"], limit: float) -> Float[Array, "a b skill"]:
    """Cheapest monotone matching of task features l = a..b-1 to demo features, the first fixed.

    Demo features come one after the other; `least` holds, for every a <= l < b, the cost of the
    cheapest matching of a..l to those that have passed.
    """
    size = terms.shape[1]
    rows = [(a, k, b) for a in range(size) for b in range(a + 1, size) for k in range(a, b)]
    first, task, last = np.array(rows).T
    begins, ends = (first == task)[:, None], task == last - 1
    terms = jnp.where(terms <= limit, terms, jnp.inf)[:, task, last]

    def advance(least, feature):
        term, opening = feature
        before = jnp.concatenate([least[-1:], least[:-1]])  # rows of one a and b stand in order
        return jnp.minimum(least, term + jnp.where(begins, opening, before)), None

    openings = jnp.where(jnp.arange(terms.shape[0]) == 0, 0.0, jnp.inf)
    least, _ = jax.lax.scan(advance, jnp.full(terms.shape[1:], jnp.inf), (terms, openings))
    costs = jnp.full((size, size, terms.shape[2]), jnp.inf)
    return costs.at[first[ends], last[ends]].set(least[ends])


def _task_features(key_poses: Array) -> Float[Array, "l b 8"]:
    """`delta_l = D_l* D_b` of every pair of key poses."""
    size = key_poses.shape[0]
    grid = jnp.broadcast_to(key_poses[:, None], (size, size, 8))
    return dq.mul(dq.conj(grid), jnp.swapaxes(grid, 0, 1))


def _terms(wanted: Array, demo: Array, config: SkillConfig) -> Float[Array, "i l b skill"]:
    """Distance of every task feature to every demonstrated feature [m]; inf where l >= b."""
    ahead = np.triu_indices(wanted.shape[0], 1)
    seen = jnp.transpose(demo, (2, 1, 0))[:, :, None]
    found = BETAS[config.distance](wanted[ahead].T[:, None, :, None], seen)
    shape = (found.shape[0], *wanted.shape[:2], found.shape[2])
    return jnp.full(shape, jnp.inf).at[:, *ahead].set(found)


def _usable(library: SkillLibrary, carrying: Array, count: Array) -> Bool[Array, "a b skill"]:
    """Segments that exist and on which the gripper does what the skill's does."""
    index = jnp.arange(carrying.shape[0])
    held = jnp.concatenate([jnp.zeros(1), jnp.cumsum(carrying)[:-1]])
    inside = held[None] - held[:, None]  # carried unit segments in a..b
    length = (index[None] - index[:, None]).astype(jnp.float32)
    real = (length > 0) & (index[None] < count)
    grip = jnp.where(library.closed, (inside == length)[..., None], (inside == 0)[..., None])
    return real[..., None] & grip & library.valid


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
    wanted, demo = _task_features(key_poses), jax.vmap(features)(library.poses)
    terms = _terms(wanted, demo, config)
    usable = _usable(library, carrying, count)
    cost, nearest = (
        jnp.where(usable, _monotone_costs(terms, limit), jnp.inf)
        for limit in (config.tolerance, 1e6)
    )
    skills = jnp.arange(demo.shape[0])
    back = jnp.broadcast_to(dq.conj(wanted)[:, :, None], (*terms.shape[1:], 8))
    first = dq.log(dq.mul(back, jnp.broadcast_to(demo[:, 0], back.shape)))
    near = dq.log(dq.mul(back, demo[skills, jnp.argmin(terms, axis=0)]))
    return SegmentCosts(jnp.asarray(count), cost, nearest, first, near)
