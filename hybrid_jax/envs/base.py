# SPDX-License-Identifier: MIT
"""The protocol of an environment, and rollouts of many copies side by side.

An environment is a handful of pure functions of one copy; `jax.vmap` makes thousands. Time limits
are kept at the end of a rollout, where the value of the last observation is at hand anyway: so a
step needs one observation, not one for the last state of an episode and one for the next.
"""

from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import PRNGKeyArray

from hybrid_jax.types import Record, pytree


@pytree
class StepResult(Record):
    """Result of one action, as scalars `[]` of one copy."""

    state: Any
    """State after the action."""
    reward: Array
    terminated: Array
    """True where the episode is over and nothing more can be gained."""
    success: Array
    """True where the episode ended well."""
    info: dict[str, Array]
    """Further numbers to be reported: their means over all steps."""
    kept: Array | None = None
    """0 where this step's losses do not count (of SAC: the critics'); None: all count. Its reward
    is part of the returns of earlier steps all the same."""


@runtime_checkable
class Env(Protocol):
    """One copy of an environment. `State` is any pytree."""

    observation_size: int
    action_size: int

    def reset(self, key: PRNGKeyArray) -> Any:
        """State at the start of an episode."""
        ...

    def observe(self, state: Any) -> Array:
        """Observation `[observation_size]`, numbers of order one."""
        ...

    def step(self, state: Any, action: Array) -> StepResult:
        """Take an action: `[action_size]` numbers within -1 and 1, or the index of a choice."""
        ...

    def truncated(self, state: Any) -> Array:
        """True `[]` where the time limit has passed: the episode is cut at a rollout's end."""
        ...


@pytree
class Copies(Record):
    """Running copies of an environment; the leading axis runs over them."""

    state: Any
    obs: Array
    """`[copy, obs]` observations of the states."""
    gained: Array
    """`[copy]` sum of the running episodes' rewards so far."""


def start_copies(env: Env, key: PRNGKeyArray, count: int) -> Copies:
    """`count` copies, each at the start of an episode; every array is `[copy, ...]`."""
    state = jax.vmap(env.reset)(jax.random.split(key, count))
    return Copies(state, jax.vmap(env.observe)(state), jnp.zeros(count))


def choose_states(condition: Array, yes: Any, no: Any) -> Any:
    """Choose one of two states for each copy.

    Args:
        condition: `[copy]`.
        yes: pytree of `[copy, ...]` where the condition is true.
        no: the same where it is false.

    Returns:
        A pytree of `[copy, ...]`.
    """
    # trailing axes of length 1 spread the condition over arrays of any rank
    return jax.tree.map(
        lambda a, b: jnp.where(condition.reshape(-1, *[1] * (a.ndim - 1)), a, b), yes, no
    )


def rollout(
    env: Env,
    choose: Callable[[Array, PRNGKeyArray], tuple[Array, dict[str, Array]]],
    copies: Copies,
    key: PRNGKeyArray,
    steps: int,
) -> tuple[Copies, dict[str, Any]]:
    """Let every copy take `steps` steps; those whose episode is over begin anew.

    Args:
        env: environment of the copies.
        choose: from observations `[copy, obs]` and a key to actions `[copy, ...]` and further
            arrays `[copy, ...]` to record.
        copies: running copies.
        key: consumed.
        steps: how many.

    Returns:
        The copies, and `[step, copy, ...]` arrays: `obs`, `reward`, `terminated`, `success`,
        `info`, `kept`, `gained` (return of an episode where it ended, else 0), and those that
        `choose` records.
    """
    count = copies.obs.shape[0]
    key_restart, key_steps = jax.random.split(key)
    # one fresh state a copy serves all its restarts in a rollout: random numbers cost time
    restart_states = jax.vmap(env.reset)(jax.random.split(key_restart, count))

    def step(before: Copies, key):
        action, extras = choose(before.obs, key)
        result = jax.vmap(env.step)(before.state, action)
        state = choose_states(result.terminated, restart_states, result.state)
        gained, terminated = before.gained + result.reward, 1.0 * result.terminated
        next_copies = Copies(state, jax.vmap(env.observe)(state), (1 - terminated) * gained)
        return next_copies, {
            "obs": before.obs,
            "reward": result.reward,
            "terminated": terminated,
            "gained": terminated * gained,
            "success": result.success.astype(jnp.float32),
            "info": result.info,
            "kept": result.kept,
            **extras,
        }

    return jax.lax.scan(step, copies, jax.random.split(key_steps, steps))


def cut_truncated(env: Env, copies: Copies, key: PRNGKeyArray) -> tuple[Copies, dict[str, Array]]:
    """Begin anew where the time limit has passed.

    Args:
        env: environment of the copies.
        copies: running copies.
        key: consumed.

    Returns:
        The copies, `cut` `[copy]` 1 where an episode was cut, and `cut_gained` `[copy]` its return.
    """
    truncated = jax.vmap(env.truncated)(copies.state)
    fresh = start_copies(env, key, copies.obs.shape[0])
    cut = {"cut": 1.0 * truncated, "cut_gained": truncated * copies.gained}
    return choose_states(truncated, fresh, copies), cut


def episode_sums(data: dict[str, Any]) -> dict[str, Array]:
    """Sums over a rollout: episodes that ended or were cut, successes, and returns.

    Args:
        data: `terminated`, `success`, `gained` `[step, copy]` and `cut`, `cut_gained` `[copy]`.

    Returns:
        Scalars `episodes`, `success` and `return`.
    """
    return {
        "episodes": jnp.sum(data["terminated"]) + jnp.sum(data["cut"]),
        "success": jnp.sum(data["success"]),
        "return": jnp.sum(data["gained"]) + jnp.sum(data["cut_gained"]),
    }


def episode_means(sums: dict[str, Array]) -> dict[str, Array]:
    """Number of episodes, their share of successes and mean return, each `[]`.

    Args:
        sums: from `episode_sums`.
    """
    ended = sums["episodes"]
    return {k: v / jnp.maximum(ended, 1.0) for k, v in sums.items()} | {"episodes": ended}
