# SPDX-License-Identifier: MIT
"""The two controllers of RL-LfD: what they see, their networks, and how they choose.

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
    """Remaining segments `[2 * 28]` to the value of the rest of a task."""
    discount: float


def make_controllers(
    motion: tuple[int, ...], task: tuple[int, ...], discount: float
) -> Controllers:
    """Networks with the given hidden layers."""
    motion_net, task_net = (
        networks.MLP(layer_sizes=(*hidden, 1), activation=jax.nn.relu) for hidden in (motion, task)
    )
    return Controllers(motion_net, task_net, discount)


def initialize(nets: Controllers, key: Array) -> dict:
    """Fresh parameters of both."""
    key_motion, key_task = jax.random.split(key)
    return {
        "motion": nets.motion.init(key_motion, jnp.zeros(8)),
        "task": nets.task.init(key_task, jnp.zeros(2 * len(_PAIRS[0]))),
    }


def _term(nets: Controllers, params: Any, screw: Float[Array, "*b 6"]) -> Float[Array, "*b"]:
    v, w = screw[..., :3] / _UNIT, screw[..., 3:]
    sizes = [jnp.sqrt(jnp.sum(x**2, axis=-1, keepdims=True) + 1e-12) for x in (v, w)]
    return nets.motion.apply(params["motion"], jnp.concatenate([v, w, *sizes], axis=-1))[..., 0]


def skill_value(
    nets: Controllers,
    params: Any,
    tasks: SegmentCosts,
    task: Array,
    a: Array,
    b: Array,
    skill: Array,
) -> Float[Array, ""]:
    """`q(s, ts, HD)` of one skill on one segment."""
    inner = jnp.arange(K)
    screws = jnp.concatenate([tasks.first[task, a, b, skill][None], tasks.near[task, :, b, skill]])
    counts = jnp.concatenate([jnp.ones(1, bool), (inner > a) & (inner < b)])
    return jnp.sum(jnp.where(counts, _term(nets, params, screws), 0.0))


def skill_values(
    nets: Controllers, params: Any, first: Array, near: Array
) -> Float[Array, "a b skill"]:
    """`q(s, ts, HD)` of every skill on every segment of one task."""
    a, b = _PAIRS
    whole = jnp.zeros(first.shape[:3]).at[a, b].set(_term(nets, params, first[a, b]))
    inner = jnp.zeros(near.shape[:3]).at[a, b].set(_term(nets, params, near[a, b]))
    # a segment's inner terms are those of l = a + 1 .. b - 1
    later = jnp.cumsum(inner[::-1], axis=0)[::-1]  # l..b-1
    return whole + jnp.concatenate([later[1:], jnp.zeros_like(later[:1])])


def best_values(
    nets: Controllers, params: Any, tasks: SegmentCosts
) -> tuple[Float[Array, "task a b"], Float[Array, "task a b skill"]]:
    """The motion-controller's opinion: value of the best admissible skill, and of every skill."""
    values = jax.vmap(lambda f, n: skill_values(nets, params, f, n))(tasks.first, tasks.near)
    masked = jnp.where(jnp.isfinite(tasks.cost), values, -jnp.inf)
    return jnp.max(masked, axis=-1), masked


def remaining(opinion: Float[Array, "K K"], at: Array) -> Float[Array, "56"]:
    """What the task-controller sees: values of the segments from `at` on, and which there are."""
    index = at + jnp.arange(K)
    seen = opinion[jnp.minimum(index, K - 1)][:, jnp.minimum(index, K - 1)]
    known = jnp.isfinite(seen) & (index < K) & (index < K)[:, None]
    a, b = _PAIRS
    return jnp.concatenate([jnp.where(known, seen, 0.0)[a, b], known[a, b].astype(jnp.float32)])


def rest_value(
    nets: Controllers, params: Any, opinion: Float[Array, "K K"], count: Array, at: Array
) -> Float[Array, ""]:
    """What is still to come once a key pose is reached; 0 at the last one."""
    value = nets.task.apply(params["task"], remaining(opinion, at))[0]
    return nets.discount * value * (at < count - 1)


def end_values(
    nets: Controllers, params: Any, opinion: Float[Array, "K K"], count: Array, at: Array
) -> Float[Array, "K"]:
    """`Q(s, ts)` of the ends of the next segment; minus infinity where no skill reaches them."""
    rest = jax.vmap(lambda end: rest_value(nets, params, opinion, count, end))(jnp.arange(K))
    return jnp.where(reachable(opinion, at), opinion[at] + rest, -jnp.inf)


def reachable(opinion: Float[Array, "K K"], at: Array) -> Bool[Array, "K"]:
    """Ends that some admissible skill reaches from a key pose."""
    return jnp.isfinite(opinion[at]) & (jnp.arange(K) > at)


def greedy_plans(nets: Controllers, params: Any, tasks: SegmentCosts) -> tuple[Array, Array]:
    """Greedy plans `[task, K - 1, 3]` (from, to, skill; -1 past the end), costs (inf: dead end)."""
    opinions, skills = best_values(nets, params, tasks)

    def one(opinion, skill_value, cost, count):
        def option(carry, _):
            at, total = carry
            to = jnp.argmax(end_values(nets, params, opinion, count, at))
            skill = jnp.argmax(skill_value[at, to])
            going = (at < count - 1) & jnp.any(reachable(opinion, at))
            record = jnp.where(going, jnp.stack([at, to, skill]), -1)
            return (
                jnp.where(going, to, at),
                total + jnp.where(going, cost[at, to, skill], 0.0),
            ), record

        (at, total), records = jax.lax.scan(
            option, (jnp.zeros((), int), jnp.float32(0.0)), length=K - 1
        )
        return records, jnp.where(at == count - 1, total, jnp.inf)

    return jax.vmap(one)(opinions, skills, tasks.cost, tasks.count)
