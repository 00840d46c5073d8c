# SPDX-License-Identifier: MIT
"""The DRL-Feasibility agent: trained on infeasible segments, used as best of many rollouts."""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from hybrid_jax import rrt
from hybrid_jax.agents import networks, ppo
from hybrid_jax.kernels.edges import edge_is_free
from hybrid_jax.planner.harvest import Segments
from hybrid_jax.simulation.reach import ReachConfig, ReachWorld, resample_path
from hybrid_jax.types import Scene, Workcell

Bridger = Callable[[Scene, np.ndarray, np.ndarray, Array], np.ndarray | None]
"""(scene, start, goal, key) to collision-free way points from start to goal, or None."""

PATH_POINTS = 32
"""Way points kept of an expert's path."""
WIDEST = 1.5
"""Spread of the boldest rollout; the first follows the policy's mode, those between grow bolder."""


@dataclass(frozen=True)
class JointAgentConfig:
    """Training and use of the joint-space agent."""

    training: ppo.PpoConfig = ppo.PpoConfig()
    reach: ReachConfig = ReachConfig()
    expert: rrt.RrtConfig = rrt.RrtConfig()
    rollouts: int = 64
    """Rollouts of one planning call."""
    retries: int = 2
    """Planning calls before the agent gives up."""


def expert_paths(
    cell: Workcell, segments: Segments, config: JointAgentConfig, key: Array
) -> tuple[Segments, np.ndarray]:
    """The segments that RRT-Connect solves, and its paths `[segment, point, joint]`.

    Their lengths are the agent's distance to go, and episodes may start anywhere on them.
    """
    paths = rrt.plan_paths(
        cell, segments.scene, segments.start, segments.goal, config.expert, key=key
    )
    solved = np.array([i for i, path in enumerate(paths) if path is not None])
    if not len(solved):
        raise ValueError("RRT-Connect solved none of the infeasible segments: no start states")
    kept = jax.tree.map(lambda a: a[solved], segments)
    return kept, np.stack([resample_path(paths[i], PATH_POINTS) for i in solved]).astype(np.float32)


def make_net(cell: Workcell, config: JointAgentConfig) -> networks.ActorCritic:
    """Networks of the agent for a robot."""
    return networks.make_networks(
        ReachWorld.observation_length(cell), cell.home.size, config.training.hidden, discrete=False
    )


def rollouts(
    world: ReachWorld,
    net: networks.ActorCritic,
    policy: networks.Policy,
    index: Array,
    spread: Array,
    keys: Array,
) -> tuple[Array, Array]:
    """Run one rollout for each entry of `index`.

    Args:
        world: of the segments.
        net, policy: the trained agent.
        index: `[rollout]` segment of each.
        spread: `[rollout]` 0 for the policy's mode, 1 for its samples, see `networks.act`.
        keys: `[rollout]`, consumed.

    Returns:
        Way points `[rollout, horizon + 2, joint]` that stay where an episode ended and close with
        the goal, and whether each reached it.
    """
    segments = world.segments

    def run(segment, spread, key):
        def step(carry, key):
            state, reached = carry
            action = networks.act(net, policy, world.observe(state), key, spread)
            move = world.step(state, action)
            state = jax.tree.map(lambda a, b: jnp.where(reached, a, b), state, move.state)
            return (state, reached | move.success), state.q

        state = world.start(segment, segments.start[segment])
        (_, reached), q = jax.lax.scan(
            step, (state, jnp.array(False)), jax.random.split(key, world.config.horizon)
        )
        ends = segments.start[segment][None], segments.goal[segment][None]
        return jnp.concatenate([ends[0], q, ends[1]]), reached

    return jax.vmap(run)(index, spread, keys)


def spreads(count: int) -> Array:
    """Spread of each of `count` rollouts of a segment, from the mode to the boldest."""
    return jnp.linspace(0.0, WIDEST, count)


def success_rates(
    cell: Workcell,
    net: networks.ActorCritic,
    policy: networks.Policy,
    config: JointAgentConfig,
    segments: Segments,
    key: Array,
) -> tuple[float, float]:
    """Share of segments that reach the goal: by the policy's mode alone, and by the best of 16."""
    count = segments.start.shape[0]
    index, spread = jnp.tile(jnp.arange(count), 16), jnp.repeat(spreads(16), count)

    @jax.jit
    def run(policy, segments, keys):
        world = ReachWorld(cell, segments, None, config.reach)
        return rollouts(world, net, policy, index, spread, keys)[1]

    reached = np.asarray(run(policy, segments, jax.random.split(key, len(index))))
    table = reached.reshape(16, count)
    return float(table[0].mean()), float(table.any(axis=0).mean())


def make_bridger(
    cell: Workcell, net: networks.ActorCritic, policy: networks.Policy, config: JointAgentConfig
) -> Bridger:
    """The trained agent as a function that the planner calls.

    Rollouts are tried from the shortest on; the first whose every edge is proven free is returned.
    """

    @jax.jit
    def run(policy, segments, key):
        world = ReachWorld(cell, segments, None, config.reach)
        index = jnp.zeros(config.rollouts, int)
        keys = jax.random.split(key, config.rollouts)
        return rollouts(world, net, policy, index, spreads(config.rollouts), keys)

    @jax.jit
    def proven(scene, path):
        inside = cell.replace(scene=scene)
        free, _ = jax.vmap(lambda a, b: edge_is_free(inside, a, b))(path[:-1], path[1:])
        return jnp.all(free)

    def bridge(scene, start, goal, key):
        one = Segments(
            jax.tree.map(lambda a: a[None], scene),
            jnp.asarray(start)[None],
            jnp.asarray(goal)[None],
        )
        for attempt in range(config.retries):
            q, reached = jax.device_get(run(policy, one, jax.random.fold_in(key, attempt)))
            length = np.where(reached, np.abs(np.diff(q, axis=1)).sum(axis=(1, 2)), np.inf)
            for best in np.argsort(length)[: int(reached.sum())]:
                if proven(scene, q[best]):
                    moved = np.abs(np.diff(q[best], axis=0)).max(axis=1) > 1e-6
                    return np.concatenate([q[best][:1], q[best][1:][moved]])
        return None

    return bridge
