# SPDX-License-Identifier: MIT
"""The DRL-Feasibility agent: trained on infeasible segments, used as the best of many rollouts."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from hybrid_jax.agents import networks, ppo, sac
from hybrid_jax.contracts import Bridger, Segments, take
from hybrid_jax.envs import base
from hybrid_jax.envs.paper_reach import PaperReachConfig, PaperReachEnv
from hybrid_jax.envs.reach import ReachConfig, ReachEnv
from hybrid_jax.envs.segments import refuse_infeasible
from hybrid_jax.kernels.batching import padded_chunks
from hybrid_jax.kernels.collision.clearance import clearance_up_to
from hybrid_jax.kernels.collision.motion_validation import paths_are_free
from hybrid_jax.runtime.kept_programs import kept
from hybrid_jax.runtime.keys import fold_in
from hybrid_jax.types import Workcell

SEGMENTS_PER_CALL = 16
"""Segments that are bridged in one call."""
RANKED = 32
"""Way points of a rollout at which clearance is measured to rank it."""
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
    if isinstance(config.reach, ReachConfig):
        config = replace(config, reach=replace(config.reach, edge_samples=config.edge_samples))
    return make_env(cell, segments, config)


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
    enough: int | None = None,
) -> tuple[Array, Array]:
    """Run one rollout for each entry of `index`, until they arrive or the horizon is reached.

    Args:
        env: of the segments.
        net, policy: the trained agent.
        index: `[rollout]` segment of each rollout.
        spread: `[rollout]` 0 for the policy's mode, 1 for its samples, see `networks.act`.
        key: consumed.
        enough: stop once so many rollouts of each segment have arrived; all if None.

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


def spreads(count: int) -> Array:
    """Spreads `[rollout]` of `count` rollouts of a segment, from the mode (0) to the boldest."""
    return jnp.linspace(0.0, WIDEST, count)


def success_rates(
    cell: Workcell,
    net: networks.ActorCritic,
    policy: networks.Policy,
    config: JointAgentConfig,
    segments: Segments,
    key: Array,
) -> tuple[float, float]:
    """Success rates of the agent: by the policy's mode alone, and by the best of 16 rollouts.

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
    # rollout-major: entry r * count + i is rollout r of segment i
    count = segments.start.shape[0]
    index, spread = jnp.tile(jnp.arange(count), 16), jnp.repeat(spreads(16), count)

    @jax.jit
    def run(policy, segments, key):
        env = planning_env(cell, segments, config)
        return rollouts(env, net, policy, index, spread, key)[1]

    reached = np.asarray(run(policy, segments, key))
    table = reached.reshape(16, count)
    return float(table[0].mean()), float(table.any(axis=0).mean())


def _best_first(
    inside: Workcell, q: Array, reached: Array, config: JointAgentConfig
) -> tuple[Array, Array]:
    """The shortest of `[point, rollout, joint]` rollouts, best first by length and clearance.

    Returns paths `[candidate, point, joint]`, and `[candidate]` True for those that arrived.
    """
    length = jnp.where(reached, jnp.sum(jnp.abs(jnp.diff(q, axis=0)), axis=(0, 2)), jnp.inf)
    shortest = jnp.argsort(length)[: config.candidates]
    length = length[shortest]
    paths = jnp.swapaxes(q[:, shortest], 0, 1)
    measure = lambda point: clearance_up_to(inside, point, config.ample_clearance)  # noqa: E731
    gap = jnp.min(jax.vmap(jax.vmap(measure))(jax.vmap(_ranked_points)(paths)), axis=1)
    order = jnp.argsort(length - config.clearance_worth * gap)
    return paths[order], jnp.isfinite(length)[order]


def _ranked_points(path: Array) -> Array:
    """`[RANKED, joint]` way points spread evenly over a path `[point, joint]` until it rests."""
    moving = jnp.any(jnp.diff(path[:-1], axis=0) != 0, axis=-1)
    last = jnp.max(jnp.where(moving, jnp.arange(1, len(path) - 1), 0))
    return path[jnp.round(jnp.linspace(0.0, last, RANKED)).astype(int)]


def _moved(q: np.ndarray) -> np.ndarray:
    """Way points `[point, joint]` without those that repeat their predecessor."""
    changed = np.abs(np.diff(q, axis=0)).max(axis=1) > 1e-6
    return np.concatenate([q[:1], q[1:][changed]])


@kept(static=("each", "config"))
def _ranked_rollouts(
    cell: Workcell,
    policy: networks.Policy,
    segments: Segments,
    key: Array,
    each: int,
    config: JointAgentConfig,
) -> tuple[Array, Array]:
    """`each` rollouts of every segment, the best first, see `_best_first`; `[segment, ...]`."""
    env, count = planning_env(cell, segments, config), segments.start.shape[0]
    net = make_net(cell, config)
    index = jnp.repeat(jnp.arange(count), each)
    spread, enough = jnp.tile(spreads(each), count), max(1, int(config.enough * each))
    q, reached = rollouts(env, net, policy, index, spread, key, enough)
    q = jnp.moveaxis(q.reshape(len(q), count, each, -1), 1, 0)
    rank = lambda scene, q, reached: _best_first(  # noqa: E731
        cell.replace(scene=scene), q, reached, config
    )
    return jax.vmap(rank)(segments.scene, q, reached.reshape(count, -1))


def make_bridger(cell: Workcell, policy: networks.Policy, config: JointAgentConfig) -> Bridger:
    """The trained agent as a function that the planner calls.

    The shortest rollouts are ranked by length and clearance; the first whose every edge is proven
    free is returned.

    Args:
        cell: robot and fixtures.
        policy: the trained agent; agents of one cell and `config` share their programs.
        config: of its training; number of rollouts, ranking and checks.

    Returns:
        A `Bridger`: from segments with `[segment, joint]` ends [rad] and a key to way points
        `[point, joint]` [rad] of each, None where no free path was found.

    Raises:
        SegmentError: the function, if an end of a segment is outside the limits or not free.
    """

    def attempt(segments, key, ways, index, each):
        """Bridge the segments `index` by `each` rollouts, where possible; fills in their `ways`."""
        ranked, arrived = jax.device_get(
            _ranked_rollouts(cell, policy, take(segments, index), key, each, config)
        )
        for rank in range(ranked.shape[1]):
            rows = [r for r in range(len(index)) if ways[index[r]] is None and arrived[r, rank]]
            paths = [_moved(ranked[r, rank]) for r in rows]
            if not rows:
                continue
            scenes = take(segments, index[rows]).scene
            for row, path, free in zip(
                rows, paths, paths_are_free(cell, scenes, paths), strict=True
            ):
                if free:
                    ways[index[row]] = path

    def bridge(segments: Segments, key: Array) -> list[np.ndarray | None]:
        refuse_infeasible(cell, segments, 0.0)
        solutions: list[np.ndarray | None] = [None] * segments.start.shape[0]
        for number, each in enumerate(config.rollouts):
            unsolved = np.array([i for i, path in enumerate(solutions) if path is None], int)
            for part, (chunk, _) in enumerate(padded_chunks(len(unsolved), SEGMENTS_PER_CALL)):
                key_part = fold_in(fold_in(key, number), part)
                attempt(segments, key_part, solutions, unsolved[chunk], each)
        return solutions

    return bridge
