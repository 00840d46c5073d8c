# SPDX-License-Identifier: MIT
"""Environments so small that an agent fails in each for one reason only.

In the order in which they should be mended: an environment needs what those before it need, and one
thing more. `x` is all that an agent sees.
"""

import dataclasses

import jax
import jax.numpy as jnp

from hybrid_jax.envs.base import StepResult


class Toy:
    """One step, reward 1: the value of a constant."""

    observation_size = 1
    lengths = 1
    """Steps of an episode."""

    def __init__(self, discrete: bool = False):
        self.discrete = discrete
        self.action_size = 2 if discrete else 1

    def reset(self, key):
        return {"x": self.first(key), "step": jnp.int32(0)}

    def first(self, key):
        return jnp.float32(0.0)

    def observe(self, state):
        return state["x"][None]

    def reward(self, x, step, action):
        return jnp.float32(1.0)

    def step(self, state, action):
        step = state["step"] + 1
        reward = self.reward(state["x"], step, action)
        after = {"x": self.following(state["x"]), "step": step}
        over = step == self.lengths
        return StepResult(after, reward, over, over, {})

    def following(self, x):
        return x

    def truncated(self, state):
        return state["step"] >= 8


class Seen(Toy):
    """The value depends on what is seen."""

    def first(self, key):
        return jnp.where(jax.random.bernoulli(key), 1.0, -1.0)

    def reward(self, x, step, action):
        return x


class Delayed(Toy):
    """The reward comes a step later: discount and advantages."""

    lengths = 2

    def following(self, x):
        return x + 1.0

    def reward(self, x, step, action):
        return 1.0 * (step == 2)


class Endless(Toy):
    """Nothing ends, every episode is cut: a cut is no end."""

    lengths = -1


class Aimed(Toy):
    """One action is best: the policy."""

    def aim(self, x):
        return 0.5

    def reward(self, x, step, action):
        if self.discrete:
            return 1.0 * (action == (self.aim(x) > 0))
        return -4.0 * jnp.square(action[0] - self.aim(x))


class Later(Aimed):
    """The first of two actions is paid for after the second: credit over time."""

    lengths = 2

    def step(self, state, action):
        move = super().step(state, action)
        first = state["step"] == 0
        worth = jnp.where(first, self.reward(state["x"], 1, action), state["x"])
        after = move.state | {"x": jnp.float32(worth)}  # it is seen what is to be paid
        return dataclasses.replace(move, state=after, reward=jnp.where(first, 0.0, worth))


class Matched(Aimed):
    """Which action is best depends on what is seen: the policy's observation."""

    first = Seen.first

    def aim(self, x):
        return 0.5 * x
