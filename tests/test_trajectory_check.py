# SPDX-License-Identifier: MIT
"""The final check of trajectories: walls, held objects, limits and key poses."""

import re
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels.collision.clearance import clearance
from hybrid_jax.planner import trajectory_check
from hybrid_jax.planner.phase_scenes import (
    CARRYING,
    REACHING,
    TRANSFERRING,
    inside,
    phase_scene,
    segment_kinds,
    task_scenes,
)
from hybrid_jax.planner.trajectory_generation import find_faults
from hybrid_jax.workcell.poses import pose_row


@pytest.fixture(scope="module")
def reaching(cell, planned):
    """The cell in the scene of the first phase."""
    return inside(cell, task_scenes(cell, planned[0]), 0)


def test_the_final_check_sees_a_wall(cell, planner, reaching, planned):
    task, result = planned
    checker, scene = trajectory_check.ConfigurationChecker(cell), phase_scene(cell, task, REACHING)
    assert trajectory_check.collision_fault(checker, scene, result.phases[0].positions) is None
    q = np.array(result.phases[0].positions)
    reach = np.clip(q + np.linspace(0, 1, len(q))[:, None] * [-1.0, 0, 0, 0, 0, 0, 0], -6, 6)
    assert re.search(
        "touches|too close to", trajectory_check.collision_fault(checker, scene, reach)
    )
    bad = replace(result.phases[0], positions=reach)
    faults = find_faults(reaching, checker, task, 0, bad)
    assert any("clearance falls to -" in f for f in faults), "the kernels see it as well"
    assert any(re.search("touches|too close to", fault) for fault in faults)
    assert any("key pose 1 is missed" in fault for fault in faults)


def test_the_final_check_carries_the_object(cell, planned):
    """Held low over the table, the object touches it; with the table as support it may."""
    task, result = planned
    scene = phase_scene(cell, task, CARRYING)
    checker, first = (
        trajectory_check.ConfigurationChecker(cell),
        result.phases[1].positions[:1].repeat(2, axis=0),
    )
    assert trajectory_check.collision_fault(checker, scene, first) is None
    bare = replace(scene, support=())
    assert "table" in trajectory_check.collision_fault(checker, bare, first)


def test_a_held_object_may_touch_its_support_only_where_it_is_lifted(cell, planned):
    task, result = planned
    q, scenes = result.phases[0].positions[-1], task_scenes(cell, task)
    checker, gaps, found = trajectory_check.ConfigurationChecker(cell), [], []
    for segment, kind in ((1, CARRYING), (2, TRANSFERRING)):
        assert segment_kinds(task)[segment] == kind
        gaps.append(float(clearance(inside(cell, scenes, segment), jnp.asarray(q, jnp.float32))))
        checker.enter(phase_scene(cell, task, kind))
        found.append(checker.collision(q))
    assert gaps[0] > 0.0005 and found[0] is None
    assert gaps[1] < 0.0005 and "table" in found[1]


def test_the_final_check_sees_broken_limits_and_missed_poses(cell, planned):
    task, result = planned
    trajectory = result.phases[0]
    fast = replace(trajectory, velocities=trajectory.velocities * 9)
    assert any("velocity limit of joint_" in f for f in trajectory_check.limit_faults(cell, fast))
    rushed = replace(trajectory, times=trajectory.times / 9)
    faults = trajectory_check.limit_faults(cell, rushed)
    assert any("velocity" in f for f in faults) and any("acceleration" in f for f in faults)
    jumped = np.array(trajectory.positions)
    jumped[40:, 3] += 0.05
    faults = trajectory_check.limit_faults(cell, replace(trajectory, positions=jumped))
    assert any("joint_4" in f for f in faults)
    still = replace(trajectory, times=np.zeros_like(trajectory.times))
    assert any("do not grow" in f for f in trajectory_check.limit_faults(cell, still))
    checker = trajectory_check.ConfigurationChecker(cell)
    end, pose = trajectory.positions[-1], pose_row(task.key_poses[1])
    assert trajectory_check.pose_fault(checker, end, pose, "it") is None
    off = pose + [0, 0, 0.01, 0, 0, 0, 0]
    assert "it is missed by 10." in trajectory_check.pose_fault(checker, end, off, "it")


def test_a_key_pose_on_the_way_must_be_passed(cell, planned):
    task, plan = planned
    checker = trajectory_check.ConfigurationChecker(cell)
    path, lifted = plan.phases[1].positions, pose_row(task.key_poses[2])
    tools = np.array([checker.position(q) for q in trajectory_check.checked_points(path, 0.02)])
    sides = lifted + 0.05 * np.vstack([np.eye(3, 7), -np.eye(3, 7)])
    away = [np.linalg.norm(tools - side[:3], axis=1).min() for side in sides]
    beside, turned = sides[np.argmax(away)], lifted.copy()  # the path passes one of them
    turned[3:] = dq.mul(
        dq.from_parts(np.zeros(3), lifted[3:]),
        dq.from_parts(np.zeros(3), np.array([0.98, 0, 0, 0.199])),
    )[:4]
    poses = {"it": lifted, "one beside": beside, "one turned": turned}
    faults = trajectory_check.passing_faults(checker, path, poses)
    assert [fault.split(" is missed by")[0] for fault in faults] == ["one beside", "one turned"]
