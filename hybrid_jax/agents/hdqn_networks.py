# SPDX-License-Identifier: MIT
"""The two controllers of RL-LfD: observations, networks and greedy choices.

The motion-controller values a skill for a segment, `q(s, ts, HD)`. It sees the screws between the
segment's features and the demonstration's (`skills.costs.SegmentCosts`), one after the other,
through one small network whose outputs add up, as the terms of the reward do. The weights are
shared by all skills: a skill that joins the library later is valued as well as any other.

The task-controller values the end of the next segment, `Q(s, ts)`: what the motion-controller
thinks of the segment, plus what a network makes of the rest of the task, of which it sees the
motion-controller's opinion on every segment that is possible then (paper, `ta_t`). Neither depends
on where in the world the task lies.
"""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from brax.training import networks
from jax import Array
from jaxtyping import Bool, Float

from hybrid_jax.skills.costs import MAX_KEY_POSES, SegmentCosts

K = MAX_KEY_POSES
"""Key poses of a padded task."""
_PAIRS = tuple(np.triu_indices(K, 1))
"""Segments (a, b), a < b."""
_UNIT = 0.3
"""Metres to a radian, and the size of a screw that a network sees as 1 [m]."""


@dataclass(frozen=True)
class Controllers:
    """The two networks."""

    motion: networks.MLP
    """One screw and its two sizes `[8]` to its share of a skill's value."""
    task: networks.MLP
    """Remaining segments `[2 * 28]`, see `remaining`, to the value of the rest of a task."""
    discount: float


def make_controllers(
    motion: tuple[int, ...], task: tuple[int, ...], discount: float
) -> Controllers:
    """Networks with the given widths of the hidden layers.

    Args:
        motion: of the motion-controller.
        task: of the task-controller.
        discount: of what follows a segment, from 0 to 1.
    """
    motion_net, task_net = (
        networks.MLP(layer_sizes=(*hidden, 1), activation=jax.nn.relu) for hidden in (motion, task)
    )
    return Controllers(motion_net, task_net, discount)


def initialize(nets: Controllers, key: Array) -> dict:
    """Fresh parameters of both networks, under `motion` and `task`."""
    key_motion, key_task = jax.random.split(key)
    return {
        "motion": nets.motion.init(key_motion, jnp.zeros(8)),
        "task": nets.task.init(key_task, jnp.zeros(2 * len(_PAIRS[0]))),
    }


def _term(nets: Controllers, params: Any, screw: Float[Array, "*b 6"]) -> Float[Array, "*b"]:
    v, w = screw[..., :3] / _UNIT, screw[..., 3:]
    sizes = [jnp.sqrt(jnp.sum(x**2, axis=-1, keepdims=True) + 1e-12) for x in (v, w)]
    value: Any = nets.motion.apply(params["motion"], jnp.concatenate([v, w, *sizes], axis=-1))
    return value[..., 0]


def skill_value(
    nets: Controllers,
    params: Any,
    tasks: SegmentCosts,
    task: Array,
    a: Array,
    b: Array,
    skill: Array,
) -> Float[Array, ""]:
    """Value `q(s, ts, HD)` of one skill on one segment.

    Args:
        nets, params: the networks.
        tasks: `[task, ...]` costs, with screws `[task, a, b, skill, 6]`.
        task, a, b, skill: scalar indices; the segment leads from key pose `a` to `b`.

    Returns:
        `[]` estimate of minus the cost [m].
    """
    inner = jnp.arange(K)
    screws = jnp.concatenate([tasks.first[task, a, b, skill][None], tasks.near[task, :, b, skill]])
    counts = jnp.concatenate([jnp.ones(1, bool), (inner > a) & (inner < b)])
    return jnp.sum(jnp.where(counts, _term(nets, params, screws), 0.0))


def skill_values(
    nets: Controllers, params: Any, first: Array, near: Array
) -> Float[Array, "a b skill"]:
    """Values `q(s, ts, HD)` of every skill on every segment of one task.

    Args:
        nets, params: the networks.
        first: `[a, b, skill, 6]` screws of the segments' starts ([m], [rad]).
        near: `[l, b, skill, 6]` screws of the key poses within segments.

    Returns:
        `[a, b, skill]`; as `skill_value` gives for a < b, 0 elsewhere.
    """
    a, b = _PAIRS
    start_terms = jnp.zeros(first.shape[:3]).at[a, b].set(_term(nets, params, first[a, b]))
    inner_terms = jnp.zeros(near.shape[:3]).at[a, b].set(_term(nets, params, near[a, b]))
    # a segment's inner terms are those of l = a + 1 .. b - 1
    tail_sums = jnp.cumsum(inner_terms[::-1], axis=0)[::-1]  # l..b-1
    return start_terms + jnp.concatenate([tail_sums[1:], jnp.zeros_like(tail_sums[:1])])


def best_values(
    nets: Controllers, params: Any, tasks: SegmentCosts
) -> tuple[Float[Array, "task a b"], Float[Array, "task a b skill"]]:
    """The motion-controller's opinion of all segments.

    Args:
        nets, params: the networks.
        tasks: `[task, ...]` costs.

    Returns:
        `[task, a, b]` value of the best admissible skill, and `[task, a, b, skill]` of every
        skill; minus infinity where a skill is not admissible.
    """
    values = jax.vmap(lambda f, n: skill_values(nets, params, f, n))(tasks.first, tasks.near)
    masked = jnp.where(jnp.isfinite(tasks.cost), values, -jnp.inf)
    return jnp.max(masked, axis=-1), masked


def remaining(opinion: Float[Array, "K K"], at: Array) -> Float[Array, "56"]:
    """Observation of the task-controller at a key pose.

    Args:
        opinion: `[K, K]` values of the segments of one task, minus infinity where there is none.
        at: `[]` index of the key pose.

    Returns:
        `[56]` the 28 values of the segments from `at` on, then 1 for those that exist.
    """
    # counted from the present key pose: the same remaining task looks the same from any index
    index = at + jnp.arange(K)
    values = opinion[jnp.minimum(index, K - 1)][:, jnp.minimum(index, K - 1)]
    exists = jnp.isfinite(values) & (index < K) & (index < K)[:, None]
    a, b = _PAIRS
    return jnp.concatenate([jnp.where(exists, values, 0.0)[a, b], exists[a, b].astype(jnp.float32)])


def rest_value(
    nets: Controllers, params: Any, opinion: Float[Array, "K K"], count: Array, at: Array
) -> Float[Array, ""]:
    """Discounted value of the rest of a task from a key pose on; 0 at the last one.

    Args:
        nets, params: the networks.
        opinion: `[K, K]` values of the task's segments.
        count: `[]` number of key poses of the task.
        at: `[]` index of the key pose.
    """
    value = nets.task.apply(params["task"], remaining(opinion, at))[0]
    return nets.discount * value * (at < count - 1)


def end_values(
    nets: Controllers, params: Any, opinion: Float[Array, "K K"], count: Array, at: Array
) -> Float[Array, " K"]:
    """Values `Q(s, ts)` of the ends of the next segment.

    Args:
        nets, params: the networks.
        opinion: `[K, K]` values of the task's segments.
        count: `[]` number of key poses of the task.
        at: `[]` index of the key pose where the segment starts.

    Returns:
        `[K]`; minus infinity for ends that no admissible skill reaches.
    """
    remaining_values = jax.vmap(lambda end: rest_value(nets, params, opinion, count, end))(
        jnp.arange(K)
    )
    return jnp.where(reachable(opinion, at), opinion[at] + remaining_values, -jnp.inf)


def reachable(opinion: Float[Array, "K K"], at: Array) -> Bool[Array, " K"]:
    """Ends `[K]` that some admissible skill reaches from a key pose, given opinions `[K, K]`."""
    return jnp.isfinite(opinion[at]) & (jnp.arange(K) > at)


def greedy_plans(nets: Controllers, params: Any, tasks: SegmentCosts) -> tuple[Array, Array]:
    """Plans of the greedy policy.

    Args:
        nets, params: the networks.
        tasks: `[task, ...]` costs.

    Returns:
        `[task, K - 1, 3]` (from, to, skill) of each segment, -1 past the end, and `[task]` costs
        [m], infinite where the policy meets a dead end.
    """
    opinions, skills = best_values(nets, params, tasks)

    def plan_task(opinion, skill_value, cost, count):
        def option(carry, _):
            at, total = carry
            to = jnp.argmax(end_values(nets, params, opinion, count, at))
            skill = jnp.argmax(skill_value[at, to])
            active = (at < count - 1) & jnp.any(reachable(opinion, at))
            record = jnp.where(active, jnp.stack([at, to, skill]), -1)
            return (
                jnp.where(active, to, at),
                total + jnp.where(active, cost[at, to, skill], 0.0),
            ), record

        (at, total), records = jax.lax.scan(
            option, (jnp.zeros((), int), jnp.float32(0.0)), length=K - 1
        )
        return records, jnp.where(at == count - 1, total, jnp.inf)

    return jax.vmap(plan_task)(opinions, skills, tasks.cost, tasks.count)
