# SPDX-License-Identifier: MIT
"""Joints that turn more than once, ends that are one, and numbers of double precision."""

import os
import subprocess
import sys
from dataclasses import replace

import jax
import mujoco
import numpy as np
import pytest

from hybrid_jax.contracts import PlanResult
from hybrid_jax.planner import timing
from hybrid_jax.planner.pipeline import plan_motion
from hybrid_jax.planner.point_to_point import plan_joint_motion
from hybrid_jax.planner.turns import nearest_goal, plan_in_turns, turns_from, winding
from hybrid_jax.tasks.registry import make_task
from hybrid_jax.tasks.scene_sampling import sample_scene
from hybrid_jax.tasks.task import Task
from hybrid_jax.types import Status, Trajectory
from hybrid_jax.workcell.compile import compile_workcell

TURNING = """
<mujoco><compiler angle="radian"/><size nuser_jnt="2"/><worldbody>
  <geom name="post" type="box" pos=".45 .35 .2" size=".03 .03 .2"/>
  <body pos="0 0 .2"><joint name="rail" type="slide" axis="0 1 0" range="-.2 .2" user="1 5"/>
    <geom size=".03"/>
    <body><joint name="base" axis="0 0 1" user="2 5"/>
      <geom type="capsule" fromto=".1 0 0 .3 0 0" size=".02"/>
      <body pos=".35 0 0"><joint name="wrist" axis="1 0 0" range="-9.5 9.5" user="2 5"/>
        <geom type="capsule" fromto=".03 0 0 .1 0 0" size=".02"/><site name="tool" pos=".12 0 0"/>
      </body></body></body>
</worldbody></mujoco>"""


@pytest.fixture(scope="module")
def turning():
    return compile_workcell(mujoco.MjModel.from_xml_string(TURNING), "turning", None)


def way(result):
    """Of each joint, over the whole motion."""
    return sum(np.abs(np.diff(p.positions, axis=0)).sum(axis=0) for p in result.phases)


def test_a_joint_without_limits_goes_the_shorter_way(turning):
    assert turning.source.layout.unlimited == (False, True, False)
    assert winding(turning).tolist() == [False, True, True]
    result = plan_joint_motion(turning, [0, 3.10, 0], [0, -3.10, 0], key=jax.random.key(0))
    assert result.status is Status.OK
    np.testing.assert_allclose(way(result)[1], 2 * np.pi - 6.2, atol=1e-4)
    np.testing.assert_allclose(result.phases[0].positions[-1][1], 2 * np.pi - 3.10, atol=1e-6)


@pytest.mark.parametrize("turns", [-40, 3, 1000])
def test_any_reading_of_its_encoder_is_a_start(turning, turns):
    start = np.array([0.1, 0.4 + turns * 2 * np.pi, -7.0])
    result = plan_joint_motion(turning, start, [-0.1, -0.5, -7.5], key=jax.random.key(0))
    assert result.status is Status.OK, result.detail
    phase = result.phases[0]
    np.testing.assert_allclose(phase.positions[0], start, atol=1e-9 * abs(turns) + 1e-6)
    np.testing.assert_allclose(
        phase.positions[-1], [-0.1, -0.5 + turns * 2 * np.pi, -7.5], atol=1e-4
    )
    assert way(result)[1] < 2.0 and way(result)[2] < 1.0


def test_a_limited_joint_is_moved_to_the_very_angle(turning):
    """Its goal one turn away is another goal."""
    result = plan_joint_motion(turning, [0, 0, 3.0], [0, 0, 3.0 - 2 * np.pi], key=jax.random.key(0))
    assert result.status is Status.OK
    np.testing.assert_allclose(way(result)[2], 2 * np.pi, atol=1e-3)
    refused = plan_joint_motion(turning, [0, 0, 9.6], [0, 0, 0], key=jax.random.key(0))
    assert refused.status is Status.START_INVALID and "wrist is at 9.6" in refused.detail
    refused = plan_joint_motion(turning, [0.3, 0, 0], [0, 0, 0], key=jax.random.key(0))
    assert "0.300000 m" in refused.detail, "a slide's unit is said"


def test_the_nearest_reading_of_a_goal(turning):
    start, goal = np.array([0, 7.0, 7.0]), np.array([0, 0.9, 0.9])
    np.testing.assert_allclose(nearest_goal(turning, start, goal), [0, 0.9 + 2 * np.pi, 0.9])
    np.testing.assert_allclose(turns_from(turning, start, goal), [0, 2 * np.pi, 2 * np.pi])


def test_a_rest_keeps_the_limits_of_acceleration(turning):
    """A cubic from rest to rest, over all its time."""
    limits, start = np.asarray(turning.chain.acceleration_limits), np.zeros(3)
    end = np.array([9e-6, -9e-6, 0])
    rest = timing.resting(turning, start, end, 0)
    assert (6 * np.abs(end) / rest.times[-1] ** 2 <= limits).all()
    assert timing.resting(turning, start, start, 0).times[-1] == 1e-3


@pytest.mark.parametrize("away", [0.0, 1e-9, 1e-7, 1e-5, 3e-5, 1e-4])
def test_a_goal_that_is_the_start_takes_no_time(turning, away):
    start = np.array([0.05, -0.4, 0.3])
    result = plan_joint_motion(turning, start, start + away, key=jax.random.key(0))
    assert result.status is Status.OK, result.detail
    (phase,) = result.phases
    assert phase.times[-1] < 0.3 and (np.diff(phase.times) > 0).all()
    np.testing.assert_allclose(phase.positions[-1], start + away, atol=1e-6)
    assert not phase.velocities[[0, -1]].any()


def test_a_task_that_starts_one_turn_off_is_as_short_as_from_home(planner):
    cell, poses = planner.cell, sample_scene(planner.cell, 7)
    home = np.asarray(cell.home, float)
    off = home.copy()
    off[6] -= 2 * np.pi
    near, far = (
        plan_motion(planner, make_task(cell, "block_1", poses, q), key=jax.random.key(0))
        for q in (home, off)
    )
    assert near.status is Status.OK and far.status is Status.OK
    np.testing.assert_allclose(far.phases[0].positions[0], off, atol=1e-5)
    # the start rounds otherwise, and RRT-Connect draws another way; a turn would add six radians
    assert way(far)[6] < way(near)[6] + 2 and way(far).sum() < way(near).sum() + 3
    low, high = np.asarray(cell.joint_limits).T
    for phase in far.phases:
        assert ((phase.positions >= low) & (phase.positions <= high)).all()


def straight(tasks):
    """A planner that goes straight to where a task ends."""
    phases = [resting(np.asarray(task.start), np.asarray(task.end)) for task in tasks]
    return [PlanResult(Status.OK, "found", [phase]) for phase in phases]


def resting(start, end):
    still = np.zeros((2, len(start)))
    return Trajectory(np.arange(2.0), np.stack([start, end]), still, still, np.zeros(2, np.uint8))


@pytest.mark.parametrize(
    "start, end, found",
    [  # base has no limits, wrist goes from -9.5 to 9.5
        ([0, 2 * np.pi, 0], [0, 2 * np.pi, 0], [0, 2 * np.pi, 0]),
        ([0, 2 * np.pi, 0], [0, 0.1, 0], [0, 2 * np.pi + 0.1, 0]),
        ([0, 0, 2 * np.pi], [0, 0, 2 * np.pi], [0, 0, 2 * np.pi]),
        ([0, 0, 2 * np.pi], [0, 0, 0.1], [0, 0, 2 * np.pi + 0.1]),
        ([0, 0, 0], [0, 0, -2 * np.pi], [0, 0, 0]),
        ([0, 0, 9.4], [0, 0, 0.2], [0, 0, 0.2 + 2 * np.pi]),
        ([0, 0, 9.4], [0, 0, -3.0], [0, 0, -3.0]),  # the nearest reading is beyond the limit
    ],
)
def test_a_task_ends_in_the_reading_nearest_to_its_start(turning, start, end, found):
    start, end = (np.array(q, np.float32) for q in (start, end))
    task = Task("x", np.zeros((0, 7)), np.zeros((2, 8)), (False,), start, end)
    result = plan_in_turns(turning, [task], straight)[0]
    np.testing.assert_allclose(result.phases[0].positions[0], start, atol=1e-5)
    np.testing.assert_allclose(result.phases[-1].positions[-1], found, atol=1e-5)
    other = np.abs(np.array(found) - end).max() > 1
    assert ("from the end that the task names" in result.detail) == other


def test_a_joint_without_limits_may_be_at_home_anywhere():
    """Starts are brought within half a turn of home, and that is inside what is planned in."""
    model = mujoco.MjModel.from_xml_string(
        TURNING.replace(
            "</mujoco>", '<keyframe><key name="home" qpos="0 4 0"/></keyframe></mujoco>'
        )
    )
    cell = compile_workcell(model, "turned", None)
    result = plan_joint_motion(cell, [0, 0.5, 0], [0, 1.0, 0], key=jax.random.key(0))
    assert result.status is Status.OK, result.detail
    np.testing.assert_allclose(result.phases[0].positions[[0, -1], 1], [0.5, 1.0], atol=1e-6)


def test_where_turning_back_would_leave_the_limits_the_arm_unwinds_once(planner):
    cell, poses = planner.cell, sample_scene(planner.cell, 7)
    chain = cell.chain.replace(limits=cell.chain.limits.at[6].set(np.array([-3.3, 6.2831853])))
    tight = cell.replace(chain=chain)
    off = np.asarray(cell.home, float)
    off[6] -= 2 * np.pi
    task = make_task(cell, "block_1", poses, off)
    result = plan_motion(replace(planner, cell=tight), task, key=jax.random.key(0))
    assert result.status is Status.OK, result.detail
    limits = np.asarray(tight.joint_limits)
    for phase in result.phases:
        assert (phase.positions >= limits[:, 0] - 1e-4).all()
    assert way(result)[6] < 2 * np.pi + 8


DOUBLE = """
import sys, jax, numpy as np, jax.numpy as jnp
import hybrid_jax as hj
assert jax.config.jax_enable_x64 and jnp.zeros(1).dtype == jnp.float64
cell = hj.load_workcell(sys.argv[1])
q = jnp.asarray(cell.home, jnp.float64) + 0.1
batch = jax.jit(jax.vmap(lambda q: hj.clearance(cell, q)))(jnp.tile(q, (3, 1)))
assert batch.shape == (3,) and jnp.allclose(batch, hj.clearance(cell, np.asarray(q, float)))
assert jax.grad(lambda q: hj.clearance(cell, q))(q).dtype == jnp.float64
assert hj.solve_ik(cell, hj.tool_pose(cell, q), key=jax.random.key(0)).found
assert hj.edge_is_free(cell, cell.home, q)[0] in (True, False)
result = hj.plan_joint_motion(cell, np.asarray(q, float), np.asarray(cell.home, float),
                              key=jax.random.key(0))
print(result.status.name)
"""


def test_double_precision_elsewhere_does_not_matter_here(small_cell):
    done = subprocess.run(
        [sys.executable, "-c", DOUBLE, small_cell.source.path],
        capture_output=True,
        text=True,
        env={**os.environ, "JAX_ENABLE_X64": "1"},
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "OK"
