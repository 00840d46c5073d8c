# SPDX-License-Identifier: MIT
"""The DRL-Feasibility agent: trained on infeasible segments, used as best of many rollouts."""

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from hybrid_jax.agents import networks, ppo, sac, worlds
from hybrid_jax.agents.segments import Segments, refuse_infeasible, take
from hybrid_jax.kernels.batching import padded_chunks
from hybrid_jax.kernels.collision import clearance_up_to
from hybrid_jax.kernels.edges import paths_are_free
from hybrid_jax.keys import fold_in
from hybrid_jax.simulation.paperreach import PaperReachConfig, PaperReachWorld
from hybrid_jax.simulation.reach import ReachConfig, ReachWorld
from hybrid_jax.types import Workcell

Bridger = Callable[[Segments, Array], list[np.ndarray | None]]
"""(segments, key) to collision-free way points from start to goal of each, or None."""

TOGETHER = 16
"""Segments that are bridged in one call."""
RANKED = 32
"""Way points of a rollout whose clearance ranks it; most are shorter."""
WIDEST = 1.5
"""Spread of the boldest rollout; the first follows the policy's mode, those between grow bolder."""


@dataclass(frozen=True)
class JointAgentConfig:
    """Training and use of the joint-space agent."""

    training: ppo.PpoConfig | sac.SacConfig = ppo.PpoConfig(epochs=2, entropy=0.0)
    """Their type says which algorithm trains."""
    reach: ReachConfig | PaperReachConfig = ReachConfig()
    """Their type says which world it learns in."""
    rollouts: tuple[int, ...] = (4, 64)
    """Rollouts of a planning call, and of the next one where it finds nothing."""
    enough: float = 0.5
    """Share of them that must arrive before the others, which would be longer, are given up."""
    candidates: int = 4
    """Shortest rollouts among which the best is picked."""
    clearance_worth: float = 10.0
    """Way of the joints that a metre of clearance is worth [rad/m], ..."""
    ample_clearance: float = 0.05
    """... up to this clearance [m]."""
    edge_samples: int = 4
    """Clearance checks along a move at planning time. With two, one path in ten is refused by the
    exact check, and the mode of a policy that learned with two may insist on moves that planning
    refuses: three is what it trains with."""


def world_kind(config: JointAgentConfig) -> type[ReachWorld] | type[PaperReachWorld]:
    """The world that a configuration's rules are of."""
    return PaperReachWorld if isinstance(config.reach, PaperReachConfig) else ReachWorld


def make_world(
    cell: Workcell, segments: Segments, config: JointAgentConfig
) -> ReachWorld | PaperReachWorld:
    """The world of the agent with some segments."""
    return world_kind(config)(cell, segments, config.reach)


def planning_world(
    cell: Workcell, segments: Segments, config: JointAgentConfig
) -> ReachWorld | PaperReachWorld:
    """The same as it is used for planning: with finer checks."""
    if isinstance(config.reach, ReachConfig):
        config = replace(config, reach=replace(config.reach, edge_samples=config.edge_samples))
    return make_world(cell, segments, config)


def observation_length(cell: Workcell, config: JointAgentConfig) -> int:
    """How many numbers the agent sees."""
    return world_kind(config).observation_length(cell)


def make_net(cell: Workcell, config: JointAgentConfig) -> networks.ActorCritic:
    """Networks of the agent for a robot."""
    sizes = observation_length(cell, config), cell.home.size, config.training.hidden
    if isinstance(config.training, sac.SacConfig):
        return sac.make_networks(*sizes)
    return networks.make_networks(*sizes, discrete=False)


def rollouts(
    world: ReachWorld | PaperReachWorld,
    net: networks.ActorCritic,
    policy: networks.Policy,
    index: Array,
    spread: Array,
    key: Array,
    enough: int | None = None,
) -> tuple[Array, Array]:
    """Run one rollout for each entry of `index`, until they arrive or the horizon is reached.

    Args:
        world: of the segments.
        net, policy: the trained agent.
        index: `[rollout]` segment of each.
        spread: `[rollout]` 0 for the policy's mode, 1 for its samples, see `networks.act`.
        key: consumed.
        enough: stop once so many of each segment have arrived; all if None.

    Returns:
        Way points `[horizon + 2, rollout, joint]` that stay where an episode ended and close with
        the goal, and whether each reached it.
    """
    segments, count = world.segments, len(index)
    asked = jnp.zeros(segments.start.shape[0], int).at[index].add(1)
    wanted = asked if enough is None else jnp.minimum(enough, asked)

    def going(carry):
        step, _, reached, _ = carry
        arrived = jnp.zeros_like(wanted).at[index].add(reached)
        return (step < world.config.horizon) & jnp.any(arrived < wanted)

    def advance(carry):
        step, state, reached, q = carry
        obs = jax.vmap(world.observe)(state)
        chosen = networks.act(net, policy, obs, jax.random.fold_in(key, step), spread[:, None])
        move = jax.vmap(world.step)(state, chosen)
        state = worlds.choose_states(reached, state, move.state)
        return step + 1, state, reached | move.success, q.at[step].set(state.q)

    first, last = segments.start[index], segments.goal[index]
    state = jax.vmap(world.start)(index, first)
    q = jnp.zeros((world.config.horizon, *first.shape), first.dtype)
    steps, state, reached, q = jax.lax.while_loop(
        going, advance, (0, state, jnp.zeros(count, bool), q)
    )
    done = jnp.arange(world.config.horizon)[:, None, None] >= steps
    return jnp.concatenate([first[None], jnp.where(done, state.q, q), last[None]]), reached


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
    """Share of segments that end well: by the policy's mode alone, and by the best of 16.

    As the world says: in the paper's, within 25 cm, free there if not on the way.
    """
    count = segments.start.shape[0]
    index, spread = jnp.tile(jnp.arange(count), 16), jnp.repeat(spreads(16), count)

    @jax.jit
    def run(policy, segments, key):
        world = planning_world(cell, segments, config)
        return rollouts(world, net, policy, index, spread, key)[1]

    reached = np.asarray(run(policy, segments, key))
    table = reached.reshape(16, count)
    return float(table[0].mean()), float(table.any(axis=0).mean())


def _best_first(
    inside: Workcell, q: Array, reached: Array, config: JointAgentConfig
) -> tuple[Array, Array]:
    """The shortest rollouts `[candidate, point, joint]`, best first by length and clearance."""
    length = jnp.where(reached, jnp.sum(jnp.abs(jnp.diff(q, axis=0)), axis=(0, 2)), jnp.inf)
    shortest = jnp.argsort(length)[: config.candidates]
    length = length[shortest]
    paths = jnp.swapaxes(q[:, shortest], 0, 1)
    measure = lambda point: clearance_up_to(inside, point, config.ample_clearance)  # noqa: E731
    gap = jnp.min(jax.vmap(jax.vmap(measure))(jax.vmap(_ranked_points)(paths)), axis=1)
    order = jnp.argsort(length - config.clearance_worth * gap)
    return paths[order], jnp.isfinite(length)[order]


def _ranked_points(path: Array) -> Array:
    """`[RANKED, joint]` way points of a rollout, all of them if they are no more."""
    moving = jnp.any(jnp.diff(path[:-1], axis=0) != 0, axis=-1)
    last = jnp.max(jnp.where(moving, jnp.arange(1, len(path) - 1), 0))
    return path[jnp.round(jnp.linspace(0.0, last, RANKED)).astype(int)]


def _moved(q: np.ndarray) -> np.ndarray:
    """Way points `[point, joint]` without those that repeat the one before."""
    moved = np.abs(np.diff(q, axis=0)).max(axis=1) > 1e-6
    return np.concatenate([q[:1], q[1:][moved]])


def make_bridger(
    cell: Workcell, net: networks.ActorCritic, policy: networks.Policy, config: JointAgentConfig
) -> Bridger:
    """The trained agent as a function that the planner calls: `make_bridging` of one policy."""
    return functools.partial(make_bridging(cell, net, config), policy)


def make_bridging(
    cell: Workcell, net: networks.ActorCritic, config: JointAgentConfig
) -> Callable[..., np.ndarray | None]:
    """A function of a policy and of what a `Bridger` takes; its programs serve all policies.

    The shortest rollouts are ranked by length and clearance; the first whose every edge is proven
    free is returned.

    Raises:
        SegmentError: the function, if an end of a segment is outside the limits or not free.
    """

    @functools.partial(jax.jit, static_argnames="each")
    def run(policy, segments, key, each):
        world, count = planning_world(cell, segments, config), segments.start.shape[0]
        index = jnp.repeat(jnp.arange(count), each)
        wide, enough = jnp.tile(spreads(each), count), max(1, int(config.enough * each))
        q, reached = rollouts(world, net, policy, index, wide, key, enough)
        q = jnp.moveaxis(q.reshape(len(q), count, each, -1), 1, 0)
        rank = lambda scene, q, reached: _best_first(  # noqa: E731
            cell.replace(scene=scene), q, reached, config
        )
        return jax.vmap(rank)(segments.scene, q, reached.reshape(count, -1))

    def attempt(policy, segments, key, ways, index, each):
        """Bridge the segments `index`, as far as it goes, by so many rollouts each."""
        ranked, arrived = jax.device_get(run(policy, take(segments, index), key, each))
        for rank in range(ranked.shape[1]):
            rows = [r for r in range(len(index)) if ways[index[r]] is None and arrived[r, rank]]
            paths = [_moved(ranked[r, rank]) for r in rows]
            scenes = take(segments, index[rows]).scene if rows else None
            for row, path, free in zip(
                rows, paths, paths_are_free(cell, scenes, paths), strict=True
            ):
                if free:
                    ways[index[row]] = path

    def bridge(policy, segments, key):
        refuse_infeasible(cell, segments, 0.0)
        ways: list[np.ndarray | None] = [None] * segments.start.shape[0]
        for number, each in enumerate(config.rollouts):
            missing = np.array([i for i, way in enumerate(ways) if way is None], int)
            for part, (chunk, _) in enumerate(padded_chunks(len(missing), TOGETHER)):
                key_part = fold_in(fold_in(key, number), part)
                attempt(policy, segments, key_part, ways, missing[chunk], each)
        return ways

    return bridge
