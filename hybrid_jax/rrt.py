# SPDX-License-Identifier: MIT
"""RRT-Connect for many problems in lockstep, on the collision kernels.

Reference: Kuffner, LaValle, "RRT-Connect: An Efficient Approach to Single-Query Path Planning",
ICRA 2000. It tells which problems have a solution; nothing that it returns is used unchecked.
"""

import functools
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, PRNGKeyArray

from hybrid_jax.kernels.collision import clearance, edge_clearance, points_between
from hybrid_jax.types import Scene, Workcell, pytree


@dataclass(frozen=True)
class RrtConfig:
    """Settings of the planner."""

    nodes: int = 400
    """Capacity of each of the two trees, and number of iterations."""
    step: float = 0.5
    """Length of an extension in joint space [rad]."""
    reach: float = 1.5
    """Longest edge that may join the trees [rad]."""
    edge_samples: int = 5
    """Checks along an extension."""
    join_samples: int = 12
    """Checks along the edge that joins the trees."""
    goal_bias: float = 0.2
    """Share of samples that aim at the other tree's root."""
    margin: float = 0.004
    """Clearance to keep [m]."""
    spread: float = 1.2
    """Samples are drawn from the box of start and goal grown by this, within limits [rad]."""


@pytree
class _Tree:
    nodes: Array
    parents: Array
    count: Array


@pytree
class _State:
    trees: _Tree
    """Leading axis 2: from the start, from the goal."""
    solved: Array
    join: Array
    """`[2]` node of each tree at which they met."""
    key: Array


def _nearest(tree: _Tree, q: Array) -> tuple[Array, Array]:
    used = jnp.arange(tree.parents.size) < tree.count
    away = jnp.where(used, jnp.sum((tree.nodes - q) ** 2, axis=-1), jnp.inf)
    index = jnp.argmin(away)
    return index, jnp.sqrt(away[index])


def _iterate(cell: Workcell, config: RrtConfig, state: _State, turn: Array) -> _State:
    """Extend one tree by one step, then try to join it to the other."""
    key_sample, key_bias, key = jax.random.split(state.key, 3)
    tree, other = (jax.tree.map(lambda a, i=i: a[i], state.trees) for i in (turn, 1 - turn))
    roots = state.trees.nodes[:, 0]
    low = jnp.maximum(cell.chain.limits[:, 0], jnp.min(roots, 0) - config.spread)
    high = jnp.minimum(cell.chain.limits[:, 1], jnp.max(roots, 0) + config.spread)
    target = jax.random.uniform(key_sample, low.shape, low.dtype, low, high)
    target = jnp.where(jax.random.uniform(key_bias) < config.goal_bias, other.nodes[0], target)
    near, away = _nearest(tree, target)
    start = tree.nodes[near]
    new = start + (target - start) * jnp.minimum(1.0, config.step / jnp.maximum(away, 1e-6))
    meet, gap = _nearest(other, new)
    extension = points_between(start, new, config.edge_samples)
    bridge = points_between(new, other.nodes[meet], config.join_samples)
    clear = jax.vmap(clearance, (None, 0))(cell, jnp.concatenate([extension, bridge]))
    free, joined = (jnp.all(part >= config.margin) for part in jnp.split(clear, [len(extension)]))
    add = free & ~state.solved & (tree.count < config.nodes)
    at = jnp.where(add, tree.count, config.nodes)
    grown = tree.replace(
        nodes=tree.nodes.at[at].set(new, mode="drop"),
        parents=tree.parents.at[at].set(near, mode="drop"),
        count=tree.count + add,
    )
    joined &= add & (gap <= config.reach)
    pair = jnp.where(turn == 0, jnp.stack([at, meet]), jnp.stack([meet, at]))
    trees = jax.tree.map(lambda all_, one: all_.at[turn].set(one), state.trees, grown)
    return _State(trees, state.solved | joined, jnp.where(joined, pair, state.join), key)


@functools.partial(jax.jit, static_argnames="config")
def _search(cell: Workcell, scenes: Scene, starts, goals, keys, config: RrtConfig) -> _State:
    size = starts.shape[1]

    def init(scene, start, goal, key):
        nodes = jnp.zeros((2, config.nodes, size)).at[:, 0].set(jnp.stack([start, goal]))
        tree = _Tree(nodes, jnp.full((2, config.nodes), -1), jnp.ones(2, int))
        inside = cell.replace(scene=scene)
        direct = edge_clearance(inside, start, goal, 4 * config.join_samples) >= config.margin
        return _State(tree, direct, jnp.zeros(2, int), key)

    def unfinished(carry):
        turn, state = carry
        return (turn < config.nodes) & ~jnp.all(state.solved)

    def iterate(carry):
        turn, state = carry
        step = jax.vmap(
            lambda scene, one: _iterate(cell.replace(scene=scene), config, one, turn % 2)
        )
        return turn + 1, step(scenes, state)

    state = jax.vmap(init)(scenes, starts, goals, keys)
    return jax.lax.while_loop(unfinished, iterate, (jnp.zeros((), int), state))[1]


def _trace(nodes: np.ndarray, parents: np.ndarray, index: int) -> list[np.ndarray]:
    path = []
    while index >= 0:
        path.append(nodes[index])
        index = int(parents[index])
    return path


def plan_paths(
    cell: Workcell,
    scenes: Scene,
    starts: Float[Array, "problem n"],
    goals: Float[Array, "problem n"],
    config: RrtConfig = RrtConfig(),
    *,
    key: PRNGKeyArray,
) -> list[np.ndarray | None]:
    """Way points from each start to each goal, each in its own scene; None where none was found.

    Args:
        cell: robot and fixtures.
        scenes: one scene a problem, stacked.
        starts, goals: configurations.
        config: static settings.
        key: consumed.
    """
    keys = jax.random.split(key, len(starts))
    state = jax.device_get(_search(cell, scenes, starts, goals, keys, config))
    paths: list[np.ndarray | None] = []
    for p in range(len(starts)):
        if not state.solved[p]:
            paths.append(None)
            continue
        nodes, parents = state.trees.nodes[p], state.trees.parents[p]
        first, second = (_trace(nodes[i], parents[i], int(state.join[p, i])) for i in (0, 1))
        paths.append(np.stack(first[::-1] + second))
    return paths
