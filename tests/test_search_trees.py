# SPDX-License-Identifier: MIT
"""The trees of the joint search: nearest nodes, growth, and domains, against plain NumPy."""

import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from hybrid_jax.planner.search_trees import (
    ADAPTATION,
    BLOCK,
    DOMAIN,
    LEAST_DOMAIN,
    adapted,
    drawn,
    grown,
    nearest,
    planted,
)

JOINTS = 3
CAPACITY = 3 * BLOCK


def _trees(first: int, second: int, seed: int = 0):
    """Trees of random nodes; what lies behind them in the tables would be nearest to many."""
    trees = planted(jnp.zeros(JOINTS), jnp.ones(JOINTS), CAPACITY)
    nodes = np.random.default_rng(seed).uniform(-3, 3, (2, CAPACITY, JOINTS))
    nodes[0, first:], nodes[1, second:] = 0.0, 0.0
    return trees.replace(nodes=jnp.asarray(nodes, jnp.float32), count=jnp.array([first, second]))


@settings(deadline=None, max_examples=20)
@given(st.integers(1, CAPACITY), st.integers(1, CAPACITY), st.integers(0, 1000))
def test_nearest_is_that_of_brute_force(first, second, seed):
    trees = _trees(first, second, seed)
    tree = jnp.array([0, 0, 1, 1])
    q = np.random.default_rng(seed + 1).uniform(-3, 3, (4, JOINTS)).astype(np.float32)
    found = np.asarray(nearest(trees, tree, jnp.asarray(q)))
    for worker, (which, number) in enumerate(zip(np.asarray(tree), found, strict=True)):
        count = (first, second)[which]
        distances = np.linalg.norm(np.asarray(trees.nodes)[which, :count] - q[worker], axis=1)
        assert number < count
        np.testing.assert_allclose(distances[number], distances.min(), atol=1e-5)


def test_nodes_are_added_until_the_trees_are_full():
    trees = _trees(CAPACITY - 1, 5)
    added = jnp.array([[True, True, False], [False, False, True]])
    q = jnp.arange(9.0).reshape(3, JOINTS)
    larger, number, is_new = grown(trees, added, q, jnp.array([3, 4, 2]))
    np.testing.assert_array_equal(is_new, [True, False, True])
    np.testing.assert_array_equal(number[np.array([0, 2])], [CAPACITY - 1, 5])
    np.testing.assert_array_equal(larger.count, [CAPACITY, 6])
    np.testing.assert_array_equal(larger.nodes[0, CAPACITY - 1], q[0])
    np.testing.assert_array_equal(larger.nodes[1, 5], q[2])
    assert (int(larger.parents[0, CAPACITY - 1]), int(larger.parents[1, 5])) == (3, 2)


def test_domains_shrink_where_branches_are_blocked_at_once():
    trees = _trees(10, 10)
    tree, node = jnp.array([0, 0, 1, 1]), jnp.array([4, 4, 4, 7])
    failed, went = jnp.array([True, True, False, True]), jnp.array([False, False, True, False])
    once = adapted(trees, tree, node, failed, went)
    shrunk = 1 - ADAPTATION
    np.testing.assert_allclose(once.domain[0, 4], DOMAIN * shrunk**2, rtol=1e-6)
    assert np.isinf(once.domain[1, 4])
    np.testing.assert_allclose(once.domain[1, 7], DOMAIN * shrunk, rtol=1e-6)
    assert np.isinf(np.asarray(once.domain)[0, [0, 7]]).all()
    grew = adapted(once, tree, node, jnp.zeros(4, bool), jnp.array([False, False, False, True]))
    np.testing.assert_allclose(grew.domain[1, 7], DOMAIN * shrunk * (1 + ADAPTATION), rtol=1e-6)
    for _ in range(60):
        once = adapted(once, tree, node, failed, went)
    np.testing.assert_allclose(once.domain[0, 4], LEAST_DOMAIN)


def test_samples_keep_limits_and_local_ones_stay_beside_nodes():
    low, high = jnp.full(JOINTS, -3.0), jnp.full(JOINTS, 3.0)
    trees = _trees(40, 60)
    trees = trees.replace(domain=jnp.full_like(trees.domain, LEAST_DOMAIN))
    local = []
    for seed in range(20):
        samples, tree, index = drawn(trees, 8, low, high, jax.random.key(seed))
        np.testing.assert_array_equal(tree, [0, 0, 0, 0, 1, 1, 1, 1])
        assert (samples >= low).all() and (samples <= high).all()
        np.testing.assert_array_equal(index, nearest(trees, tree, samples))
        distance = np.linalg.norm(samples - trees.nodes[tree, index], axis=1)
        local += list(distance[1::2])
    # every second worker ends beside a node: none of so few domains holds a sample of the whole box
    assert max(local) <= LEAST_DOMAIN * 1.001


def test_samples_spread_while_no_branch_was_blocked():
    low, high = jnp.full(JOINTS, -3.0), jnp.full(JOINTS, 3.0)
    trees = planted(jnp.zeros(JOINTS), jnp.ones(JOINTS), CAPACITY)
    samples, _, index = drawn(trees, 512, low, high, jax.random.key(0))
    np.testing.assert_array_equal(index, 0)
    np.testing.assert_allclose(np.std(np.asarray(samples), axis=0), 6 / np.sqrt(12), rtol=0.1)
