# SPDX-License-Identifier: MIT
"""RRT-Connect with many workers, for many problems in lockstep, on the collision kernels.

Reference: Kuffner, LaValle, "RRT-Connect: An Efficient Approach to Single-Query Path Planning",
ICRA 2000. Each worker walks along a branch, `samples` configurations in a call of the kernel. One
that is blocked, or has arrived, leaves a node where it stands and takes the next branch at once:
most branches are blocked after a few configurations, and nobody waits for the long ones. Nothing
that is returned is used unchecked.
"""

import functools
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, PRNGKeyArray

from hybrid_jax.kernels.collision import clearance_up_to
from hybrid_jax.keys import split
from hybrid_jax.types import Scene, Workcell, pytree


@dataclass(frozen=True)
class RrtConfig:
    """Settings of the planner."""

    workers: int = 32
    """Branches that are walked at the same time, half of them from each end."""
    samples: int = 8
    """Configurations of a branch that are checked in one call of the kernel."""
    calls: int = 300
    """Of the kernel, before it gives up."""
    capacity: int = 2048
    """Nodes of each tree."""
    spacing: float = 0.0625
    """Distance of the configurations that are checked [rad]."""
    growth: float = 1.0
    """Longest branch towards a sample [rad]."""
    margin: float = 0.004
    """Clearance to keep [m]."""
    spread: float = 1.2
    """Samples are drawn from the box of start and goal grown by this, within limits [rad]."""


@pytree
class _Branches:
    """What each worker walks along; leaves have an axis `[worker]`."""

    tree: Array
    """That it grows: 0 from the start, 1 from the goal."""
    parent: Array
    """Node of that tree at which it begins, ..."""
    start: Array
    """... where that is, ..."""
    target: Array
    """... and the configuration that it leads to."""
    meets: Array
    """Node of the other tree that stands there; -1 if none does."""
    walked: Array
    """How much of it is known to be free [rad]."""


@pytree
class _Search:
    """One problem on its way; both trees have a leading axis of 2."""

    nodes: Array
    """`[2, node, joint]`"""
    parents: Array
    """`[2, node]`"""
    count: Array
    """`[2]`"""
    branches: _Branches
    solved: Array
    join: Array
    """`[2]` node of each tree at which they met."""


def _nearest(search: _Search, tree: Array, q: Array) -> tuple[Array, Array]:
    """Nearest node of one tree each to configurations `[worker, joint]`, and where it is."""
    used = jnp.arange(search.nodes.shape[1]) < search.count[:, None]
    size = jnp.where(used, jnp.sum(search.nodes**2, axis=-1), jnp.inf)
    away = size[:, None] - 2 * jnp.einsum("wj,tnj->twn", q, search.nodes, precision="highest")
    index = jnp.argmin(away, axis=-1)[tree, jnp.arange(len(tree))]
    return index, search.nodes[tree, index]


def _walk(cell: Workcell, branches: _Branches, config: RrtConfig) -> tuple[Array, Array, Array]:
    """Go on along every branch.

    Returns:
        How much of each is free [rad], whether it is blocked, and whether it has arrived.
    """
    way = branches.target - branches.start
    length = jnp.maximum(jnp.linalg.norm(way, axis=-1), 1e-6)
    ahead = branches.walked[:, None] + jnp.arange(1, config.samples + 1) * config.spacing
    ahead = jnp.minimum(ahead, length[:, None])
    points = branches.start[:, None] + (ahead / length[:, None])[..., None] * way[:, None]
    check = jax.vmap(jax.vmap(clearance_up_to, (None, 0, None)), (None, 0, None))
    free = jnp.cumprod(check(cell, points, config.margin) >= config.margin, axis=1)
    walked = jnp.max(jnp.where(free, ahead, branches.walked[:, None]), axis=1)
    blocked = free[:, -1] == 0
    return walked, blocked, ~blocked & (walked >= length)


def _next_branches(
    cell: Workcell, search: _Search, new: Array, number: Array, key: Array, config: RrtConfig
) -> _Branches:
    """What each worker would do next: lead the other tree to its new node, or follow a sample.

    Args:
        cell: limits.
        search: the trees, new nodes included.
        new: `[worker, joint]` new nodes.
        number: `[worker]` theirs, -1 where there is none to connect.
        key: consumed.
        config: lengths.
    """
    roots, workers = search.nodes[:, 0], jnp.arange(config.workers)
    low = jnp.maximum(cell.chain.limits[:, 0], jnp.min(roots, 0) - config.spread)
    high = jnp.minimum(cell.chain.limits[:, 1], jnp.max(roots, 0) + config.spread)
    sample = jax.random.uniform(key, new.shape, new.dtype, low, high)
    connects = number >= 0
    tree = jnp.where(connects, 1 - search.branches.tree, workers % 2)
    target = jnp.where(connects[:, None], new, sample)
    parent, start = _nearest(search, tree, target)
    away = jnp.linalg.norm(target - start, axis=-1, keepdims=True)
    short = start + (target - start) * jnp.minimum(1.0, config.growth / jnp.maximum(away, 1e-6))
    target = jnp.where(connects[:, None], target, short)
    return _Branches(tree, parent, start, target, number, jnp.zeros(len(workers)))


def _advance(cell: Workcell, config: RrtConfig, search: _Search, key: Array) -> _Search:
    """One call of the kernel, and what follows from it."""
    old = search.branches
    walked, blocked, arrived = _walk(cell, old, config)
    joined, over = arrived & (old.meets >= 0), blocked | arrived
    share = walked / jnp.maximum(jnp.linalg.norm(old.target - old.start, axis=-1), 1e-6)
    new = old.start + share[:, None] * (old.target - old.start)
    good, trees = over & (walked > 0) & ~joined, jnp.arange(2)[:, None]
    mine = good & (old.tree == trees)
    at = search.count[:, None] + jnp.cumsum(mine, axis=1) - 1
    at = jnp.where(mine & (at < config.capacity), at, config.capacity)
    grown = search.replace(
        nodes=search.nodes.at[trees, at].set(new[None], mode="drop"),
        parents=search.parents.at[trees, at].set(old.parent[None], mode="drop"),
        count=jnp.minimum(search.count + jnp.sum(mine, axis=1), config.capacity),
    )
    number = jnp.min(at, axis=0)
    connects = good & (old.meets < 0) & (number < config.capacity)
    onward = _next_branches(cell, grown, new, jnp.where(connects, number, -1), key, config)
    going = old.replace(walked=walked)
    pick = lambda a, b: jnp.where(over.reshape(-1, *[1] * (a.ndim - 1)), a, b)  # noqa: E731
    first = jnp.argmax(joined)
    pair = jnp.stack([old.parent[first], old.meets[first]])
    return grown.replace(
        branches=jax.tree.map(pick, onward, going),
        solved=jnp.any(joined),
        join=jnp.where(old.tree[first] == 0, pair, pair[::-1]),
    )


def _begin(cell: Workcell, start: Array, goal: Array, key: Array, config: RrtConfig) -> _Search:
    """Both roots; the first worker tries the straight edge between them."""
    nodes = jnp.zeros((2, config.capacity, start.size)).at[:, 0].set(jnp.stack([start, goal]))
    zero, far = jnp.zeros(config.workers, int), jnp.broadcast_to(goal, (config.workers, goal.size))
    none = _Branches(zero, zero, far, far, zero - 1, jnp.zeros(config.workers))
    parents, count = jnp.full((2, config.capacity), -1), jnp.ones(2, int)
    search = _Search(nodes, parents, count, none, jnp.asarray(False), jnp.zeros(2, int))
    ahead = _next_branches(cell, search, far, zero - 1, key, config)
    first = jnp.arange(config.workers) == 0
    ahead = ahead.replace(
        target=jnp.where(first[:, None], far, ahead.target), meets=jnp.where(first, 0, ahead.meets)
    )
    return search.replace(branches=ahead)


@functools.partial(jax.jit, static_argnames="config")
def _search(cell: Workcell, scenes: Scene, starts, goals, keys, config: RrtConfig) -> _Search:
    def begin(start, goal, key):
        return _begin(cell, start, goal, jax.random.fold_in(key, 0), config)

    def unfinished(carry):
        call, searches = carry
        return (call <= config.calls) & ~jnp.all(searches.solved)

    def advance(carry):
        call, searches = carry

        def one(scene, search, key):
            inside = cell.replace(scene=scene)
            after = _advance(inside, config, search, jax.random.fold_in(key, call))
            return jax.tree.map(lambda a, b: jnp.where(search.solved, a, b), search, after)

        return call + 1, jax.vmap(one)(scenes, searches, keys)

    searches = jax.vmap(begin)(starts, goals, keys)
    return jax.lax.while_loop(unfinished, advance, (jnp.ones((), int), searches))[1]


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
    keys = split(key, len(starts))
    found = _search(cell, scenes, starts, goals, keys, config)
    solved, join, nodes, parents = jax.device_get(
        (found.solved, found.join, found.nodes, found.parents)
    )
    paths: list[np.ndarray | None] = []
    for p in range(len(starts)):
        if not solved[p]:
            paths.append(None)
            continue
        first, second = (_trace(nodes[p, i], parents[p, i], int(join[p, i])) for i in (0, 1))
        paths.append(np.stack(first[::-1] + second))
    return paths
