# SPDX-License-Identifier: MIT
"""The DRL-Feasibility agent, trained on infeasible segments: settings, networks, rollouts."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from hybrid_jax.agents import networks, ppo, sac
from hybrid_jax.contracts import Segments
from hybrid_jax.envs import base
from hybrid_jax.envs.paper_reach import PaperReachConfig, PaperReachEnv
from hybrid_jax.envs.reach import ReachConfig, ReachEnv
from hybrid_jax.runtime.compiler_options import quick_options
from hybrid_jax.runtime.keys import fold_in
from hybrid_jax.types import Workcell

TRIES = 16
"""Rollouts of a segment of which the best counts in `success_rates`."""
WIDEST = 1.5
"""Spread of the boldest rollout. The first follows the policy's mode; spreads grow evenly."""


@dataclass(frozen=True)
class JointAgentConfig:
    """Training and use of the joint-space agent."""

    training: ppo.PpoConfig | sac.SacConfig = ppo.PpoConfig(epochs=2, entropy=0.0)
    """Settings of the training; their type selects the algorithm."""
    reach: ReachConfig | PaperReachConfig = ReachConfig()
    """Rules of the environment; their type selects the environment."""
    rollouts: tuple[int, ...] = (4, 64)
    """Rollouts of a segment in the first attempt, and in each next one where the last failed."""
    enough: float = 0.5
    """Share of the rollouts that must arrive; the others, which would be longer, are given up."""
    candidates: int = 4
    """Number of shortest rollouts among which the best is picked."""
    clearance_worth: float = 10.0
    """Length of a joint path that a metre of clearance is worth [rad/m]."""
    ample_clearance: float = 0.05
    """Clearance above which more is worth nothing [m]."""
    edge_samples: int = 4
    """Clearance checks along a move at planning time. With two, the exact check refuses one path
    in ten, and a policy that learned with two may insist on moves that planning refuses. Training
    uses three."""


def env_kind(config: JointAgentConfig) -> type[ReachEnv] | type[PaperReachEnv]:
    """Class of the environment that a configuration selects."""
    return PaperReachEnv if isinstance(config.reach, PaperReachConfig) else ReachEnv


def make_env(
    cell: Workcell, segments: Segments, config: JointAgentConfig
) -> ReachEnv | PaperReachEnv:
    """The agent's training environment over segments with `[segment, joint]` ends [rad]."""
    if isinstance(config.reach, PaperReachConfig):
        return PaperReachEnv(cell, segments, config.reach)
    return ReachEnv(cell, segments, config.reach)


def planning_env(
    cell: Workcell, segments: Segments, config: JointAgentConfig
) -> ReachEnv | PaperReachEnv:
    """The environment for planning, with finer checks, over `[segment, joint]` ends [rad]."""
    reach = replace(config.reach, edge_samples=config.edge_samples)
    return make_env(cell, segments, replace(config, reach=reach))


def uses_mjx(config: JointAgentConfig) -> bool:
    """Is MJX part of a step of the agent's environment?"""
    return isinstance(config.reach, ReachConfig) and config.reach.uses_mjx


def compiler_options(config: JointAgentConfig) -> dict[str, int | bool]:
    """Options of XLA's compiler for programs of the agent's rollouts; none by default."""
    return quick_options() if uses_mjx(config) else {}


def observation_length(cell: Workcell, config: JointAgentConfig) -> int:
    """Length of the agent's observation."""
    return env_kind(config).observation_length(cell)


def make_net(cell: Workcell, config: JointAgentConfig) -> networks.ActorCritic:
    """Networks of the agent for a cell's robot."""
    sizes = observation_length(cell, config), cell.home.size, config.training.hidden
    if isinstance(config.training, sac.SacConfig):
        return sac.make_networks(*sizes)
    return networks.make_networks(*sizes, discrete=False)


def rollouts(
    env: ReachEnv | PaperReachEnv,
    net: networks.ActorCritic,
    policy: networks.Policy,
    index: Array,
    spread: Array,
    key: Array,
    enough: int | Array | None = None,
) -> tuple[Array, Array]:
    """Run one rollout for each entry of `index`, until they arrive or the horizon is reached.

    Args:
        env: of the segments.
        net, policy: the trained agent.
        index: `[rollout]` segment of each rollout.
        spread: `[rollout]` 0 for the policy's mode, 1 for its samples, see `networks.act`.
        key: consumed.
        enough: stop once so many rollouts of each segment have arrived, one number or `[segment]`;
            all if None.

    Returns:
        Way points `[horizon + 2, rollout, joint]` [rad] from start to goal, the last state
        repeated after an episode's end, and `[rollout]` True where the goal was reached.
    """
    segments, count = env.segments, len(index)
    per_segment = jnp.zeros(segments.start.shape[0], int).at[index].add(1)
    target_count = per_segment if enough is None else jnp.minimum(enough, per_segment)

    def unfinished(carry):
        step, _, reached, _ = carry
        arrived = jnp.zeros_like(target_count).at[index].add(reached)
        return (step < env.config.horizon) & jnp.any(arrived < target_count)

    def advance(carry):
        step, state, reached, q = carry
        obs = jax.vmap(env.observe)(state)
        action = networks.act(net, policy, obs, jax.random.fold_in(key, step), spread[:, None])
        result = jax.vmap(env.step)(state, action)
        state = base.choose_states(reached, state, result.state)
        return step + 1, state, reached | result.success, q.at[step].set(state.q)

    start, goal = segments.start[index], segments.goal[index]
    state = jax.vmap(env.start)(index, start)
    q = jnp.zeros((env.config.horizon, *start.shape), start.dtype)
    steps, state, reached, q = jax.lax.while_loop(
        unfinished, advance, (0, state, jnp.zeros(count, bool), q)
    )
    done = jnp.arange(env.config.horizon)[:, None, None] >= steps
    return jnp.concatenate([start[None], jnp.where(done, state.q, q), goal[None]]), reached


def spreads(count: int) -> np.ndarray:
    """Spreads `[rollout]` of `count` rollouts of a segment, from the mode (0) to the boldest."""
    return np.linspace(0.0, WIDEST, count, dtype=np.float32)


def success_rates(
    cell: Workcell,
    net: networks.ActorCritic,
    policy: networks.Policy,
    config: JointAgentConfig,
    segments: Segments,
    key: Array,
) -> tuple[float, float]:
    """Success rates of the agent: by the policy's mode alone, and by the best of `TRIES` rollouts.

    The environment defines success. In the paper's, the tool ends within 25 cm of the goal, free
    there if not on the way.

    Args:
        cell: robot and fixtures.
        net, policy: the trained agent.
        config: rules of the environment.
        segments: problems with `[segment, joint]` ends [rad].
        key: consumed.

    Returns:
        Two shares of the segments, from 0 to 1.
    """
    count = segments.start.shape[0]

    def run(policy, segments, index, spread, key):
        env = planning_env(cell, segments, config)
        return rollouts(env, net, policy, index, spread, key)[1]

    compiled = jax.jit(run, compiler_options=compiler_options(config))
    solved = np.array(compiled(policy, segments, np.arange(count), spreads(1).repeat(count), key))
    single = float(solved.mean())
    # the others of those that the mode has not solved, in calls of the same size: one program
    unsolved = np.flatnonzero(~solved)
    index, spread = np.tile(unsolved, TRIES - 1), np.repeat(spreads(TRIES)[1:], len(unsolved))
    for number, first in enumerate(range(0, len(index), count)):
        rows = np.minimum(np.arange(first, first + count), len(index) - 1)
        reached = compiled(policy, segments, index[rows], spread[rows], fold_in(key, number))
        np.logical_or.at(solved, index[rows], np.asarray(reached))
    return single, float(solved.mean())
