# SPDX-License-Identifier: MIT
"""The planner with exact stand-ins for its agents, and the execution of what it plans.

RRT-Connect bridges, the shortest path chooses skills, Viterbi switches: no training is needed to
test everything around the agents.
"""

import re
from dataclasses import replace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from hybrid_jax.baselines.ablations import joint_agent_only, lfd_only, plan_directly
from hybrid_jax.envs.segments import single_segment
from hybrid_jax.export import to_joint_trajectory
from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels.collision.clearance import clearance
from hybrid_jax.kernels.collision.motion_validation import path_clearance
from hybrid_jax.planner import smoothing, trajectory_check
from hybrid_jax.planner.bridging import bridge_gaps, rrt_bridger
from hybrid_jax.planner.phase_scenes import (
    inside,
    task_scenes,
)
from hybrid_jax.planner.pipeline import plan_batch, plan_motion, prepare
from hybrid_jax.planner.shortcutting import shortcut
from hybrid_jax.planner.task_validation import admit
from hybrid_jax.runs.presets import DEFAULT
from hybrid_jax.runs.switch_problems import switch_problems
from hybrid_jax.skills.library import without
from hybrid_jax.tasks.registry import make_task, random_task
from hybrid_jax.tasks.scene_sampling import sample_scene
from hybrid_jax.types import Source, Status


@pytest.fixture(scope="module")
def reaching(cell, planned):
    """The cell in the scene of the first phase."""
    return inside(cell, task_scenes(cell, planned[0]), 0)


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
        assert trajectory_check.limit_faults(cell, trajectory) == []


def test_a_task_that_the_quick_look_leaves_open_is_looked_at_again(planner, planned):
    """No step of inverse kinematics at first, then as many as usual."""
    task, _ = planned
    one = replace(planner.config.quick_path_ik.search, seeds=1, iterations=1)
    blind = replace(planner.config.quick_path_ik, candidates=1, search=one)
    alone = replace(planner.config, quick_path_ik=None, path_ik=blind)
    result = plan_motion(replace(planner, config=alone), task, key=jax.random.key(0))
    assert result.status is not Status.OK
    both = replace(planner.config, quick_path_ik=blind, path_ik=planner.config.quick_path_ik)
    result = plan_motion(replace(planner, config=both), task, key=jax.random.key(0))
    assert result.status is Status.OK


def test_skills_alone_do_not_get_around_the_wall(planner):
    task = random_task(planner.cell, 4)
    result = plan_motion(lfd_only(planner), task, key=jax.random.key(0))
    assert result.status is Status.NO_PATH and result.phases == []
    assert "nothing is there" in result.detail, "no agent ran, and none is blamed"


def test_a_missing_demonstration_is_named(planner):
    gone = {n for n in planner.library.names if n.startswith(("transfer", "carry"))}
    poor = replace(planner, library=without(planner.library, gone))
    result = plan_motion(poor, random_task(planner.cell, 4), key=jax.random.key(0))
    assert result.status is Status.NEED_DEMO and "key pose 2 to 3" in result.detail


def test_a_batch_answers_each_task_for_itself(planner, planned):
    """A good task, one out of reach and one that does not belong here, in one call."""
    task = planned[0]
    far = np.array(task.key_poses)
    far[2] = np.asarray(dq.from_parts(jnp.array([3.0, 0, 0.5]), jnp.asarray(far[2, :4])))
    tasks = [task, replace(task, key_poses=far), replace(task, object_name="anvil")]
    lax = replace(planner.config, skills=replace(planner.config.skills, tolerance=100.0))
    good, out, unknown = plan_batch(replace(planner, config=lax), tasks, key=jax.random.key(0))
    assert good.status is Status.OK and len(good.phases) == 3
    assert out.status is Status.TASK_INFEASIBLE and out.detail == "key pose 2 is out of reach"
    assert unknown.status is Status.INVALID_TASK and "unknown object 'anvil'" in unknown.detail


def test_a_colliding_key_pose_is_named_with_what_it_touches(planner, planned):
    task = planned[0]
    low = np.array(task.key_poses)
    down = dq.position(jnp.asarray(low[1])) - jnp.array([0, 0, 0.08])
    low[1] = np.asarray(dq.from_parts(down, jnp.asarray(low[1, :4])))
    lax = replace(planner.config, skills=replace(planner.config.skills, tolerance=100.0))
    result = plan_motion(
        replace(planner, config=lax), replace(task, key_poses=low), key=jax.random.key(0)
    )
    assert result.status is Status.TASK_INFEASIBLE
    assert "key pose 1 collides in every configuration found: " in result.detail
    assert "table" in result.detail


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"object_poses": np.zeros((2, 7))}, r"shape \(5, 7\), got \(2, 7\)"),
        ({"object_poses": np.full((5, 7), np.nan)}, "object_poses: row 0 is not finite"),
        ({"key_poses": np.full((6, 8), np.inf)}, "key_poses: row 0 is not finite"),
    ],
)
def test_bad_numbers_are_refused_by_name(planner, planned, change, words):
    result = plan_motion(planner, replace(planned[0], **change), key=jax.random.key(0))
    assert result.status is Status.INVALID_TASK and not result.phases
    assert re.search(words, result.detail), result.detail


def test_a_start_outside_the_limits_is_clipped_if_rounding_did_it_else_refused(cell, planner):
    low, high, poses = *np.asarray(cell.joint_limits).T, sample_scene(cell, 4)
    start, checker = np.array(cell.home), trajectory_check.ConfigurationChecker(cell)
    start[5] = high[5] + 2e-4  # bent all the way back, the wrist touches nothing
    task = make_task(cell, "block_2", poses, start)
    clipped, note, refusal = admit(cell, checker, task)
    assert refusal is None and (clipped.start <= high).all() and (clipped.start >= low).all()
    assert note.startswith("(the start: joint_6 is at") and note.endswith("put back to the limit)")
    start[5] = high[5] + 0.1
    far = plan_motion(planner, make_task(cell, "block_2", poses, start), key=jax.random.key(0))
    assert far.status is Status.START_INVALID and "0.1 rad outside its limits" in far.detail
    nan = replace(task, start=np.full(7, np.nan))
    assert plan_motion(planner, nan, key=jax.random.key(0)).status is Status.START_INVALID


def test_a_start_that_collides_is_named_with_what_it_touches(cell, planner):
    low = np.array(cell.home)
    low[1] += 1.6
    task = make_task(cell, "block_2", sample_scene(cell, 4), low)
    result = plan_motion(planner, task, key=jax.random.key(0))
    assert result.status is Status.START_INVALID
    assert result.detail.startswith("the arm collides where it stands: ")


def test_another_start_is_where_the_plan_begins(cell, planner):
    start = np.array(cell.home) + np.float32(0.1)
    task = make_task(cell, "block_2", sample_scene(cell, 4), start)
    result = plan_motion(planner, task, key=jax.random.key(0))
    assert result.status is Status.OK, result.detail
    np.testing.assert_allclose(result.phases[0].positions[0], start, atol=1e-5)


def test_an_object_out_of_reach_is_infeasible_or_needs_a_demonstration(planner):
    poses = sample_scene(planner.cell, 4)
    poses[-1, :2] = [0.80, 0.28]
    task = make_task(planner.cell, "block_2", poses)
    result = plan_motion(planner, task, key=jax.random.key(0))
    assert result.status in (Status.TASK_INFEASIBLE, Status.NEED_DEMO)
    assert result.phases == [] and result.detail


def test_the_fallback_bridges_what_the_joint_agent_does_not(planner, planned):
    helpless = replace(
        planner,
        bridge=lambda segments, key: [None] * len(segments.start),
        fallback=rrt_bridger(planner.cell, DEFAULT.fallback),
    )
    result = plan_motion(helpless, planned[0], key=jax.random.key(0))
    assert result.status is Status.OK and result.shares[Source.RRT] > 0
    assert result.shares[Source.DRL] == 0 and sum(result.shares.values()) == pytest.approx(1)
    alone = replace(helpless, fallback=None)
    result = plan_motion(alone, planned[0], key=jax.random.key(0))
    assert result.status is Status.NO_PATH
    assert re.match(r"key pose \d to \d: no way around", result.detail)


def test_without_a_bridged_gap_the_switch_learns_from_the_skills(planner, planned, capsys):
    """As where the joint agent was trained for seconds."""
    helpless = replace(planner, bridge=lambda segments, key: [None] * len(segments.start))
    problems = switch_problems(helpless, [planned[0]], jax.random.key(0))
    assert "the joint agent bridged no gap of 1 tasks" in capsys.readouterr().err
    assert len(problems.available) >= 1


def test_a_seam_that_keeps_no_margin_is_reported(planner, planned):
    config = replace(planner.config, smoothing=replace(planner.config.smoothing, margin=0.04))
    result = plan_motion(replace(planner, config=config), planned[0], key=jax.random.key(0))
    assert result.status is Status.SEAM_FAILED and result.detail.startswith("phase 0")
    assert "mm of clearance are left on the way, and 40.0 mm are kept" in result.detail


def test_what_the_final_check_rejects_is_not_returned(planner, planned):
    config = replace(planner.config, check=replace(planner.config.check, clearance=0.02))
    result = plan_motion(replace(planner, config=config), planned[0], key=jax.random.key(0))
    assert result.status is Status.COLLISION and not result.phases
    assert "comes too close to" in result.detail


def test_a_switch_that_prefers_collisions_is_overruled(planner, planned):
    """The skill everywhere leads through the wall: the designed seams are what is returned."""
    stubborn = replace(planner, switch=lambda combined: np.zeros(200, int))
    result = plan_motion(stubborn, planned[0], key=jax.random.key(0))
    assert result.status is Status.OK and result.shares[Source.DRL] > 0


def test_the_joint_agent_alone_goes_from_key_pose_to_key_pose(cell, planner, planned):
    result = plan_directly(joint_agent_only(planner), [planned[0]], key=jax.random.key(1))[0]
    assert result.status is Status.OK, result.detail
    assert not result.skills
    assert len(result.phases) == 3 and result.drl_share == 1.0
    np.testing.assert_allclose(result.phases[2].positions[-1], cell.home, atol=1e-3)


def test_what_was_demonstrated_is_hardly_smoothed(reaching, planned):
    """A corner of the skill's hardly moves, the same corner of a detour does."""
    q = planned[1].phases[0].positions
    corner = np.stack([q[0], q[0] + np.eye(7)[0] * 0.4, q[0] + np.eye(7)[0] * 0.4 + np.eye(7)[6]])
    away = []
    for source in (Source.LFD, Source.DRL):
        marks = np.full(3, source, np.uint8)
        path, sources = smoothing.smooth(reaching, corner, marks, smoothing.SmoothingConfig())
        assert (sources == source).all()
        np.testing.assert_allclose(path[[0, -1]], corner[[0, -1]])
        away.append(np.abs(path - corner[1]).max(axis=1).min())
    # a Gaussian of 0.7 points moves a right-angled corner by about 0.3 points
    assert away[0] < 0.3 * smoothing.SmoothingConfig().spacing and away[1] > 3 * away[0]


def test_rrt_paths_are_free_between_their_points(cell, reaching, planner, planned):
    end = planned[1].phases[0].positions[-1].astype(np.float32)
    segment = single_segment(reaching.scene, cell.home, end)
    path = planner.bridge(segment, jax.random.key(3))[0]
    assert path_clearance(reaching, smoothing.densify(path, 0.03)).min() > 0
    np.testing.assert_allclose(path[[0, -1]], np.stack([cell.home, end]))


def test_each_gap_says_who_bridged_it(cell, reaching, planner, planned):
    end = planned[1].phases[0].positions[-1].astype(np.float32)
    one = jax.tree.map(lambda a: a[0], single_segment(reaching.scene, cell.home, end))
    picky = lambda segments, key: [None, *planner.bridge(segments, key)[1:]]  # noqa: E731
    ways = bridge_gaps(picky, planner.bridge, [one, one, one], jax.random.key(0))
    assert [way.source for way in ways] == [Source.RRT, Source.DRL, Source.DRL]
    assert bridge_gaps(picky, None, [one], jax.random.key(0)) == [None]


def test_shortcut_never_leaves_the_margin(reaching, planned):
    q = planned[1].phases[0].positions[::10]
    before = float(jnp.min(jax.vmap(lambda x: clearance(reaching, x))(jnp.asarray(q, jnp.float32))))
    margin = min(0.002, before)
    short = shortcut(reaching, q, margin, smoothing.SmoothingConfig())
    assert np.abs(np.diff(short, axis=0)).sum() <= np.abs(np.diff(q, axis=0)).sum() + 1e-6
    assert path_clearance(reaching, smoothing.densify(short, 0.02)).min() > min(0, before)


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


def test_more_skill_plans_never_leave_more_infeasible_way_points(cell, planner):
    checker, fewer = trajectory_check.ConfigurationChecker(cell), 0
    for number in range(50, 56):
        task, costs = random_task(cell, number), []
        for plans in (1, 4):
            several = replace(planner, config=replace(planner.config, plans=plans))
            _, jobs = prepare(several, checker, [task], jax.random.key(0))
            costs.append(jobs[0].routes.least_cost())
        assert costs[1] <= costs[0] + 1e-4  # batches of other sizes round otherwise
        fewer += costs[1] < costs[0] - 1e-4
    assert fewer, "one of the tasks has a better plan than the cheapest"
