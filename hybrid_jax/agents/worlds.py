# SPDX-License-Identifier: MIT
"""What an agent learns in, and how many copies of it run side by side.

A world is a handful of pure functions of one copy; `jax.vmap` makes thousands. Time limits are
kept at the end of a rollout, where the value of the last observation is at hand anyway: so a
step needs one observation, not one for the last state of an episode and one for the next.
"""

from collections.abc import Callable
from typing import Any, Protocol

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import PRNGKeyArray

from hybrid_jax.types import pytree


@pytree
class Move:
    """What came of one action."""

    state: Any
    """Of the copy after it."""
    reward: Array
    terminated: Array
    """True where the episode is over and nothing more can be gained."""
    success: Array
    """True where it ended well."""
    facts: dict[str, Array]
    """Further numbers to be reported: their means over all steps."""
    kept: Array | None = None
    """0 where this step's losses do not count (of SAC: the critics'); None: all count. Its reward
    is part of what earlier steps led to all the same."""


class World(Protocol):
    """One copy of a world. `State` is any pytree."""

    observation_size: int
    action_size: int

    def begin(self, key: PRNGKeyArray) -> Any:
        """State at the start of an episode."""
        ...

    def observe(self, state: Any) -> Array:
        """What the agent sees, `[observation_size]`, of order one."""
        ...

    def step(self, state: Any, action: Array) -> Move:
        """One action: `[action_size]` numbers within -1 and 1, or the index of a choice."""
        ...

    def overdue(self, state: Any) -> Array:
        """True where the time limit has passed: the episode is cut at the next occasion."""
        ...


@pytree
class Copies:
    """Running copies of a world; the leading axis runs over them."""

    state: Any
    obs: Array
    gained: Array
    """Rewards of the running episodes, added up."""


def start_copies(world: World, key: PRNGKeyArray, count: int) -> Copies:
    """`count` fresh copies."""
    state = jax.vmap(world.begin)(jax.random.split(key, count))
    return Copies(state, jax.vmap(world.observe)(state), jnp.zeros(count))


def choose_states(condition: Array, yes: Any, no: Any) -> Any:
    """Per copy, one state or the other."""
    return jax.tree.map(
        lambda a, b: jnp.where(condition.reshape(-1, *[1] * (a.ndim - 1)), a, b), yes, no
    )


def rollout(
    world: World,
    choose: Callable[[Array, PRNGKeyArray], tuple[Array, dict[str, Array]]],
    copies: Copies,
    key: PRNGKeyArray,
    steps: int,
) -> tuple[Copies, dict[str, Any]]:
    """Let every copy take `steps` steps; those whose episode is over begin anew.

    Args:
        world: what they are copies of.
        choose: from observations and a key to actions and what else is to be kept of them.
        copies: where they stand.
        key: consumed.
        steps: how many.

    Returns:
        The copies, and `[step, copy]` arrays: `obs`, `reward`, `terminated`, `success`, `facts`,
        `kept`, `gained` by the episodes that ended, and what `choose` keeps.
    """
    count = copies.obs.shape[0]
    key_spare, key_steps = jax.random.split(key)
    # one fresh start a copy serves all its restarts of a rollout: random numbers cost time
    spare = jax.vmap(world.begin)(jax.random.split(key_spare, count))

    def step(before: Copies, key):
        action, kept = choose(before.obs, key)
        move = jax.vmap(world.step)(before.state, action)
        state = choose_states(move.terminated, spare, move.state)
        gained, over = before.gained + move.reward, 1.0 * move.terminated
        after = Copies(state, jax.vmap(world.observe)(state), (1 - over) * gained)
        return after, {
            "obs": before.obs,
            "reward": move.reward,
            "terminated": over,
            "gained": over * gained,
            "success": move.success.astype(jnp.float32),
            "facts": move.facts,
            "kept": move.kept,
            **kept,
        }

    return jax.lax.scan(step, copies, jax.random.split(key_steps, steps))


def cut_overdue(
    world: World, copies: Copies, key: PRNGKeyArray
) -> tuple[Copies, dict[str, Array]]:
    """Begin anew where the time limit has passed; also returns where, and what was gained there."""
    overdue = jax.vmap(world.overdue)(copies.state)
    fresh = start_copies(world, key, copies.obs.shape[0])
    cut = {"cut": 1.0 * overdue, "cut_gained": overdue * copies.gained}
    return choose_states(overdue, fresh, copies), cut


def episode_sums(data: dict[str, Any]) -> dict[str, Array]:
    """Over a rollout: episodes that ended, those that ended well, and what all of them gained."""
    return {
        "episodes": jnp.sum(data["terminated"]) + jnp.sum(data["cut"]),
        "success": jnp.sum(data["success"]),
        "return": jnp.sum(data["gained"]) + jnp.sum(data["cut_gained"]),
    }


def episode_means(sums: dict[str, Array]) -> dict[str, Array]:
    """How many episodes ended, and their share of successes and mean return."""
    ended = sums["episodes"]
    return {k: v / jnp.maximum(ended, 1.0) for k, v in sums.items()} | {"episodes": ended}
