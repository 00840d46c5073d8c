# SPDX-License-Identifier: MIT
"""The DRL-Feasibility agent: trained on infeasible segments, used as best of many rollouts."""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from hybrid_jax import rrt
from hybrid_jax.agents import ppo
from hybrid_jax.planner.harvest import Segments
from hybrid_jax.simulation.reach import ReachConfig, ReachEnv, resample_path
from hybrid_jax.types import Scene, Workcell

Bridger = Callable[[Scene, np.ndarray, np.ndarray, Array], np.ndarray | None]
"""(scene, start, goal, key) to collision-free way points from start to goal, or None."""

PATH_POINTS = 32
"""Way points kept of an expert's path."""


@dataclass(frozen=True)
class JointAgentConfig:
    """Training and use of the joint-space agent."""

    training: ppo.PpoConfig = ppo.PpoConfig()
    reach: ReachConfig = ReachConfig()
    expert: rrt.RrtConfig = rrt.RrtConfig()
    rollouts: int = 48
    """Stochastic rollouts of one planning call."""
    retries: int = 2
    """Planning calls before the agent gives up."""


def expert_paths(
    cell: Workcell, segments: Segments, config: JointAgentConfig, key: Array
) -> tuple[Segments, np.ndarray]:
    """The segments that RRT-Connect solves, and its paths `[segment, point, joint]`.

    Episodes may start anywhere on them: the agent learns the way out of an enclosure backwards.
    """
    paths = rrt.plan_paths(
        cell, segments.scene, segments.start, segments.goal, config.expert, key=key
    )
    solved = np.array([i for i, path in enumerate(paths) if path is not None])
    if not len(solved):
        raise ValueError("RRT-Connect solved none of the infeasible segments: no start states")
    kept = jax.tree.map(lambda a: a[solved], segments)
    return kept, np.stack([resample_path(paths[i], PATH_POINTS) for i in solved]).astype(np.float32)


def make_env(
    cell: Workcell, segments: Segments, paths: np.ndarray, config: JointAgentConfig
) -> ReachEnv:
    """The world that the agent trains in."""
    return ReachEnv(cell, segments, jnp.asarray(paths), config.reach)


def make_net(cell: Workcell, config: JointAgentConfig) -> ppo.ActorCritic:
    """Networks of the agent for a robot."""
    joints = cell.home.size
    return ppo.make_networks(
        ReachEnv.observation_length(joints), joints, config.training.hidden, discrete=False
    )


def rollouts(
    cell: Workcell,
    net: ppo.ActorCritic,
    policy: ppo.Policy,
    config: ReachConfig,
    segments: Segments,
    index: Array,
    keys: Array,
):
    """Run one stochastic rollout for each entry of `index`.

    Returns:
        Way points `[rollout, horizon + 1, joint]` that stay where an episode ended, and whether
        each reached its goal.
    """
    env = ReachEnv(cell, segments, segments.start[:, None], config)

    def run(segment, key):
        state = env.begin(segment, segments.start[segment])

        def step(carry, key):
            state, reached = carry
            after = env.step(state, ppo.act(net, policy, state.obs, key))
            state = jax.tree.map(lambda a, b: jnp.where(reached, a, b), state, after)
            return (state, reached | (after.metrics["success"] > 0)), state.pipeline_state.q

        (_, reached), q = jax.lax.scan(
            step, (state, jnp.array(False)), jax.random.split(key, config.horizon)
        )
        return jnp.concatenate([segments.start[segment][None], q]), reached

    return jax.vmap(run)(index, keys)


def success_rates(
    cell: Workcell,
    net: ppo.ActorCritic,
    policy: ppo.Policy,
    config: JointAgentConfig,
    segments: Segments,
    key: Array,
) -> tuple[float, float]:
    """Share of single rollouts, and of segments by the best of 16, that reach the goal."""
    count = segments.start.shape[0]
    index = jnp.tile(jnp.arange(count), 16)
    run = jax.jit(
        lambda policy, segments, keys: rollouts(
            cell, net, policy, config.reach, segments, index, keys
        )[1]
    )
    reached = np.asarray(run(policy, segments, jax.random.split(key, len(index))))
    table = reached.reshape(16, count)
    return float(table.mean()), float(table.any(axis=0).mean())


def make_bridger(
    cell: Workcell, net: ppo.ActorCritic, policy: ppo.Policy, config: JointAgentConfig
) -> Bridger:
    """The trained agent as a function that the planner calls."""

    @jax.jit
    def run(policy, segments, key):
        index = jnp.zeros(config.rollouts, int)
        return rollouts(
            cell, net, policy, config.reach, segments, index, jax.random.split(key, config.rollouts)
        )

    def bridge(scene, start, goal, key):
        one = Segments(
            jax.tree.map(lambda a: a[None], scene),
            jnp.asarray(start)[None],
            jnp.asarray(goal)[None],
        )
        for attempt in range(config.retries):
            q, reached = jax.device_get(run(policy, one, jax.random.fold_in(key, attempt)))
            if reached.any():
                length = np.abs(np.diff(q, axis=1)).sum(axis=(1, 2))
                best = q[np.argmin(np.where(reached, length, np.inf))]
                moved = np.abs(np.diff(best, axis=0)).max(axis=1) > 1e-6
                return np.concatenate([best[:1], best[1:][moved], np.asarray(goal)[None]])
        return None

    return bridge
