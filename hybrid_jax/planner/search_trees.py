# SPDX-License-Identifier: MIT
"""The two trees of a search in joint space: nodes, nearest nodes, and the domain of each node.

References: Yershova, Jaillet, Simeon, LaValle, "Dynamic-Domain RRTs: Efficient Exploration by
Controlling the Sampling Domain", ICRA 2005; Jaillet, Yershova, LaValle, Simeon, "Adaptive Tuning of
the Sampling Domain for Dynamic-Domain RRTs", IROS 2005. A node beside an obstacle is nearest to
many samples that lie behind that obstacle. Once a branch from it was blocked at its first
configuration, only samples within its domain count for it, and trees leave narrow places sooner.
"""

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import PRNGKeyArray

from hybrid_jax.types import Record, pytree

DOMAIN = 1.0
"""Domain of a node after the first branch that was blocked at once [rad]."""
LEAST_DOMAIN = 0.1
"""No domain becomes smaller [rad]."""
ADAPTATION = 0.1
"""Share by which a domain shrinks with each such branch, and grows with each other one."""
DRAWN = 4
"""Samples that are drawn for a branch, the last beside a random node. The branch leads to the first
that lies in a domain."""

BLOCK = 256
"""Nodes that are looked at together for the nearest; capacities are multiples of it."""


@pytree
class SearchTrees(Record):
    """A tree from the start and one from the goal, the leading axis of 2 of all leaves."""

    nodes: Array
    """`[2, node, joint]` configurations [rad or m]; the first is the root."""
    parents: Array
    """`[2, node]` parent of each node; -1 at the root."""
    count: Array
    """`[2]` number of nodes."""
    domain: Array
    """`[2, node]` distance up to which samples count for a node [rad]; infinite at first."""


def planted(start: Array, goal: Array, capacity: int) -> SearchTrees:
    """Two trees of one node each.

    Args:
        start: root of the first, `[joint]` [rad or m].
        goal: root of the second, `[joint]` [rad or m].
        capacity: largest number of nodes of each.
    """
    nodes = jnp.zeros((2, capacity, start.size)).at[:, 0].set(jnp.stack([start, goal]))
    shape = (2, capacity)
    return SearchTrees(nodes, jnp.full(shape, -1), jnp.ones(2, int), jnp.full(shape, jnp.inf))


def _nearest(trees: SearchTrees, q: Array) -> Array:
    """Numbers `[2, k]` of the nodes of each tree that are nearest to its `[2, k, joint]`."""

    def look(block, best):
        first = block * BLOCK
        nodes = jax.lax.dynamic_slice_in_dim(trees.nodes, first, BLOCK, axis=1)
        in_use = first + jnp.arange(BLOCK) < trees.count[:, None]
        norms = jnp.where(in_use, jnp.sum(nodes**2, axis=-1), jnp.inf)
        # |q|^2 is the same for all nodes and left out; accelerators would round to TF32
        products = jnp.einsum("tkj,tnj->tkn", q, nodes, precision="highest")
        squared = norms[:, None] - 2 * products
        index, least = jnp.argmin(squared, axis=-1), jnp.min(squared, axis=-1)
        closer = least < best[0]
        return jnp.where(closer, least, best[0]), jnp.where(closer, first + index, best[1])

    blocks = (jnp.max(trees.count) + BLOCK - 1) // BLOCK
    none = jnp.full(q.shape[:2], jnp.inf, q.dtype), jnp.zeros(q.shape[:2], int)
    return jax.lax.fori_loop(0, blocks, look, none)[1]


def nearest(trees: SearchTrees, tree: Array, q: Array) -> Array:
    """Numbers `[worker]` of the nodes nearest to configurations.

    Args:
        trees: to look in.
        tree: `[worker]` which of the two, for each worker.
        q: `[worker, joint]` [rad or m].
    """
    return _nearest(trees, jnp.broadcast_to(q, (2, *q.shape)))[tree, jnp.arange(len(tree))]


def grown(
    trees: SearchTrees, added: Array, q: Array, parent: Array
) -> tuple[SearchTrees, Array, Array]:
    """The trees with new nodes, as far as there is room.

    Args:
        trees: to grow.
        added: `[2, worker]` whether the worker adds a node to each tree.
        q: `[worker, joint]` configurations of new nodes [rad or m].
        parent: `[worker]` nodes at which they hang.

    Returns:
        The trees, the number `[worker]` of each new node, and whether there is one `[worker]`.
    """
    capacity, which = trees.nodes.shape[1], jnp.arange(2)[:, None]
    slot = trees.count[:, None] + jnp.cumsum(added, axis=1) - 1
    # a node that must not be added has the slot `capacity`: out of range, so it is dropped
    slot = jnp.where(added & (slot < capacity), slot, capacity)
    larger = trees.replace(
        nodes=trees.nodes.at[which, slot].set(q[None], mode="drop"),
        parents=trees.parents.at[which, slot].set(parent[None], mode="drop"),
        count=jnp.minimum(trees.count + jnp.sum(added, axis=1), capacity),
    )
    number = jnp.min(slot, axis=0)
    return larger, number, number < capacity


def adapted(
    trees: SearchTrees, tree: Array, node: Array, failed: Array, went: Array
) -> SearchTrees:
    """The trees with the domains that follow from branches towards samples.

    Args:
        trees: with the domains before.
        tree: `[worker]` tree of each branch.
        node: `[worker]` node at which it began.
        failed: `[worker]` whether it was blocked at its first configuration.
        went: `[worker]` whether it came to an end later.
    """
    capped = trees.domain.at[tree, node].min(jnp.where(failed, DOMAIN, jnp.inf))
    factor = 1.0 + ADAPTATION * (went.astype(jnp.float32) - failed)
    # products do not depend on the order of branches that began at the same node
    scaled = capped.at[tree, node].multiply(factor)
    return trees.replace(domain=scaled.at[tree, node].max(LEAST_DOMAIN))


def drawn(
    trees: SearchTrees, workers: int, low: Array, high: Array, key: PRNGKeyArray
) -> tuple[Array, Array, Array]:
    """A sample for each worker, if possible within the domain of the node nearest to it.

    Args:
        trees: to grow.
        workers: the first half of them grows the first tree.
        low: `[joint]` least values of samples [rad or m].
        high: `[joint]` largest values [rad or m].
        key: consumed.

    Returns:
        Configurations `[worker, joint]` [rad or m], the tree that each is for and the node of it
        that is nearest, each `[worker]`.
    """
    tree = jnp.arange(workers) // (workers // 2)
    wide_key, near_key = jax.random.split(key)
    samples = jax.random.uniform(wide_key, (workers, DRAWN, low.size), low.dtype, low, high)
    samples = samples.at[:, -1].set(_near(trees, tree, low, high, near_key))
    index = _nearest(trees, samples.reshape(2, -1, low.size)).reshape(workers, DRAWN)
    distance = jnp.linalg.norm(samples - trees.nodes[tree[:, None], index], axis=-1)
    share = distance / trees.domain[tree[:, None], index]
    # local samples alone leave pockets, the others cross open space: half of the workers for each
    last = jnp.where(jnp.arange(workers) % 2, DRAWN - 1, jnp.argmin(share[:, :-1], axis=1))
    inside = share[:, :-1] <= 1
    chosen = jnp.where(jnp.any(inside, axis=1), jnp.argmax(inside, axis=1), last)
    pick = jnp.arange(workers), chosen
    return samples[pick], tree, index[pick]


def _near(trees: SearchTrees, tree: Array, low: Array, high: Array, key: PRNGKeyArray) -> Array:
    """A sample `[worker, joint]` in the domain of a random node for each worker."""
    node_key, key = jax.random.split(key)
    node = jax.random.randint(node_key, tree.shape, 0, trees.count[tree])
    reach = jnp.minimum(trees.domain[tree, node], DOMAIN) / jnp.sqrt(low.size)
    step = jax.random.uniform(key, (len(tree), low.size), low.dtype, -1.0, 1.0)
    return jnp.clip(trees.nodes[tree, node] + reach[:, None] * step, low, high)
