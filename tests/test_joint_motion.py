# SPDX-License-Identifier: MIT
"""Motions from joint start to joint goal, and the search under them, against C MuJoCo."""

import jax
import mujoco
import numpy as np
import pytest
from scipy.optimize import brentq

from hybrid_jax.kernels.collision.clearance import clearance
from hybrid_jax.planner import point_to_point, trajectory_check
from hybrid_jax.planner.phase_scenes import home_scene, phase_scene
from hybrid_jax.planner.point_to_point import (
    LONG,
    QUICK,
    THOROUGH,
    WIDE,
    JointMotionConfig,
    find_path,
    plan_joint_motion,
)
from hybrid_jax.planner.rrt_connect import RrtConfig
from hybrid_jax.planner.smoothing import densify
from hybrid_jax.planner.trajectory_check import PhaseScene
from hybrid_jax.planner.trajectory_generation import motion_faults
from hybrid_jax.runtime.kept_programs import traced
from hybrid_jax.tasks.registry import random_task
from hybrid_jax.types import Status, Trajectory
from hybrid_jax.workcell.compile import compile_workcell

BALLS = """
<mujoco><compiler angle="radian"/><size nuser_jnt="2"/><worldbody>
  <geom name="wall" type="box" pos="{middle} 0 0.2" size="0.13 0.02 0.25" euler="0.1 0 0"/>
  <geom name="post" type="capsule" pos="-0.4 0.1 0.3" size="0.06 0.2"/>
  <body pos="0 0 0.2"><joint name="a" axis="0 0 1" range="-3 3" user="2 5"/>
    <geom type="sphere" pos="0.2 0 0" size="0.05"/><geom type="sphere" pos="0.3 0 0" size="0.05"/>
    <body pos="0.4 0 0"><joint name="b" axis="0 1 0" range="-2 2" user="2 5"/>
      <geom type="sphere" pos="0.1 0 0" size="0.04"/><geom type="sphere" pos="0.3 0 0" size="0.04"/>
      <site name="tool" pos="0.4 0 0"/>
    </body></body>
</worldbody></mujoco>"""
START, GOAL = np.array([-1.0, 0.0]), np.array([1.0, 0.0])
CONFIG = JointMotionConfig(searches=(RrtConfig(calls=100, margin=0.001, spread=np.inf),) * 2)


def ball_cell(middle: float):
    """Two links before a wall; with its middle at 0.65 m the outer one alone must be lifted."""
    model = mujoco.MjModel.from_xml_string(BALLS.format(middle=middle))
    return compile_workcell(model, f"balls_{middle}", None)


@pytest.fixture(scope="module")
def balls():
    return ball_cell(0.65)


def touches(model, q) -> bool:
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_forward(model, data)
    return data.ncon > 0 and data.contact.dist.min() < 0


def test_a_robot_of_balls_has_the_clearance_that_the_engine_sees(balls):
    assert balls.robot.shapes.all_spheres
    q = np.random.default_rng(0).uniform([-3, -2], [3, 2], (300, 2)).astype(np.float32)
    gaps = np.asarray(jax.vmap(clearance, (None, 0))(balls, q))
    assert (gaps < 0).any()
    for row, gap in zip(q, gaps, strict=True):
        assert touches(balls.model, row) == (gap < 0) or abs(gap) < 1e-5


def test_a_joint_motion_goes_around_a_wall(balls):
    result = plan_joint_motion(balls, START, GOAL, CONFIG, key=jax.random.key(0))
    assert result.status is Status.OK
    positions = result.phases[0].positions
    np.testing.assert_allclose(positions[[0, -1]], [START, GOAL], atol=1e-6)
    straight = np.linspace(START, GOAL, 200)
    assert any(touches(balls.model, q) for q in straight)
    assert not any(touches(balls.model, q) for q in positions)
    assert np.abs(result.phases[0].velocities).max() <= 2.0


def test_other_settings_of_the_search_trace_nothing(balls):
    find_path(balls, START, GOAL, JointMotionConfig(searches=(QUICK,)), jax.random.key(0))
    before = len(traced)
    for search in (WIDE, THOROUGH, LONG):
        config = JointMotionConfig(searches=(search,))
        assert find_path(balls, START, GOAL, config, jax.random.key(1)) is not None
    assert traced[before:] == []


def test_a_search_goes_around_what_another_one_stepped_over():
    balls = ball_cell(0.8)
    blocked = np.stack([START + [0.2, 0.1], START, GOAL, GOAL - [0.2, -0.1]])
    path = point_to_point._around(balls, blocked, JointMotionConfig(), jax.random.key(0))
    assert len(path) > 4
    np.testing.assert_allclose(path[[0, 1, -2, -1]], blocked, atol=1e-6)
    assert not any(touches(balls.model, q) for q in densify(path, 0.005))
    inside = np.stack([START, np.zeros(2), GOAL])
    assert touches(balls.model, inside[1])
    assert point_to_point._around(balls, inside, JointMotionConfig(), jax.random.key(0)) is None


def test_what_touches_between_the_points_that_are_looked_at_is_refused(balls):
    checker = trajectory_check.ConfigurationChecker(
        balls, trajectory_check.CheckConfig(max_step=10.0)
    )
    scene, still = home_scene(balls), np.zeros((2, 2))
    motion = Trajectory(
        np.array([0, 9.0]), np.stack([START, GOAL]), still, still, np.zeros(2, np.uint8)
    )
    assert trajectory_check.collision_fault(checker, scene, motion.positions) is None, (
        "both ends are free"
    )
    faults = motion_faults(balls, checker, scene, motion)
    assert len(faults) == 1 and "between the points" in faults[0]
    away = np.stack([START, START + [0.2, 0.1]])
    assert not motion_faults(balls, checker, scene, motion.replace(positions=away))


def test_what_cannot_be_planned_is_named(balls):
    inside = np.array([0.0, 0.0])
    for start, goal, status, words in (
        (START + [0, 9], GOAL, Status.START_INVALID, "the start: b is at"),
        (START, GOAL + [9, 0], Status.INVALID_TASK, "the goal: a is at"),
        (START[:1], GOAL, Status.START_INVALID, "2 finite joint values"),
        (inside, GOAL, Status.START_INVALID, "the start is not free"),
        (START, inside, Status.TASK_INFEASIBLE, "the goal is not free"),
    ):
        result = plan_joint_motion(balls, start, goal, CONFIG, key=jax.random.key(0))
        assert result.status is status and words in result.detail and not result.phases


def test_an_arm_that_almost_touches_may_leave_and_keeps_what_it_has(balls):
    far = trajectory_check.ConfigurationChecker(balls, trajectory_check.CheckConfig(clearance=0.1))
    far.enter(home_scene(balls))
    lift = brentq(lambda b: far.gap(np.array([-0.05, b])) - 3e-4, -1.5, -0.1, xtol=1e-9)
    start = np.array([-0.05, lift])
    result = plan_joint_motion(balls, start, GOAL, CONFIG, key=jax.random.key(0))
    assert result.status is Status.OK, result.detail
    assert "it keeps 0.27 mm only" in result.detail
    positions = result.phases[0].positions
    assert min(far.gap(q) for q in positions) >= 2.6e-4
    np.testing.assert_allclose(positions[0], start, atol=1e-9)
    away = plan_joint_motion(balls, START, GOAL, CONFIG, key=jax.random.key(0))
    assert "keeps" not in away.detail


LOAD = """<body name="load" pos="-1 -1 0.2"><freejoint/>
    <geom name="load" type="sphere" size="0.05"/></body></worldbody>"""
HELD = np.array([-0.12, 0, 0.12, 1, 0, 0, 0.0])
"""Pose of the load in the tool's frame: it stands on the outer link, which goes under the wall."""


def load_touches(model, positions) -> bool:
    """Does the load touch the wall or the post anywhere along a motion?"""
    data, found = mujoco.MjData(model), False
    for q in positions:
        data.qpos[:2] = q
        mujoco.mj_kinematics(model, data)
        turn = data.site_xmat[0].reshape(3, 3)
        data.qpos[2:5] = data.site_xpos[0] + turn @ HELD[:3]
        mujoco.mju_mat2Quat(data.qpos[5:9], turn.ravel())
        mujoco.mj_forward(model, data)
        pairs = {frozenset(model.geom(int(g)).name for g in pair) for pair in data.contact.geom}
        found |= any("load" in pair and pair & {"wall", "post"} for pair in pairs)
    return found


def test_what_is_held_is_carried_around_the_wall_as_well():
    model = mujoco.MjModel.from_xml_string(BALLS.format(middle=0.65).replace("</worldbody>", LOAD))
    cell = compile_workcell(model, "load", None)
    lying = np.array([[-1, -1, 0.2, 1, 0, 0, 0.0]])
    scenes = [PhaseScene(lying, 0.0, *held, ()) for held in ((None, None), ("load", HELD))]
    ways_with_load = []
    for seed in range(4):
        bare, loaded = (
            plan_joint_motion(cell, START, GOAL, CONFIG, key=jax.random.key(seed), scene=scene)
            for scene in scenes
        )
        assert bare.status is Status.OK and loaded.status is Status.OK
        ways_with_load.append(load_touches(model, bare.phases[0].positions))
        assert not load_touches(model, loaded.phases[0].positions)
    assert any(ways_with_load), "without a load the arm may go where a load would touch"


def test_no_way_is_said():
    near = ball_cell(0.43)  # in the way of the inner link as well, which cannot be lifted
    result = plan_joint_motion(near, START, GOAL, CONFIG, key=jax.random.key(0))
    assert result.status is Status.NO_PATH and "no path" in result.detail


def test_the_engine_sees_the_same_without_the_pairs_that_it_skips(cell, monkeypatch):
    quick, rng, touched = trajectory_check.ConfigurationChecker(cell), np.random.default_rng(0), []
    with monkeypatch.context() as patch:
        patch.setattr(trajectory_check.ConfigurationChecker, "_skip_idle_pairs", lambda self: None)
        plain = trajectory_check.ConfigurationChecker(cell)
    home, task = np.asarray(cell.home), random_task(cell, 40_100)
    for kind in range(3):
        scene = phase_scene(cell, task, kind)
        quick.enter(scene)
        with monkeypatch.context() as patch:
            patch.setattr(
                trajectory_check.ConfigurationChecker, "_skip_idle_pairs", lambda self: None
            )
            plain.enter(scene)
        for q in home + rng.normal(0, 0.5, (60, 7)):
            answers = [checker.collision(q) is None for checker in (quick, plain)]
            assert answers[0] == answers[1]
            touched.append(not answers[0])
    assert 10 < sum(touched) < len(touched) - 10
