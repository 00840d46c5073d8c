# SPDX-License-Identifier: MIT
"""RRT-Connect with many workers, for many problems in lockstep, on the collision kernels.

Reference: Kuffner, LaValle, "RRT-Connect: An Efficient Approach to Single-Query Path Planning",
ICRA 2000. Each worker walks along a branch and checks some configurations in a call of the
kernel. A worker that is blocked, or has arrived, adds a node where it stands and takes the next
branch at once: most branches are blocked after a few configurations, and no worker waits for the
long ones. Edges are checked at samples only, so callers prove the paths that are returned.
"""

from dataclasses import asdict, dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import PRNGKeyArray

from hybrid_jax.kernels.collision.clearance import clearance_up_to
from hybrid_jax.planner.search_trees import (
    BLOCK,
    SearchTrees,
    adapted,
    drawn,
    grown,
    nearest,
    planted,
)
from hybrid_jax.runtime.kept_programs import kept
from hybrid_jax.runtime.keys import split
from hybrid_jax.types import AnyArray, Record, Scene, Workcell, pytree

WORKERS = 16
"""Branches that are walked at the same time; half of them grow each tree."""
SAMPLES = 8
"""Configurations of a branch that are checked in one call of the kernel. Easy motions are a few
long branches: fewer configurations a call mean more calls there."""
CAPACITY = 64 * BLOCK
"""Largest number of nodes of each tree."""


@dataclass(frozen=True)
class RrtConfig:
    """Settings of the search. Numbers only: all searches in a cell run one compiled program."""

    calls: int = 600
    """Number of calls of the kernel after which the search gives up."""
    spacing: float = 0.0625
    """Distance of the configurations that are checked along a branch [rad]."""
    growth: float = 2.0
    """Largest length of a branch towards a sample [rad]."""
    margin: float = 0.004
    """Clearance to keep [m]."""
    spread: float = 1.2
    """Samples are drawn within the limits, from the box of start and goal grown by this [rad]."""


_Settings = dict[str, Array]
"""The fields of an `RrtConfig`, as arrays."""


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
    """State of the search of one problem."""

    trees: SearchTrees
    """What was found so far."""
    branches: _Branches
    """The branches that are walked."""
    solved: Array
    """`[]` True once the trees have met."""
    join: Array
    """`[2]` node of each tree at which they met."""


def _walk(cell: Workcell, branches: _Branches, settings: _Settings) -> tuple[Array, Array, Array]:
    """Check the next `SAMPLES` configurations of every branch.

    Returns:
        Length that is free [rad], whether the branch is blocked, and whether it has arrived, each
        `[worker]`.
    """
    edge = branches.target - branches.start
    length = jnp.maximum(jnp.linalg.norm(edge, axis=-1), 1e-6)
    distances = branches.walked[:, None] + jnp.arange(1, SAMPLES + 1) * settings["spacing"]
    distances = jnp.minimum(distances, length[:, None])
    points = branches.start[:, None] + (distances / length[:, None])[..., None] * edge[:, None]
    check = jax.vmap(jax.vmap(clearance_up_to, (None, 0, None)), (None, 0, None))
    # 1 up to the first sample that is blocked, 0 from there on
    free = jnp.cumprod(check(cell, points, settings["margin"]) >= settings["margin"], axis=1)
    walked = jnp.max(jnp.where(free, distances, branches.walked[:, None]), axis=1)
    blocked = free[:, -1] == 0
    return walked, blocked, ~blocked & (walked >= length)


def _next_branches(
    cell: Workcell, search: _Search, new: Array, number: Array, key: Array, settings: _Settings
) -> _Branches:
    """The next branch of each worker: from the other tree to its new node, or towards a sample.

    Args:
        cell: the robot, for its limits.
        search: the trees, with the new nodes.
        new: `[worker, joint]` configurations of new nodes.
        number: `[worker]` numbers of these nodes; -1 where there is none to connect.
        key: consumed.
        settings: spread and growth.
    """
    trees, roots = search.trees, search.trees.nodes[:, 0]
    low = jnp.maximum(cell.chain.limits[:, 0], jnp.min(roots, 0) - settings["spread"])
    high = jnp.minimum(cell.chain.limits[:, 1], jnp.max(roots, 0) + settings["spread"])
    connects = number >= 0
    sample, own, beside = drawn(trees, WORKERS, low, high, key)
    tree = jnp.where(connects, 1 - search.branches.tree, own)
    parent = jnp.where(connects, nearest(trees, tree, new), beside)
    target = jnp.where(connects[:, None], new, sample)
    start = trees.nodes[tree, parent]
    length = jnp.linalg.norm(target - start, axis=-1, keepdims=True)
    share = jnp.minimum(1.0, settings["growth"] / jnp.maximum(length, 1e-6))
    steered = start + share * (target - start)
    target = jnp.where(connects[:, None], target, steered)
    return _Branches(tree, parent, start, target, number, jnp.zeros(WORKERS))


def _advance(cell: Workcell, settings: _Settings, search: _Search, key: Array) -> _Search:
    """Walk on along all branches, add nodes to the trees, and begin the next branches.

    Trees and join of a solved search stay as they are, while others in lockstep go on.
    """
    branches = search.branches
    walked, blocked, arrived = _walk(cell, branches, settings)
    # as masks of the few changes: choosing between old and new trees would copy both
    blocked, arrived = blocked & ~search.solved, arrived & ~search.solved
    to_sample, finished = branches.meets < 0, blocked | arrived
    joined, failed = arrived & ~to_sample, blocked & to_sample & (walked <= 0)
    trees = adapted(
        search.trees, branches.tree, branches.parent, failed, finished & to_sample & ~failed
    )
    share = walked / jnp.maximum(jnp.linalg.norm(branches.target - branches.start, axis=-1), 1e-6)
    stops = branches.start + share[:, None] * (branches.target - branches.start)
    grows = finished & (walked > 0) & ~joined & (branches.tree == jnp.arange(2)[:, None])
    trees, number, is_new = grown(trees, grows, stops, branches.parent)
    larger = search.replace(trees=trees)
    number = jnp.where(is_new & to_sample, number, -1)
    next_branches = _next_branches(cell, larger, stops, number, key, settings)
    continued = branches.replace(walked=walked)
    pick = lambda a, b: jnp.where(finished.reshape(-1, *[1] * (a.ndim - 1)), a, b)  # noqa: E731
    winner = jnp.argmax(joined)
    pair = jnp.stack([branches.parent[winner], branches.meets[winner]])
    pair = jnp.where(branches.tree[winner] == 0, pair, pair[::-1])
    return larger.replace(
        branches=jax.tree.map(pick, next_branches, continued),
        solved=search.solved | jnp.any(joined),
        join=jnp.where(search.solved, search.join, pair),
    )


def _begin(cell: Workcell, start: Array, goal: Array, key: Array, settings: _Settings) -> _Search:
    """The search before its first step; one worker tries the straight edge between the roots."""
    zero = jnp.zeros(WORKERS, int)
    tiled = jnp.broadcast_to(goal, (WORKERS, goal.size))
    idle = _Branches(zero, zero, tiled, tiled, zero - 1, jnp.zeros(WORKERS))
    trees = planted(start, goal, CAPACITY)
    search = _Search(trees, idle, jnp.asarray(False), jnp.zeros(2, int))
    branches = _next_branches(cell, search, tiled, zero - 1, key, settings)
    is_first = jnp.arange(WORKERS) == 0
    branches = branches.replace(
        target=jnp.where(is_first[:, None], tiled, branches.target),
        meets=jnp.where(is_first, 0, branches.meets),
    )
    return search.replace(branches=branches)


@kept(hot=True)
def _search(cell: Workcell, scenes: Scene, starts, goals, keys, settings: _Settings) -> _Search:
    """Search all problems in lockstep; all leaves have a leading axis `[problem]`."""

    def begin(start, goal, key):
        return _begin(cell, start, goal, jax.random.fold_in(key, 0), settings)

    def unfinished(carry):
        call, searches = carry
        return (call <= settings["calls"]) & ~jnp.all(searches.solved)

    def advance(carry):
        call, searches = carry

        def advance_problem(scene, search, key):
            problem_cell = cell.replace(scene=scene)
            return _advance(problem_cell, settings, search, jax.random.fold_in(key, call))

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
        config: settings.
        key: consumed.

    Returns:
        Way points `[way point, joint]` [rad or m] of each problem; None where none was found.
    """
    keys = split(key, len(starts))
    settings = {name: np.float32(value) for name, value in asdict(config).items()}
    searches = _search(cell, scenes, starts, goals, keys, settings)
    solved, join, nodes, parents = jax.device_get(
        (searches.solved, searches.join, searches.trees.nodes, searches.trees.parents)
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
