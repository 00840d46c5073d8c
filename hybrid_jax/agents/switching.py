# SPDX-License-Identifier: MIT
"""The switching agent: when to follow the skill and when the joint agent (discrete PPO).

Both joint motions of a phase run on one grid of `STEPS` points; at every point the agent chooses
one. The paper's reward, manipulability minus collision, has no term that joins neighbouring
points; ours adds the jump and the switch. With two choices a step the optimum is a Viterbi path:
`optimal_switching` is the oracle.
"""

import functools
from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, PRNGKeyArray

from hybrid_jax.agents import networks, ppo
from hybrid_jax.agents.worlds import Move
from hybrid_jax.types import pytree

STEPS = 200
"""Points of the grid (paper, table of the switching agent: steps)."""
AHEAD = 5
"""Next points of both motions that the agent sees."""


@dataclass(frozen=True)
class SwitchConfig:
    """Reward and training."""

    collision: float = 5.0
    """Cost of an infeasible point."""
    jump: float = 5.0
    """Cost of a joint step, in units of `allowed`, beyond the first."""
    switch: float = 0.5
    """Cost of changing the source."""
    allowed: float = 0.15
    """Joint step between grid points that costs nothing [rad]."""
    scale: float = 0.1
    """Factor on the reward, to bring it to order one."""
    training: ppo.PpoConfig = ppo.PpoConfig(
        steps=400_000,
        envs=64,
        unroll=50,
        minibatch=800,
        # with 1e-3 one seed in eight ends a fifth below the others
        learning_rate=3e-4,
        discount=0.96,
        hidden=(64, 64),
    )


@pytree
class Combined:
    """Both motions of one phase on the grid."""

    q: Array
    """`[2, STEPS, joint]`: skill, joint agent (repeated where it has no motion)."""
    manipulability: Array
    """`[2, STEPS]` man'."""
    collision: Array
    """`[2, STEPS]` 1 where infeasible."""
    available: Array
    """`[STEPS]` 1 where the joint agent has a motion."""


@pytree
class SwitchState:
    """Where one episode stands."""

    problem: Array
    step: Array
    q: Array
    """`[joint]` last chosen configuration."""
    choice: Array
    """Last choice: 0 skill, 1 joint agent."""


def point_reward(data: Combined, config: SwitchConfig) -> Float[Array, "2 STEPS"]:
    """Part of the reward that depends on one point only."""
    reward = data.manipulability - config.collision * data.collision
    return reward.at[1].add(-2 * config.collision * (1 - data.available))


def step_reward(before: Array, after: Array, config: SwitchConfig) -> Array:
    """Cost of the joint step between two configurations, as a negative reward."""
    size = jnp.max(jnp.abs(after - before), axis=-1)
    return -config.jump * jnp.maximum(0.0, size - config.allowed) / config.allowed


class SwitchWorld:
    """A `World` (see `agents.worlds`) of combined trajectories."""

    action_size = 2

    def __init__(self, problems: Combined, config: SwitchConfig = SwitchConfig()):
        """Args:
        problems: stacked along a leading axis.
        config: reward.
        """
        self.problems, self.config = problems, config
        self.observation_size = self.observation_length(problems.q.shape[-1])

    @staticmethod
    def observation_length(joints: int) -> int:
        """Length of an observation of an arm with `joints` joints."""
        return joints * (1 + 2 * (1 + AHEAD)) + 4 + 1 + 2

    def _problem(self, index: Array) -> Combined:
        return jax.tree.map(lambda a: a[index], self.problems)

    def observe(self, state: SwitchState) -> Float[Array, "obs"]:
        """Both motions from here on relative to the robot, their worth, and the last choice."""
        data = self._problem(state.problem)
        t = jnp.minimum(state.step, STEPS - 1)
        seen = jnp.minimum(t + jnp.arange(AHEAD + 1), STEPS - 1)
        return jnp.concatenate(
            [
                state.q,
                (data.q[:, seen] - state.q).reshape(-1),
                data.manipulability[:, t],
                data.collision[:, t],
                data.available[t][None],
                jnp.stack([state.choice.astype(jnp.float32), state.step / STEPS]),
            ]
        )

    def start(self, index: Array) -> SwitchState:
        """A given problem; the robot stands at the beginning of the skill's motion."""
        zero = jnp.zeros((), jnp.int32)
        return SwitchState(index, zero, self.problems.q[index, 0, 0], zero)

    def begin(self, key: PRNGKeyArray) -> SwitchState:
        return self.start(jax.random.randint(key, (), 0, self.problems.available.shape[0]))

    def overdue(self, state: SwitchState) -> Array:
        """Never: an episode ends with the trajectory."""
        return jnp.zeros_like(state.step, bool)

    def step(self, state: SwitchState, action: Array) -> Move:
        data = self._problem(state.problem)
        # the joint agent can only be chosen where it has a motion
        choice = jnp.where(data.available[state.step] > 0, action, 0).astype(jnp.int32)
        q = data.q[choice, state.step]
        reward = (
            point_reward(data, self.config)[choice, state.step]
            + step_reward(state.q, q, self.config)
            - self.config.switch * (choice != state.choice)
        )
        collides = data.collision[choice, state.step]
        after = SwitchState(state.problem, state.step + 1, q, choice)
        done = after.step >= STEPS
        return Move(after, self.config.scale * reward, done, done & (collides == 0),
                    {"infeasible": collides})  # fmt: skip


def episode_return(
    data: Combined, choice: Float[Array, "STEPS"], config: SwitchConfig
) -> Float[Array, ""]:
    """Total reward of some choices `[STEPS]`; where the joint agent has no motion, of the skill."""
    choice = jnp.where(data.available > 0, choice, 0).astype(jnp.int32)
    at = jnp.arange(STEPS)
    q = data.q[choice, at]
    before = jnp.concatenate([data.q[0, :1], q[:-1]])
    changes = choice != jnp.concatenate([jnp.zeros(1, jnp.int32), choice[:-1]])
    points = point_reward(data, config)[choice, at]
    return jnp.sum(points + step_reward(before, q, config) - config.switch * changes)


def optimal_switching(data: Combined, config: SwitchConfig) -> tuple[np.ndarray, float]:
    """Best choices `[STEPS]` and their total reward, by dynamic programming (Viterbi)."""
    choice, value = _viterbi(data, config)
    return np.asarray(choice), float(value)


@functools.partial(jax.jit, static_argnames="config")
def _viterbi(data: Combined, config: SwitchConfig) -> tuple[Array, Array]:
    q = data.q
    points = point_reward(data, config)
    points = points.at[1].set(jnp.where(data.available > 0, points[1], -jnp.inf))
    moves = step_reward(q[:, None, :-1], q[None, :, 1:], config)
    moves -= config.switch * (1 - jnp.eye(2))[:, :, None]
    entering = step_reward(q[0, 0], q[1, 0], config) - config.switch

    def advance(value, step):
        point, move = step
        totals = value[:, None] + move
        return jnp.max(totals, axis=0) + point, jnp.argmax(totals, axis=0)

    first = points[:, 0].at[1].add(entering)
    value, back = jax.lax.scan(advance, first, (points[:, 1:].T, jnp.moveaxis(moves, 2, 0)))
    last = jnp.argmax(value)
    choice = jax.lax.scan(lambda at, row: (row[at], row[at]), last, back, reverse=True)[1]
    return jnp.append(choice, last), jnp.max(value)


def make_net(joints: int, config: SwitchConfig) -> networks.ActorCritic:
    """Networks of the agent for an arm."""
    return networks.make_networks(
        SwitchWorld.observation_length(joints), 2, config.training.hidden, discrete=True
    )


def make_switcher(
    net: networks.ActorCritic, policy: networks.Policy, config: SwitchConfig
) -> Callable[[Combined], np.ndarray]:
    """The trained agent as a function of one problem to its choices `[STEPS]`."""
    run = jax.jit(functools.partial(choose, net, config=config))

    def switch(combined: Combined) -> np.ndarray:
        one = jax.tree.map(lambda a: a[None], combined)
        return np.asarray(run(policy, one)[0][0])

    return switch


def choose(
    net: networks.ActorCritic, policy: networks.Policy, problems: Combined, config: SwitchConfig
) -> tuple[Array, Array]:
    """Choices `[problem, STEPS]` of the trained agent and their total rewards `[problem]`."""
    world = SwitchWorld(problems, config)

    def run(index):
        def step(state, _):
            move = world.step(state, networks.act(net, policy, world.observe(state), None))
            return move.state, (move.state.choice, move.reward)

        _, (choice, reward) = jax.lax.scan(step, world.start(index), length=STEPS)
        return choice, jnp.sum(reward) / config.scale

    return jax.vmap(run)(jnp.arange(problems.available.shape[0]))
