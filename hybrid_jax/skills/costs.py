# SPDX-License-Identifier: MIT
"""Costs of covering each segment of a task by each skill (paper, `r_t` and `beta`)."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float

from hybrid_jax.errors import InputError
from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.skills.feature_distance import BETAS, features
from hybrid_jax.skills.library import MAX_SKILLS, SkillConfig, SkillLibrary
from hybrid_jax.tasks.task import Task
from hybrid_jax.types import Record, pytree

MAX_KEY_POSES = 8
"""Largest number of key poses that skills can cover in a task (`K_max`)."""


@pytree
class SegmentCosts(Record):
    """Costs of covering key poses a..b of a task by one skill, and the screws between features.

    A screw (v [m], w [rad]) leads from a feature of the task to one of the demonstration; the
    distance of the two features is its size.
    """

    count: Array
    """`[]` number of key poses; those after them are padding."""
    cost: Array
    """`[a, b, skill]` sum of feature distances [m]; inf where a term exceeds the tolerance."""
    nearest: Array
    """`[a, b, skill]` sum of feature distances [m], whatever the tolerance is."""
    first: Array
    """`[a, b, skill, 6]` screw from the feature of the segment's start to the skill's first one."""
    near: Array
    """`[l, b, skill, 6]` screw from the feature of key pose l to the skill's nearest one."""


def pad_task(task: Task) -> tuple[np.ndarray, np.ndarray, int]:
    """What skills must cover of a task, padded to `MAX_KEY_POSES`.

    Returns:
        Key poses `[MAX_KEY_POSES, 8]`, of which the last is repeated; carrying flags
        `[MAX_KEY_POSES]` of the unit segments that start at them; the number of key poses.

    Raises:
        InputError: the task has too few or too many key poses.
    """
    (key_poses, flags), count = task.shown, len(task.shown[0])
    if not 2 <= count <= MAX_KEY_POSES:
        raise InputError(f"a task has 2 to {MAX_KEY_POSES} key poses, got {count}")
    poses = np.concatenate([key_poses, key_poses[-1:].repeat(MAX_KEY_POSES - count, 0)])
    carrying = np.zeros(MAX_KEY_POSES, bool)
    carrying[: count - 1] = flags
    return poses.astype(np.float32), carrying, count


def pad_costs(costs: SegmentCosts) -> SegmentCosts:
    """Costs of a task on the host, padded to `MAX_KEY_POSES` key poses and `MAX_SKILLS` skills.

    Args:
        costs: of fewer key poses or skills, with `cost` `[a, b, skill]`.

    Returns:
        Costs with `cost` and `nearest` `[MAX_KEY_POSES, MAX_KEY_POSES, MAX_SKILLS]`, inf in the
        padding, where screws are 0.
    """

    def pad(values: Array, fill: float) -> Any:
        padding = [MAX_KEY_POSES - values.shape[0]] * 2 + [MAX_SKILLS - values.shape[2]]
        widths = [(0, n) for n in padding] + [(0, 0)] * (values.ndim - 3)
        return np.pad(values, widths, constant_values=fill)

    inf, zero = np.inf, 0.0
    return SegmentCosts(
        costs.count,
        pad(costs.cost, inf),
        pad(costs.nearest, inf),
        pad(costs.first, zero),
        pad(costs.near, zero),
    )


def _monotone_costs(terms: Float[Array, "i l b skill"], limit: float) -> Float[Array, "a b skill"]:
    """Cheapest monotone matching of task features l = a..b-1 to demo features, the first fixed.

    A scan takes the demo features one after the other. `least` holds, for every a <= l < b, the
    cost of the cheapest matching of a..l to the demo features that have passed.
    """
    size = terms.shape[1]
    triples = [(a, k, b) for a in range(size) for b in range(a + 1, size) for k in range(a, b)]
    start, index, end = np.array(triples).T
    is_first, is_last = (start == index)[:, None], index == end - 1
    # a term beyond the tolerance makes every matching with it inadmissible (paper, -inf in `r_t`)
    terms = jnp.where(terms <= limit, terms, jnp.inf)[:, index, end]

    def advance(least, feature):
        term, opening = feature
        # rows of one a and b stand in order, so the row before is that of l - 1
        previous = jnp.concatenate([least[-1:], least[:-1]])
        return jnp.minimum(least, term + jnp.where(is_first, opening, previous)), None

    openings = jnp.where(jnp.arange(terms.shape[0]) == 0, 0.0, jnp.inf)
    least, _ = jax.lax.scan(advance, jnp.full(terms.shape[1:], jnp.inf), (terms, openings))
    costs = jnp.full((size, size, terms.shape[2]), jnp.inf)
    return costs.at[start[is_last], end[is_last]].set(least[is_last])


def _task_features(key_poses: Array) -> Float[Array, "l b 8"]:
    """`delta_l = D_l* D_b` of every pair of key poses."""
    size = key_poses.shape[0]
    grid = jnp.broadcast_to(key_poses[:, None], (size, size, 8))
    return dq.mul(dq.conj(grid), jnp.swapaxes(grid, 0, 1))


def _terms(wanted: Array, demo: Array, config: SkillConfig) -> Float[Array, "i l b skill"]:
    """Distance of every task feature to every demonstrated feature [m]; inf where l >= b."""
    pairs = np.triu_indices(wanted.shape[0], 1)
    demo_features = jnp.transpose(demo, (2, 1, 0))[:, :, None]
    distances = BETAS[config.distance](wanted[pairs].T[:, None, :, None], demo_features)
    shape = (distances.shape[0], *wanted.shape[:2], distances.shape[2])
    return jnp.full(shape, jnp.inf).at[:, *pairs].set(distances)


def _usable(library: SkillLibrary, carrying: Array, count: Array) -> Bool[Array, "a b skill"]:
    """Segments that exist and on which the gripper is as the skill's: closed or open throughout."""
    index = jnp.arange(carrying.shape[0])
    held = jnp.concatenate([jnp.zeros(1), jnp.cumsum(carrying)[:-1]])
    carried = held[None] - held[:, None]  # carried unit segments in a..b
    length = (index[None] - index[:, None]).astype(jnp.float32)
    exists = (length > 0) & (index[None] < count)
    grip = jnp.where(library.closed, (carried == length)[..., None], (carried == 0)[..., None])
    return exists[..., None] & grip & library.valid


def segment_costs(
    library: SkillLibrary,
    key_poses: Float[Array, "K 8"],
    carrying: Bool[Array, " K"],
    count: Array,
    config: SkillConfig,
) -> SegmentCosts:
    """Costs of all segments and skills of one padded task (paper, eqs. of `beta` and `r_t`).

    Args:
        library: the skills.
        key_poses: `[K, 8]` padded to `MAX_KEY_POSES`.
        carrying: `[K]` for the unit segment that starts at each key pose.
        count: `[]` number of key poses without the padding.
        config: distance and tolerance.

    Returns:
        Costs `[K, K, skill]` [m], and the screws behind them.
    """
    task_features, demo = _task_features(key_poses), jax.vmap(features)(library.poses)
    terms = _terms(task_features, demo, config)
    usable = _usable(library, carrying, count)
    cost, nearest = (
        jnp.where(usable, _monotone_costs(terms, limit), jnp.inf)
        for limit in (config.tolerance, 1e6)
    )
    skills = jnp.arange(demo.shape[0])
    inverse = jnp.broadcast_to(dq.conj(task_features)[:, :, None], (*terms.shape[1:], 8))
    first_screws = dq.log(dq.mul(inverse, jnp.broadcast_to(demo[:, 0], inverse.shape)))
    nearest_screws = dq.log(dq.mul(inverse, demo[skills, jnp.argmin(terms, axis=0)]))
    return SegmentCosts(jnp.asarray(count), cost, nearest, first_screws, nearest_screws)
