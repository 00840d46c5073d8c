# SPDX-License-Identifier: MIT
"""The planner with exact stand-ins for its agents, and the execution of what it plans.

RRT-Connect bridges, the shortest path chooses skills, Viterbi switches: no training is needed to
test everything around the agents.
"""

import json
from dataclasses import replace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from hybrid_jax import rrt
from hybrid_jax.agents.switching import SwitchConfig
from hybrid_jax.errors import TaskError, UnknownNameError
from hybrid_jax.export import to_joint_trajectory
from hybrid_jax.kernels.collision import clearance
from hybrid_jax.planner import checking, timing
from hybrid_jax.planner.lfd import optimal_chooser, phase_cell
from hybrid_jax.planner.loading import optimal_switcher, read_library
from hybrid_jax.planner.pipeline import Planner, lfd_only, plan_motion
from hybrid_jax.simulation.execution import execute, start_data
from hybrid_jax.skills.library import without
from hybrid_jax.skills.task import handling_task, random_task, read_task, sample_scene
from hybrid_jax.types import Status


@pytest.fixture(scope="module")
def planner(cell):
    def bridge(scene, start, goal, key):
        scenes = jax.tree.map(lambda a: a[None], scene)
        ends = (jnp.asarray(q, jnp.float32)[None] for q in (start, goal))
        return rrt.plan_paths(cell, scenes, *ends, key=key)[0]

    return Planner(
        cell, read_library(), optimal_chooser, bridge, optimal_switcher(SwitchConfig()), 0.1
    )


@pytest.fixture(scope="module")
def planned(planner):
    task = random_task(planner.cell, 4)
    return task, plan_motion(planner, task, key=jax.random.key(0))


def test_a_task_is_planned_by_both_sources(planned):
    task, result = planned
    assert result.status is Status.OK, result.detail
    assert len(result.phases) == 3 and len(result.skills) >= 3
    assert 0 < result.drl_share < 1
    assert (result.phases[1].sources == 1).any(), "the way to the tray leads through the wall"


def test_phases_join_and_end_where_the_task_says(cell, planned):
    task, result = planned
    np.testing.assert_allclose(result.phases[0].positions[0], cell.home, atol=1e-5)
    np.testing.assert_allclose(result.phases[2].positions[-1], cell.home, atol=1e-3)
    for before, after in zip(result.phases[:-1], result.phases[1:], strict=True):
        np.testing.assert_allclose(before.positions[-1], after.positions[0], atol=1e-5)
    data = mujoco.MjData(cell.model)
    for phase, pose in ((0, 1), (1, 4)):
        data.qpos[list(cell.source.layout.qpos)] = result.phases[phase].positions[-1]
        mujoco.mj_kinematics(cell.model, data)
        from hybrid_jax.kernels import dualquat as dq

        wanted = np.asarray(dq.position(jnp.asarray(task.key_poses[pose])))
        assert np.linalg.norm(data.site_xpos[cell.source.layout.tool_site] - wanted) < 1.1e-3


def test_trajectories_are_consistent_and_within_limits(cell, planned):
    _, result = planned
    for trajectory in result.phases:
        dt = np.diff(trajectory.times)
        assert (dt > 0).all() and np.abs(trajectory.velocities[[0, -1]]).max() < 1e-3
        slopes = np.diff(trajectory.positions, axis=0) / dt[:, None]
        middle = (trajectory.velocities[1:] + trajectory.velocities[:-1]) / 2
        assert np.abs(slopes - middle).max() < 0.05
        assert (np.abs(trajectory.velocities) <= np.asarray(cell.velocity_limits) * 1.001).all()
        assert checking.limit_faults(cell, trajectory) == []


def test_the_engine_executes_the_plan(cell, planned):
    task, result = planned
    report = execute(cell, task, result)
    assert report.placed and report.grasped and report.success, report.touched
    assert report.tracking_error < 0.03


def test_execution_refuses_what_it_cannot_start(cell, planned):
    task, result = planned
    with pytest.raises(ValueError, match="nothing to execute"):
        execute(cell, task, replace(result, phases=[], status=Status.NEED_DEMO))
    data = start_data(cell, task)
    data.qpos[cell.source.layout.qpos[0]] += 0.5
    with pytest.raises(ValueError, match="away from where the plan starts"):
        execute(cell, task, result, data=data)


def test_skills_alone_do_not_get_around_the_wall(planner):
    task = random_task(planner.cell, 4)
    result = plan_motion(lfd_only(planner), task, key=jax.random.key(0))
    assert result.status is Status.DRL_TIMEOUT and result.phases == []


def test_a_missing_demonstration_is_named(planner):
    gone = {n for n in planner.library.names if n.startswith(("transfer", "carry"))}
    poor = replace(planner, library=without(planner.library, gone))
    result = plan_motion(poor, random_task(planner.cell, 4), key=jax.random.key(0))
    assert result.status is Status.NEED_DEMO and "key pose 2 to 3" in result.detail


def test_an_object_out_of_reach_is_infeasible_or_needs_a_demonstration(planner):
    poses = sample_scene(planner.cell, 4)
    poses[-1, :2] = [0.80, 0.28]
    task = handling_task(planner.cell, "block_2", poses)
    result = plan_motion(planner, task, key=jax.random.key(0))
    assert result.status in (Status.TASK_INFEASIBLE, Status.NEED_DEMO)
    assert result.phases == [] and result.detail


def test_the_final_check_sees_a_wall(cell, planned):
    task, result = planned
    inside = phase_cell(cell, task, False, False)
    q = np.array(result.phases[0].positions)
    reach = np.clip(q + np.linspace(0, 1, len(q))[:, None] * [1.2, 0, 0, 0, 0, 0, 0], -6, 6)
    bad = replace(result.phases[0], positions=reach)
    faults = checking.collision_faults(
        inside, bad, task, carrying=False, opening=0.0425, poses=task.object_poses,
        held_in_tool=np.array([0, 0, 0, 1.0, 0, 0, 0]),
    )  # fmt: skip
    assert len(faults) == 2, "kernels and engine both"
    fast = replace(result.phases[0], velocities=result.phases[0].velocities * 9)
    assert any("velocity limit of joint_" in f for f in checking.limit_faults(cell, fast))


def test_rrt_paths_are_free_between_their_points(cell, planner, planned):
    task, result = planned
    inside = phase_cell(cell, task, False, False)
    path = planner.bridge(
        inside.scene,
        cell.home,
        result.phases[0].positions[-1].astype(np.float32),
        jax.random.key(3),
    )
    dense = timing.densify(path, 0.03)
    assert timing.path_clearance(inside, dense).min() > 0
    np.testing.assert_allclose(path[0], cell.home)


def test_shortcut_never_leaves_the_margin(cell, planned):
    task, result = planned
    inside = phase_cell(cell, task, False, False)
    q = result.phases[0].positions[::10]
    before = float(jnp.min(jax.vmap(lambda x: clearance(inside, x))(jnp.asarray(q, jnp.float32))))
    short = timing.shortcut(inside, q, min(0.002, before), timing.TimingConfig())
    assert np.abs(np.diff(short, axis=0)).sum() <= np.abs(np.diff(q, axis=0)).sum() + 1e-6
    assert timing.path_clearance(inside, timing.densify(short, 0.02)).min() > min(0.0, before)


def test_export_has_the_layout_of_a_joint_trajectory(cell, planned):
    task, result = planned
    out = to_joint_trajectory(cell, task, result)
    assert out["joint_names"] == [f"joint_{i}" for i in range(1, 8)] and out["status"] == "OK"
    times = [p["time_from_start"] for p in out["points"]]
    assert times == sorted(times)
    assert {"positions", "velocities", "accelerations", "time_from_start"} == set(out["points"][0])
    assert {p["source"] for p in out["parts"]} == {"LfD", "DRL"}
    assert out["parts"][-1]["last"] == len(out["points"]) - 1
    assert [g["command"] for g in out["gripper"]] == ["open", "close", "open", "open"]


def test_task_files_are_checked(cell, tmp_path):
    path = tmp_path / "task.json"
    for text, message in (
        ("{", "task.json"), ("{}", "field 'object'"),
        ('{"object": "hammer", "object_poses": [[1]]}', "must be 5 finite rows"),
    ):  # fmt: skip
        path.write_text(text)
        with pytest.raises(TaskError, match=message):
            read_task(cell, path)
    path.write_text('{"object": "spanner"}')
    with pytest.raises(UnknownNameError, match="hammer"):
        read_task(cell, path)
    path.write_text(json.dumps({"object": "bolt_1", "scene_seed": 3}))
    assert read_task(cell, path).object_name == "bolt_1"
