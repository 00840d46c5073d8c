# SPDX-License-Identifier: MIT
"""The paper's own environment, against C MuJoCo and SciPy."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hybrid_jax.contracts import Segments
from hybrid_jax.envs.paper_reach import LITERAL, PaperReachConfig, PaperReachEnv, euler
from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.planner.phase_scenes import home_scene
from hybrid_jax.planner.trajectory_check import ConfigurationChecker


@pytest.fixture(scope="module")
def env(cell, configurations):
    scene = jax.tree.map(lambda a: jnp.broadcast_to(a, (8, *a.shape)), cell.scene)
    ends = jnp.asarray(configurations[:8]), jnp.asarray(configurations[8:16])
    return PaperReachEnv(cell, Segments(scene, *ends), LITERAL)


def action_to(cell, q):
    low, high = np.asarray(cell.joint_limits).T
    return jnp.asarray(2 * (q - low) / (high - low) - 1, jnp.float32)


def test_euler_angles_agree_with_scipy():
    rotations = Rotation.random(200, rng=np.random.default_rng(0))
    found = euler(jnp.asarray(rotations.as_quat(scalar_first=True)))
    back = Rotation.from_euler("xyz", np.asarray(found, float))
    assert (back * rotations.inv()).magnitude().max() < 2e-3


def test_observation_has_the_papers_numbers_in_the_papers_order(cell, env, configurations):
    """JP of every link, velocities of a known step, the goal, 25 rays."""
    state = env.start(jnp.int32(0), jnp.asarray(configurations[0]))
    state = jax.jit(env.step)(state, action_to(cell, configurations[1])).state
    obs = np.asarray(env.observe(state))
    assert obs.shape == (12 * 7 + 31,)
    data, layout = mujoco.MjData(cell.model), cell.source.layout
    places = []
    for q in configurations[:2]:
        data.qpos[list(layout.qpos)] = q
        mujoco.mj_forward(cell.model, data)
        ids = [cell.model.joint(name).bodyid[0] for name in cell.joint_names]
        places.append(data.xpos[ids].copy())
    np.testing.assert_allclose(obs[:21].reshape(7, 3), places[1], atol=1e-4)
    velocity = (places[1] - places[0]) / env.config.period
    np.testing.assert_allclose(obs[42:63].reshape(7, 3), velocity, atol=2e-3)
    np.testing.assert_allclose(obs[84:87], dq.position(env.goal_pose[0]), atol=1e-6)
    assert (obs[-25:] >= 0).all() and (obs[-25:] <= 1).all()


def test_reward_is_fea_minus_distance_outside_the_ball_and_a_tenth_inside(cell, env):
    goals = env.segments.goal
    step = jax.jit(env.step)
    inside = step(env.start(jnp.int32(0), env.segments.start[0]), action_to(cell, goals[0]))
    assert bool(inside.terminated) and float(inside.reward) == pytest.approx(0.1)
    for i in range(1, 8):
        move = step(env.start(jnp.int32(i), env.segments.start[i]), action_to(cell, goals[0]))
        distance, hit = float(move.info["distance"]), float(move.info["collision"])
        fea = float(env.feasibility(goals[0], hit))
        assert fea == 0 if hit else fea > 0
        expected = 0.1 if distance < 0.25 else fea - distance
        assert float(move.reward) == pytest.approx(expected, abs=1e-4)
        assert bool(move.terminated) == (distance < 0.25)


def test_the_rivals_reward_is_the_distance_in_joint_space(cell, env):
    pure = PaperReachEnv(cell, env.segments, replace(LITERAL, reward="distance"))
    start = env.segments.start[1]
    move = pure.step(pure.start(jnp.int32(2), start), action_to(cell, start))
    assert not bool(move.terminated)
    away = np.linalg.norm(np.asarray(env.segments.goal[2] - start))
    assert float(move.reward) == pytest.approx(-away, abs=1e-3)


def test_to_the_letter_the_agent_does_not_see_its_goal(cell, env):
    blind = PaperReachEnv(cell, env.segments, replace(LITERAL, target="ee"))
    q = env.segments.start[0]
    first, second = (np.asarray(blind.observe(blind.start(jnp.int32(i), q))) for i in (0, 1))
    np.testing.assert_array_equal(first[:90], second[:90])
    seen = [np.asarray(env.observe(env.start(jnp.int32(i), q)))[84:90] for i in (0, 1)]
    assert np.abs(seen[0] - seen[1]).max() > 1e-2


def test_a_singular_home_is_refused(cell, env):
    straight = cell.replace(home=jnp.zeros(7))
    with pytest.raises(ValueError, match="manipulability at home"):
        PaperReachEnv(straight, env.segments)


@pytest.fixture(scope="module")
def engine_gap(cell):
    """Clearance at a configuration by C MuJoCo [m]."""
    checker = ConfigurationChecker(cell)
    checker.enter(home_scene(cell))
    return checker.gap


def test_at_rates_a_step_is_a_period_of_motion_and_stops_before_obstacles(cell, env, engine_gap):
    """C MuJoCo finds every configuration free that is entered; refused ones count as COL."""
    rules = PaperReachConfig()
    moving = PaperReachEnv(cell, env.segments, rules)
    step = jax.jit(moving.step)
    rng, refused = np.random.default_rng(0), 0
    reach = np.asarray(cell.velocity_limits) * rules.period + 1e-5
    for i in range(8):
        state = moving.start(jnp.int32(i), cell.home)
        for action in np.repeat(rng.uniform(-1, 1, (3, 7)), 12, axis=0).astype(np.float32):
            before = np.asarray(state.q)
            move = step(state, action)
            state = move.state
            q = np.asarray(state.q)
            assert (np.abs(q - before) <= reach).all()
            hit = bool(move.info["collision"])
            refused += hit
            assert (q == before).all() if hit else engine_gap(q) > 0
            assert bool(move.kept) != hit
    assert refused


def test_an_arm_that_stands_close_may_move_away(cell, env, engine_gap):
    """With a margin larger than its clearance at home, it still leaves, but comes no closer."""
    rules = PaperReachConfig(margin=1.0)
    moving = PaperReachEnv(cell, env.segments, rules)
    step, begin = jax.jit(moving.step), moving.start(jnp.int32(0), cell.home)
    before, moved = engine_gap(np.asarray(cell.home)), 0
    for action in np.random.default_rng(1).uniform(-1, 1, (12, 7)).astype(np.float32):
        move = step(begin, action)
        if not bool(move.info["collision"]):
            moved += 1
            assert engine_gap(np.asarray(move.state.q)) > before - 2e-3
    assert 0 < moved < 12


def test_hovering_never_earns_more_than_arriving(cell, env):
    moving = PaperReachEnv(cell, env.segments, PaperReachConfig())
    hover = PaperReachEnv(cell, env.segments, replace(PaperReachConfig(), hover_cost=0.0))
    action = action_to(cell, env.segments.goal[0])
    lowered, literal = (
        jax.jit(e.step)(e.start(jnp.int32(1), env.segments.start[1]), action)
        for e in (moving, hover)
    )
    assert not bool(lowered.terminated)
    assert float(lowered.reward) < PaperReachConfig().arrival
    assert float(literal.reward) > float(lowered.reward)
