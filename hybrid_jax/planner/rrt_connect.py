# SPDX-License-Identifier: MIT
"""RRT-Connect with many workers, for many problems in lockstep, on the collision kernels.

Reference: Kuffner, LaValle, "RRT-Connect: An Efficient Approach to Single-Query Path Planning",
ICRA 2000. Each worker walks along a branch and checks `samples` configurations in a call of the
kernel. A worker that is blocked, or has arrived, adds a node where it stands and takes the next
branch at once: most branches are blocked after a few configurations, and no worker waits for the
long ones. Edges are checked at samples only, so callers prove the paths that are returned.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import PRNGKeyArray

from hybrid_jax.kernels.collision.clearance import clearance_up_to
from hybrid_jax.runtime.kept_programs import kept
from hybrid_jax.runtime.keys import split
from hybrid_jax.types import AnyArray, Record, Scene, Workcell, pytree


@dataclass(frozen=True)
class RrtConfig:
    """Settings of the search."""

    workers: int = 32
    """Number of branches that are walked at the same time; half of them begin in each tree."""
    samples: int = 8
    """Configurations of a branch that are checked in one call of the kernel."""
    calls: int = 300
    """Number of calls of the kernel after which the search gives up."""
    capacity: int = 2048
    """Largest number of nodes of each tree."""
    spacing: float = 0.0625
    """Distance of the configurations that are checked along a branch [rad]."""
    growth: float = 1.0
    """Largest length of a branch towards a sample [rad]."""
    margin: float = 0.004
    """Clearance to keep [m]."""
    spread: float = 1.2
    """Samples are drawn within the limits, from the box of start and goal grown by this [rad]."""


@pytree
class _Branches(Record):
    """The branch of each worker; all leaves have a leading axis `[worker]`."""

    tree: Array
    """`[worker]` tree that it grows: 0 from the start, 1 from the goal."""
    parent: Array
    """`[worker]` node of that tree at which it begins."""
    start: Array
    """`[worker, joint]` configuration of that node [rad or m]."""
    target: Array
    """`[worker, joint]` configuration to which it leads [rad or m]."""
    meets: Array
    """`[worker]` node of the other tree at the target; -1 if there is none."""
    walked: Array
    """`[worker]` length that is known to be free [rad]."""


@pytree
class _Search(Record):
    """State of the search of one problem; the two trees are a leading axis of 2."""

    nodes: Array
    """`[2, node, joint]` configurations [rad or m]; the first is the root."""
    parents: Array
    """`[2, node]` parent of each node; -1 at the root."""
    count: Array
    """`[2]` number of nodes."""
    branches: _Branches
    """The branches that are walked."""
    solved: Array
    """`[]` True once the trees have met."""
    join: Array
    """`[2]` node of each tree at which they met."""


def _nearest(search: _Search, tree: Array, q: Array) -> tuple[Array, Array]:
    """Nearest node to each configuration `[worker, joint]` in its tree `[worker]`.

    Returns:
        Numbers of the nodes `[worker]`, and their configurations `[worker, joint]`.
    """
    in_use = jnp.arange(search.nodes.shape[1]) < search.count[:, None]
    norms = jnp.where(in_use, jnp.sum(search.nodes**2, axis=-1), jnp.inf)
    # |q|^2 is the same for all nodes and left out; "highest" as accelerators would round to TF32
    squared = norms[:, None] - 2 * jnp.einsum("wj,tnj->twn", q, search.nodes, precision="highest")
    index = jnp.argmin(squared, axis=-1)[tree, jnp.arange(len(tree))]
    return index, search.nodes[tree, index]


def _walk(cell: Workcell, branches: _Branches, config: RrtConfig) -> tuple[Array, Array, Array]:
    """Check the next `samples` configurations of every branch.

    Returns:
        Length that is free [rad], whether the branch is blocked, and whether it has arrived, each
        `[worker]`.
    """
    edge = branches.target - branches.start
    length = jnp.maximum(jnp.linalg.norm(edge, axis=-1), 1e-6)
    distances = branches.walked[:, None] + jnp.arange(1, config.samples + 1) * config.spacing
    distances = jnp.minimum(distances, length[:, None])
    points = branches.start[:, None] + (distances / length[:, None])[..., None] * edge[:, None]
    check = jax.vmap(jax.vmap(clearance_up_to, (None, 0, None)), (None, 0, None))
    # 1 up to the first sample that is blocked, 0 from there on
    free = jnp.cumprod(check(cell, points, config.margin) >= config.margin, axis=1)
    walked = jnp.max(jnp.where(free, distances, branches.walked[:, None]), axis=1)
    blocked = free[:, -1] == 0
    return walked, blocked, ~blocked & (walked >= length)


def _next_branches(
    cell: Workcell, search: _Search, new: Array, number: Array, key: Array, config: RrtConfig
) -> _Branches:
    """The next branch of each worker: from the other tree to its new node, or towards a sample.

    Args:
        cell: the robot, for its limits.
        search: the trees, with the new nodes.
        new: `[worker, joint]` configurations of new nodes.
        number: `[worker]` numbers of these nodes; -1 where there is none to connect.
        key: consumed.
        config: spread and growth.
    """
    roots, workers = search.nodes[:, 0], jnp.arange(config.workers)
    low = jnp.maximum(cell.chain.limits[:, 0], jnp.min(roots, 0) - config.spread)
    high = jnp.minimum(cell.chain.limits[:, 1], jnp.max(roots, 0) + config.spread)
    sample = jax.random.uniform(key, new.shape, new.dtype, low, high)
    connects = number >= 0
    tree = jnp.where(connects, 1 - search.branches.tree, workers % 2)
    target = jnp.where(connects[:, None], new, sample)
    parent, start = _nearest(search, tree, target)
    length = jnp.linalg.norm(target - start, axis=-1, keepdims=True)
    steered = start + (target - start) * jnp.minimum(1.0, config.growth / jnp.maximum(length, 1e-6))
    target = jnp.where(connects[:, None], target, steered)
    return _Branches(tree, parent, start, target, number, jnp.zeros(len(workers)))


def _advance(cell: Workcell, config: RrtConfig, search: _Search, key: Array) -> _Search:
    """Walk on along all branches, add nodes to the trees, and begin the next branches."""
    branches = search.branches
    walked, blocked, arrived = _walk(cell, branches, config)
    joined, finished = arrived & (branches.meets >= 0), blocked | arrived
    share = walked / jnp.maximum(jnp.linalg.norm(branches.target - branches.start, axis=-1), 1e-6)
    stops = branches.start + share[:, None] * (branches.target - branches.start)
    grows, trees = finished & (walked > 0) & ~joined, jnp.arange(2)[:, None]
    added = grows & (branches.tree == trees)
    slot = search.count[:, None] + jnp.cumsum(added, axis=1) - 1
    slot = jnp.where(added & (slot < config.capacity), slot, config.capacity)
    # a node that must not be added has the slot `capacity`: out of range, so it is dropped
    grown = search.replace(
        nodes=search.nodes.at[trees, slot].set(stops[None], mode="drop"),
        parents=search.parents.at[trees, slot].set(branches.parent[None], mode="drop"),
        count=jnp.minimum(search.count + jnp.sum(added, axis=1), config.capacity),
    )
    number = jnp.min(slot, axis=0)
    connects = grows & (branches.meets < 0) & (number < config.capacity)
    next_branches = _next_branches(cell, grown, stops, jnp.where(connects, number, -1), key, config)
    continued = branches.replace(walked=walked)
    pick = lambda a, b: jnp.where(finished.reshape(-1, *[1] * (a.ndim - 1)), a, b)  # noqa: E731
    winner = jnp.argmax(joined)
    pair = jnp.stack([branches.parent[winner], branches.meets[winner]])
    return grown.replace(
        branches=jax.tree.map(pick, next_branches, continued),
        solved=jnp.any(joined),
        join=jnp.where(branches.tree[winner] == 0, pair, pair[::-1]),
    )


def _begin(cell: Workcell, start: Array, goal: Array, key: Array, config: RrtConfig) -> _Search:
    """The search before its first step; one worker tries the straight edge between the roots."""
    nodes = jnp.zeros((2, config.capacity, start.size)).at[:, 0].set(jnp.stack([start, goal]))
    zero, tiled = (
        jnp.zeros(config.workers, int),
        jnp.broadcast_to(goal, (config.workers, goal.size)),
    )
    idle = _Branches(zero, zero, tiled, tiled, zero - 1, jnp.zeros(config.workers))
    parents, count = jnp.full((2, config.capacity), -1), jnp.ones(2, int)
    search = _Search(nodes, parents, count, idle, jnp.asarray(False), jnp.zeros(2, int))
    branches = _next_branches(cell, search, tiled, zero - 1, key, config)
    is_first = jnp.arange(config.workers) == 0
    branches = branches.replace(
        target=jnp.where(is_first[:, None], tiled, branches.target),
        meets=jnp.where(is_first, 0, branches.meets),
    )
    return search.replace(branches=branches)


@kept(static=("config",), hot=True)
def _search(cell: Workcell, scenes: Scene, starts, goals, keys, config: RrtConfig) -> _Search:
    """Search all problems in lockstep; all leaves have a leading axis `[problem]`."""

    def begin(start, goal, key):
        return _begin(cell, start, goal, jax.random.fold_in(key, 0), config)

    def unfinished(carry):
        call, searches = carry
        return (call <= config.calls) & ~jnp.all(searches.solved)

    def advance(carry):
        call, searches = carry

        def advance_problem(scene, search, key):
            problem_cell = cell.replace(scene=scene)
            advanced = _advance(problem_cell, config, search, jax.random.fold_in(key, call))
            # a solved problem stays as it is while the others go on
            return jax.tree.map(lambda a, b: jnp.where(search.solved, a, b), search, advanced)

        return call + 1, jax.vmap(advance_problem)(scenes, searches, keys)

    searches = jax.vmap(begin)(starts, goals, keys)
    return jax.lax.while_loop(unfinished, advance, (jnp.ones((), int), searches))[1]


def _trace(nodes: np.ndarray, parents: np.ndarray, index: int) -> list[np.ndarray]:
    """Configurations from a node back to the root of its tree."""
    path = []
    while index >= 0:
        path.append(nodes[index])
        index = int(parents[index])
    return path


def plan_paths(
    cell: Workcell,
    scenes: Scene,
    starts: AnyArray,
    goals: AnyArray,
    config: RrtConfig = RrtConfig(),
    *,
    key: PRNGKeyArray,
) -> list[np.ndarray | None]:
    """Search for paths from starts to goals, each problem in its own scene.

    The edges of a path are checked at samples only.

    Args:
        cell: robot and fixtures.
        scenes: one scene for each problem, leaves `[problem, ...]`.
        starts, goals: configurations `[problem, joint]` [rad or m].
        config: static settings.
        key: consumed.

    Returns:
        Way points `[way point, joint]` [rad or m] of each problem; None where none was found.
    """
    keys = split(key, len(starts))
    searches = _search(cell, scenes, starts, goals, keys, config)
    solved, join, nodes, parents = jax.device_get(
        (searches.solved, searches.join, searches.nodes, searches.parents)
    )
    paths: list[np.ndarray | None] = []
    for p in range(len(starts)):
        if not solved[p]:
            paths.append(None)
            continue
        from_start, from_goal = (
            _trace(nodes[p, i], parents[p, i], int(join[p, i])) for i in (0, 1)
        )
        paths.append(np.stack(from_start[::-1] + from_goal))
    return paths
