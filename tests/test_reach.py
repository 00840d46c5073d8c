# SPDX-License-Identifier: MIT
"""The environment of the joint-space agent, and what the trained agent's rollouts are worth."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hybrid_jax.agents import joint, networks, ppo, training
from hybrid_jax.agents.joint_bridger import make_bridger
from hybrid_jax.contracts import Segments, take
from hybrid_jax.envs.paper_reach import PaperReachConfig, PaperReachEnv
from hybrid_jax.envs.reach import ReachConfig, ReachEnv
from hybrid_jax.envs.segments import refuse_infeasible, single_segment, with_room
from hybrid_jax.errors import SegmentError
from hybrid_jax.kernels.collision.clearance import clearance
from hybrid_jax.kernels.collision.motion_validation import edge_is_free

COUNT = 12
CONFIG = joint.JointAgentConfig(
    training=ppo.PpoConfig(steps=8_192, envs=64, minibatch=512), rollouts=(8,)
)


@pytest.fixture(scope="module")
def segments(cell):
    """Pairs of free configurations near home, each in the cell's own scene."""
    rng = np.random.default_rng(0)
    drawn = np.asarray(cell.home) + rng.uniform(-0.6, 0.6, (200, 7)).astype(np.float32)
    drawn = np.clip(drawn, *np.asarray(cell.joint_limits).T)
    free = drawn[np.asarray(jax.vmap(clearance, (None, 0))(cell, drawn)) > 0.02]
    scene = jax.tree.map(lambda a: jnp.broadcast_to(a, (COUNT, *a.shape)), cell.scene)
    return Segments(scene, jnp.asarray(free[:COUNT]), jnp.asarray(free[COUNT : 2 * COUNT]))


@pytest.fixture(scope="module")
def env(cell, segments):
    return ReachEnv(cell, segments)


def test_without_correction_the_arm_goes_straight_and_arrives_exactly(cell, segments, env):
    """The neutral action; where nothing is in the way the last step ends on the goal."""
    step = jax.jit(jax.vmap(env.step))
    state = jax.vmap(env.start)(jnp.arange(COUNT), segments.start)
    arrived = np.zeros(COUNT, bool)
    for _ in range(40):
        move = step(state, jnp.zeros((COUNT, 7)))
        towards = np.abs(segments.goal - move.state.q) <= np.abs(segments.goal - state.q) + 1e-6
        assert towards.all()
        arrived |= np.asarray(move.success)
        state = move.state
    straight, _ = jax.vmap(lambda a, b: edge_is_free(cell, a, b, 0.01))(
        segments.start, segments.goal
    )
    assert straight.sum() >= COUNT // 3 and arrived[np.asarray(straight)].all()
    error = np.abs(np.asarray(state.q - segments.goal)).max(axis=1)
    assert error[arrived].max() < 1e-5


def test_a_rollout_never_stands_closer_than_the_margin(cell, segments, env):
    """Random actions, ten steps a copy; the clearance by the exact kernel."""
    state = jax.vmap(env.start)(jnp.arange(COUNT), segments.start)
    step, blocked = jax.jit(jax.vmap(env.step)), 0
    for key in jax.random.split(jax.random.key(1), 30):
        action = jax.random.uniform(key, (COUNT, 7), minval=-1, maxval=1)
        move = step(state, action)
        blocked += int(move.info["blocked"].sum())
        assert (np.abs(move.state.q - state.q).max(axis=1) <= 0.08 + 1e-6).all()
        state = move.state
        gaps = jax.vmap(clearance, (None, 0))(cell, state.q)
        assert (np.asarray(gaps) >= env.config.margin - 1e-6).all()
    assert blocked > 0


def test_reward_is_what_the_distance_to_go_loses(segments, env):
    move = jax.jit(env.step)(env.start(jnp.int32(0), segments.start[0]), jnp.zeros(7))
    before, after = (
        np.linalg.norm(np.asarray(segments.goal[0] - q)) for q in (segments.start[0], move.state.q)
    )
    blocked = float(move.info["blocked"])
    assert float(move.reward) == pytest.approx(before - after - 0.02 - 0.05 * blocked, abs=1e-5)


def test_mjx_backend_blocks_what_the_kernels_block(cell, segments):
    """A configuration that hits something and home, by both collision backends."""
    low = np.asarray(cell.home, np.float32)
    goal = low.copy()
    goal[1] += 1.6
    path = jnp.linspace(jnp.asarray(low), jnp.asarray(goal), 24)
    gaps = np.asarray(jax.vmap(clearance, (None, 0))(cell, path))
    hit = int(np.argmax(gaps < -0.01))
    assert hit > 0
    for name in ("fused", "mjx"):
        env = ReachEnv(cell, segments, ReachConfig(backend=name))
        gap = jax.jit(lambda points, env=env: env.gap(cell, points))
        assert gap(path[hit : hit + 1]) < 0 < gap(path[:1])


@pytest.fixture(scope="module")
def agent(cell, segments, env):
    """A few updates; segments that a straight line solves are solved before the first."""
    net = joint.make_net(cell, CONFIG)
    return net, training.train(env, net, CONFIG.training).policy()


def test_the_bridger_returns_proven_paths_or_nothing(cell, segments, agent):
    net, policy = agent
    bridge, found = make_bridger(cell, policy, CONFIG), 0
    for i in range(6):
        scene = jax.tree.map(lambda a, i=i: a[i], segments.scene)
        path = bridge(take(segments, slice(i, i + 1)), jax.random.key(i))[0]
        if path is None:
            continue
        found += 1
        np.testing.assert_array_equal(path[0], segments.start[i])
        np.testing.assert_array_equal(path[-1], segments.goal[i])
        inside = cell.replace(scene=scene)
        dense = np.concatenate(
            [np.linspace(a, b, 20) for a, b in zip(path[:-1], path[1:], strict=True)]
        )
        assert float(jax.vmap(clearance, (None, 0))(inside, dense).min()) > 0
    assert found >= 4


def test_rollouts_stop_once_enough_have_arrived(env, segments, agent):
    """Those that arrived by then are the same rollouts; nobody stands beyond the last step.

    Enough must arrive of each segment: the quick ones wait for the others.
    """
    net, policy = agent
    index, spread = jnp.repeat(jnp.array([0, 5]), 6), jnp.tile(joint.spreads(6), 2)
    key = jax.random.key(0)
    (everyone, arrived), (few, early) = (
        jax.jit(lambda n=n: joint.rollouts(env, net, policy, index, spread, key, n))()
        for n in (None, 3)
    )
    chosen = np.asarray(early)
    assert (chosen.reshape(2, 6).sum(axis=1) >= 3).all() and arrived[chosen].all()
    assert chosen.sum() < arrived.sum()
    np.testing.assert_allclose(few[:, chosen], everyone[:, chosen], atol=1e-5)
    np.testing.assert_array_equal(few[0], segments.start[index])


def test_infeasible_ends_are_refused_by_name(cell, segments, agent):
    """Outside a limit, or in the table; by the check and by the bridger alike."""
    far = segments.replace(goal=segments.goal.at[2, 1].set(9.0))
    with pytest.raises(SegmentError, match=r"segment 2: joint '.*2' of its goal is 9"):
        refuse_infeasible(cell, far, 0.0)
    low = jnp.asarray(cell.home).at[1].add(1.6)
    assert clearance(cell, low) < 0
    hit = segments.replace(start=segments.start.at[1].set(low))
    with pytest.raises(SegmentError, match=r"segment 1: the clearance of its start is -"):
        refuse_infeasible(cell, hit, 0.0)
    np.testing.assert_array_equal(
        with_room(cell, hit, 0.0).start, np.delete(segments.start, 1, axis=0)
    )
    bridge = make_bridger(cell, agent[1], CONFIG)
    with pytest.raises(SegmentError, match="its goal"):
        bridge(single_segment(cell.scene, segments.start[0], low), jax.random.key(0))


def test_a_wider_spread_is_bolder_and_none_is_the_mode(agent):
    net, policy = agent
    obs = jnp.zeros(policy.normalizer.mean.shape)
    keys = jax.random.split(jax.random.key(0), 200)
    mode = networks.act(net, policy, obs, None)
    away = [
        np.abs(jax.vmap(lambda k, s=s: networks.act(net, policy, obs, k, s))(keys) - mode).mean()
        for s in (0.0, 0.5, 1.0)
    ]
    assert away[0] < 1e-6 < away[1] < away[2]


def test_planning_checks_moves_more_finely_than_training(cell, segments):
    config = joint.JointAgentConfig()
    trained, used = (make(cell, segments, config) for make in (joint.make_env, joint.planning_env))
    assert trained.config.edge_samples == 3 and used.config.edge_samples == 4
    paper = joint.JointAgentConfig(reach=PaperReachConfig(), edge_samples=12)
    env = joint.planning_env(cell, segments, paper)
    assert isinstance(env, PaperReachEnv) and env.config.edge_samples == 12


def test_the_papers_env_serves_the_planner_too(cell, segments):
    """Its rollouts can be traced, and close with the goal."""
    config = joint.JointAgentConfig(training=CONFIG.training, reach=PaperReachConfig(horizon=4))
    net = joint.make_net(cell, config)
    policy = networks.blank_policy(net, joint.observation_length(cell, config))
    index, spread = jnp.arange(COUNT), jnp.ones(COUNT)

    @jax.jit
    def run(key):
        env = joint.planning_env(cell, segments, config)
        return joint.rollouts(env, net, policy, index, spread, key)

    q, arrived = run(jax.random.key(0))
    assert q.shape == (6, COUNT, 7) and arrived.shape == (COUNT,)
    np.testing.assert_array_equal(q[-1], segments.goal)
