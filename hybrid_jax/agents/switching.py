# SPDX-License-Identifier: MIT
"""The switching agent: when to follow the skill and when the joint agent (discrete PPO).

Both joint motions of a phase run on one grid of `STEPS` points; at every point the agent chooses
one. The paper's reward, manipulability minus collision, has no term that joins neighbouring
points; here costs of a jump and of a switch are added. With two choices a step the optimum is a
Viterbi path: `optimal_switching` is the oracle.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, PRNGKeyArray

from hybrid_jax.agents import networks, ppo
from hybrid_jax.contracts import STEPS, Combined, Switcher
from hybrid_jax.envs.base import StepResult
from hybrid_jax.mjx.collision import Backend
from hybrid_jax.mjx.executed_motion import Physics
from hybrid_jax.runtime.kept_programs import kept
from hybrid_jax.types import Record, pytree

AHEAD = 5
"""Number of next points of both motions that the agent sees."""


@dataclass(frozen=True)
class SwitchConfig:
    """Reward and training of the switching agent."""

    collision: float = 5.0
    """Cost of an infeasible point."""
    jump: float = 5.0
    """Cost of each further `allowed` by which a joint step exceeds `allowed`."""
    switch: float = 0.5
    """Cost of changing the source."""
    allowed: float = 0.15
    """Joint step between grid points that costs nothing [rad]."""
    backend: Backend = "fused"
    """What tells whether a point collides: `fused` (the labels of the skill) or `mjx`."""
    physics: Physics = "kinematic"
    """What is judged: a motion as it is planned, or as the arm's servos execute it (`mjx`)."""
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
class SwitchState(Record):
    """State of one episode."""

    problem: Array
    """Index of the combined trajectory."""
    step: Array
    """Index of the next grid point."""
    q: Array
    """`[joint]` last chosen configuration."""
    choice: Array
    """Last choice: 0 skill, 1 joint agent."""


def point_reward(data: Combined, config: SwitchConfig) -> Float[Array, "2 STEPS"]:
    """Part of the reward that depends on one point only, `[2, STEPS]` for skill and joint agent."""
    reward = data.manipulability - config.collision * data.collision
    return reward.at[1].add(-2 * config.collision * (1 - data.available))


def step_reward(before: Array, after: Array, config: SwitchConfig) -> Array:
    """Reward of the joint step between configurations `[..., joint]` [rad]: at most 0, `[...]`."""
    size = jnp.max(jnp.abs(after - before), axis=-1)
    return -config.jump * jnp.maximum(0.0, size - config.allowed) / config.allowed


class SwitchEnv:
    """An `Env` (see `envs.base`) of combined trajectories."""

    action_size = 2

    def __init__(self, problems: Combined, config: SwitchConfig = SwitchConfig()):
        """Make an environment of some problems.

        Args:
            problems: stacked along a leading axis: `q` is `[problem, 2, STEPS, joint]` [rad].
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

    def observe(self, state: SwitchState) -> Float[Array, " obs"]:
        """Observation `[obs]`: the next points of both motions, their quality, the last choice.

        The points are relative to the present configuration.
        """
        data = self._problem(state.problem)
        t = jnp.minimum(state.step, STEPS - 1)
        window = jnp.minimum(t + jnp.arange(AHEAD + 1), STEPS - 1)
        return jnp.concatenate(
            [
                state.q,
                (data.q[:, window] - state.q).reshape(-1),
                data.manipulability[:, t],
                data.collision[:, t],
                data.available[t][None],
                jnp.stack([state.choice.astype(jnp.float32), state.step / STEPS]),
            ]
        )

    def start(self, index: Array) -> SwitchState:
        """State at the start of problem `index` `[]`: the arm stands where the skill begins."""
        zero = jnp.zeros((), jnp.int32)
        return SwitchState(index, zero, self.problems.q[index, 0, 0], zero)

    def reset(self, key: PRNGKeyArray) -> SwitchState:
        """State at the start of a random problem."""
        return self.start(jax.random.randint(key, (), 0, self.problems.available.shape[0]))

    def truncated(self, state: SwitchState) -> Array:
        """Always False `[]`: an episode ends with the trajectory."""
        return jnp.zeros_like(state.step, bool)

    def step(self, state: SwitchState, action: Array) -> StepResult:
        """Go to the next grid point by `action` `[]`: 0 skill, 1 joint agent."""
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
        next_state = SwitchState(state.problem, state.step + 1, q, choice)
        done = next_state.step >= STEPS
        return StepResult(
            next_state,
            self.config.scale * reward,
            done,
            done & (collides == 0),
            {"infeasible": collides},
        )


def episode_return(
    data: Combined, choice: Float[Array, " STEPS"], config: SwitchConfig
) -> Float[Array, ""]:
    """Total reward of some choices on one problem.

    Args:
        data: `[2, STEPS, joint]` configurations, `[2, STEPS]` manipulability and collision.
        choice: `[STEPS]` 0 skill, 1 joint agent; read as 0 where the joint agent has no motion.
        config: reward.

    Returns:
        `[]` total reward, not scaled.
    """
    choice = jnp.where(data.available > 0, choice, 0).astype(jnp.int32)
    at = jnp.arange(STEPS)
    q = data.q[choice, at]
    previous_q = jnp.concatenate([data.q[0, :1], q[:-1]])
    changes = choice != jnp.concatenate([jnp.zeros(1, jnp.int32), choice[:-1]])
    points = point_reward(data, config)[choice, at]
    return jnp.sum(points + step_reward(previous_q, q, config) - config.switch * changes)


def optimal_switching(data: Combined, config: SwitchConfig) -> tuple[np.ndarray, float]:
    """Best choices `[STEPS]` and their total reward, by dynamic programming (Viterbi).

    Args:
        data: one problem: `[2, STEPS, joint]` configurations, `[2, STEPS]` rewards of points.
        config: reward.
    """
    choice, value = _viterbi(data, config)
    return np.asarray(choice), float(value)


@kept(static=("config",))
def _viterbi(data: Combined, config: SwitchConfig) -> tuple[Array, Array]:
    q = data.q
    points = point_reward(data, config)
    points = points.at[1].set(jnp.where(data.available > 0, points[1], -jnp.inf))
    # [from, to, step]: reward of going from one choice to the next
    moves = step_reward(q[:, None, :-1], q[None, :, 1:], config)
    moves -= config.switch * (1 - jnp.eye(2))[:, :, None]
    entering = step_reward(q[0, 0], q[1, 0], config) - config.switch

    def advance(value, step):
        point, move = step
        totals = value[:, None] + move
        return jnp.max(totals, axis=0) + point, jnp.argmax(totals, axis=0)

    initial = points[:, 0].at[1].add(entering)
    value, backpointers = jax.lax.scan(
        advance, initial, (points[:, 1:].T, jnp.moveaxis(moves, 2, 0))
    )
    last = jnp.argmax(value)
    choice = jax.lax.scan(lambda at, row: (row[at], row[at]), last, backpointers, reverse=True)[1]
    return jnp.append(choice, last), jnp.max(value)


def make_net(joints: int, config: SwitchConfig) -> networks.ActorCritic:
    """Networks of the agent for an arm with `joints` joints."""
    return networks.make_networks(
        SwitchEnv.observation_length(joints), 2, config.training.hidden, discrete=True
    )


@kept(static=("config",))
def _choices(policy: networks.Policy, problem: Combined, config: SwitchConfig) -> Array:
    """`choose` for one problem: choices `[STEPS]`."""
    net = make_net(problem.q.shape[-1], config)
    return choose(net, policy, jax.tree.map(lambda a: a[None], problem), config)[0][0]


def make_switcher(policy: networks.Policy, config: SwitchConfig) -> Switcher:
    """The trained agent as a function that the planner calls.

    Args:
        policy: the trained agent.
        config: of its training.

    Returns:
        A `Switcher`: from one problem to its choices `[STEPS]`, 0 skill, 1 joint agent.
    """
    return lambda combined: np.asarray(_choices(policy, combined, config))


def choose(
    net: networks.ActorCritic, policy: networks.Policy, problems: Combined, config: SwitchConfig
) -> tuple[Array, Array]:
    """Most likely choices of the trained agent.

    Args:
        net, policy: the trained agent.
        problems: stacked along a leading axis: `q` is `[problem, 2, STEPS, joint]` [rad].
        config: reward.

    Returns:
        Choices `[problem, STEPS]`, 0 skill, 1 joint agent, and total rewards `[problem]`.
    """
    env = SwitchEnv(problems, config)

    def run(index):
        def step(state, _):
            result = env.step(state, networks.act(net, policy, env.observe(state), None))
            return result.state, (result.state.choice, result.reward)

        _, (choice, reward) = jax.lax.scan(step, env.start(index), length=STEPS)
        return choice, jnp.sum(reward) / config.scale

    return jax.vmap(run)(jnp.arange(problems.available.shape[0]))
