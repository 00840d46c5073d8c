# SPDX-License-Identifier: MIT
"""The inspection cell: its geometry, tasks without a gripper, their plans, and their study."""

import functools
from dataclasses import replace

import jax
import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import hybrid_jax
from hybrid_jax.contracts import PlanResult
from hybrid_jax.errors import UnknownNameError, WorkcellError
from hybrid_jax.execution.disturbances import Disturbance
from hybrid_jax.execution.inspection import InspectionReport, Trial, inspect_parts
from hybrid_jax.execution.plant import Touch
from hybrid_jax.execution.scheduler import planning
from hybrid_jax.export import to_joint_trajectory
from hybrid_jax.export.fanuc_tp import to_tp_program
from hybrid_jax.export.fanuc_tp_reader import read_tp_program
from hybrid_jax.export.waypoint_reduction import TOLERANCE
from hybrid_jax.planner.pipeline import plan_batch
from hybrid_jax.runs.load_planner import untrained_planner
from hybrid_jax.runs.presets import DEFAULT, PAPER
from hybrid_jax.studies import inspection as study
from hybrid_jax.studies.inspection_pictures import draw_study
from hybrid_jax.studies.measures import Metrics
from hybrid_jax.studies.steadiness import add_steadiness, steady_from
from hybrid_jax.tasks.handling import require_handling
from hybrid_jax.tasks.inspection import brush_errors, on_face, random_start
from hybrid_jax.tasks.registry import make_task, random_task
from hybrid_jax.tasks.scene_sampling import sample_scene
from hybrid_jax.types import Status, Trajectory
from hybrid_jax.workcell.load import load_workcell
from hybrid_jax.workcell.poses import as_row, pose_of


@pytest.fixture(scope="session")
def fpi():
    """The inspection cell."""
    return load_workcell("fpi")


@pytest.fixture(scope="session")
def inspector(fpi):
    """Its planner: skills, and RRT-Connect where they cannot be followed."""
    config = replace(DEFAULT.planner, path_ik=DEFAULT.planner.quick_path_ik, quick_path_ik=None)
    return untrained_planner(fpi, 0.05, config)


@pytest.fixture(scope="session")
def reports(fpi, inspector):
    """Two trials, carried out in physics."""
    trials = [Trial("left_2", 3), Trial("right_4", 8)]
    return inspect_parts(fpi, planning(functools.partial(plan_batch, inspector), 0), trials)


def test_home_is_free_and_nothing_can_be_held(fpi):
    assert hybrid_jax.clearance(fpi, fpi.home) > 0.02
    assert fpi.scene.payload.count == 0 and fpi.home.shape == (6,)
    assert len(fpi.source.task.parts) == 10
    with pytest.raises(WorkcellError, match="nothing is handled"):
        require_handling(fpi)


def test_faces_are_where_the_engine_sees_the_blades(fpi):
    """Rays of C MuJoCo from above hit every blade where its face is said to be, within 1 mm."""
    data, poses = mujoco.MjData(fpi.model), sample_scene(fpi, 5)
    for address, pose in zip(fpi.source.layout.object_qpos, poses, strict=True):
        data.qpos[address : address + 7] = pose
    mujoco.mj_forward(fpi.model, data)
    task, geom = fpi.source.task, np.zeros(1, np.int32)
    for part, pose in zip(task.parts, poses, strict=True):
        body, face = fpi.model.body(part.name).id, task.face(part.face)
        for share in np.linspace(0, 1, 7):
            tool = pose_of(pose[:3], pose[3:]) * on_face(face, share)
            ray = tool.rotation.apply([0.0, 0.0, 1.0])
            away = mujoco.mj_ray(
                fpi.model, data, tool.translation - 0.05 * ray, ray, None, 1, -1, geom
            )
            assert fpi.model.geom_bodyid[geom[0]] == body
            assert away == pytest.approx(0.05, abs=1e-3)


def test_brush_errors_are_what_was_added_to_a_perfect_stroke(fpi):
    face = fpi.source.task.faces[0]
    part = np.array([0.4, 0.1, 0.02, *Rotation.from_euler("z", 0.4).as_quat(scalar_first=True)])
    lies = pose_of(part[:3], part[3:])
    tools = [lies * on_face(face, share) for share in np.linspace(0, 1, 9)]
    angles, gaps = brush_errors(face, part, np.stack([as_row(tool) for tool in tools]))
    np.testing.assert_allclose([angles, gaps], 0.0, atol=1e-6)
    # about its own axis a brush may turn; tilted by 0.1 rad and 3 mm off the face it is wrong
    spun = [tool * pose_of([0, 0, 0], [np.cos(0.3), 0, 0, np.sin(0.3)]) for tool in tools]
    np.testing.assert_allclose(
        brush_errors(face, part, np.stack([as_row(tool) for tool in spun]))[0], 0.0, atol=1e-6
    )
    off = [tool * pose_of([0, 0, -0.003], [np.cos(0.05), np.sin(0.05), 0, 0]) for tool in tools]
    angles, gaps = brush_errors(face, part, np.stack([as_row(tool) for tool in off]))
    np.testing.assert_allclose(angles, 0.1, atol=1e-6)
    np.testing.assert_allclose(gaps, 0.003, atol=1e-6)


def test_tasks_rest_over_the_tray_and_on_the_part(fpi):
    poses = sample_scene(fpi, 1)
    task = make_task(fpi, "right_1", poses)
    assert task.phases == [(0, 1), (1, 2), (2, 5)] and task.end is None and not task.transit
    assert task.tool_speed(0) == np.inf and task.tool_speed(2) == fpi.source.task.brush_speed
    elsewhere = make_task(fpi, "right_1", poses, np.asarray(fpi.home) + 0.1)
    assert elsewhere.transit and elsewhere.phases == [(0, 1), (1, 2), (2, 3), (3, 6)]
    np.testing.assert_array_equal(elsewhere.key_poses[1:], task.key_poses)
    np.testing.assert_array_equal(elsewhere.shown[0], task.key_poses)
    np.testing.assert_array_equal(make_task(fpi, "right_1", poses).key_poses, task.key_poses)
    one, other = random_task(fpi, 7), random_task(fpi, 8)
    assert one.object_name != other.object_name and np.abs(one.start - fpi.home).max() > 0.01
    with pytest.raises(UnknownNameError, match="left_0"):
        make_task(fpi, "left_9", poses)


def test_trials_are_carried_out_exactly_and_without_a_touch(fpi, reports):
    for report in reports:
        assert report.succeeded(0.001, np.radians(0.5)), (report.cause, report.detail, report.away)
        assert not report.touches and len(report.away) == 4
        assert np.degrees(np.sqrt(np.mean(report.brush_angles**2))) < 2.0
        assert np.abs(report.stand_offs).max() < 0.01


@pytest.fixture(scope="module")
def brushing(fpi, inspector):
    """A task from elsewhere than home, and its plan."""
    start = random_start(fpi, np.random.default_rng(0))
    task = make_task(fpi, "left_2", sample_scene(fpi, 3), start)
    plan = plan_batch(inspector, [task], key=jax.random.key(0))[0]
    assert plan.status is Status.OK, plan.detail
    return task, plan


def test_the_controllers_program_does_what_was_planned(fpi, brushing):
    """Read back: even moves in the times that it says, at rest where the plan rests."""
    task, plan = brushing
    out = to_joint_trajectory(fpi, task, plan)
    program = read_tp_program(to_tp_program(fpi, out, "blade"))
    q = np.radians(program.positions)
    q[:, 2] += q[:, 1]
    times = np.cumsum([0.0] + [move.speed for move in program.moves[1:]])
    at = np.array([point["time_from_start"] for point in out["points"]])
    wanted = np.array([point["positions"] for point in out["points"]])
    fastest = max(np.abs(phase.velocities).max() for phase in plan.phases)
    found = np.stack([np.interp(at, times, column) for column in q.T], axis=1)
    assert np.abs(found - wanted).max() < TOLERANCE + 1e-3 * fastest
    assert sum(move.fine for move in program.moves) == len(plan.phases) + 1


def test_the_brush_keeps_to_its_speed(fpi, brushing):
    """Judged by C MuJoCo's kinematics and differences of the timed points."""
    task, plan = brushing
    data, site, stroke = mujoco.MjData(fpi.model), fpi.source.layout.tool_site, plan.phases[-1]
    tool = []
    for q in stroke.positions:
        data.qpos[:6] = q
        mujoco.mj_kinematics(fpi.model, data)
        tool.append(data.site_xpos[site].copy())
    speed = np.linalg.norm(np.diff(tool, axis=0), axis=1) / np.diff(stroke.times)
    assert 0.09 < speed.max() <= 0.1005
    out = to_joint_trajectory(fpi, task, plan)
    times = np.array([point["time_from_start"] for point in out["points"]])
    assert out["gripper"] == [] and (np.diff(times) > 0).all()
    assert out["parts"][-1]["last"] == len(times) - 1


def test_a_brush_that_is_pressed_into_the_part_is_a_collision(fpi, reports):
    """The planner's motion, lowered by turning the shoulder, must be told by the sensors."""
    trial = Trial("left_2", 3)
    start = random_start(fpi, np.random.default_rng([trial.seed, 2]))

    def plan(tasks):
        path = np.linspace(start, start + [0.9, 0.9, 0, 0, 0, 0], 50)
        times = np.linspace(0, 2, 50)
        rest = np.zeros_like(path)
        phase = Trajectory(times, path, np.gradient(path, times, axis=0), rest, np.zeros(50, int))
        return [PlanResult(Status.OK, "", [phase] * 4) for _ in tasks]

    report = inspect_parts(fpi, plan, [trial])[0]
    assert report.touches and report.cause == "collision"
    assert not report.succeeded(10.0, 10.0)


def test_measured_poses_show_in_the_errors(fpi, inspector):
    """A part that lies 5 mm aside of where it was seen is brushed 5 mm aside."""
    plan = planning(functools.partial(plan_batch, inspector), 0)
    off = inspect_parts(fpi, plan, [Trial("left_2", 3)], Disturbance(position=0.005))[0]
    assert off.cause == "" and 0.0015 < max(off.away[1:]) < 0.03
    assert off.succeeded(0.05, np.radians(5)) and not off.succeeded(0.001, np.radians(0.5))


def test_the_study_adds_up(tmp_path):
    def report(seed, away, cause="", touches=()):
        return InspectionReport(
            Trial(f"p{seed % 2}", seed),
            cause,
            "",
            [0.0, away, 0.0],
            [0.0] * 3,
            np.full(10, np.radians(1.0)),
            np.full(10, 1e-3),
            list(touches),
            seconds=5.0,
        )

    touch = Touch(1.0, "arm", "tray")
    some = [
        report(0, 0.0005),
        report(1, 0.005),
        report(2, 0.02),
        report(3, 0.0, "collision", [touch]),
        InspectionReport(Trial("p0", 4)),
    ]
    rows = [study.row_of("hybrid", one) for one in some]
    found = {m["key"]: m for m in study.summarize(rows, {"hybrid": 10.0})}
    assert found["inspection.success_5cm_5deg"]["value"] == 3 / 5
    assert found["inspection.success_1cm_2deg"]["value"] == 2 / 5
    assert found["inspection.success_1mm_05deg"]["value"] == 1 / 5
    assert "no plan 1" in found["inspection.success_5cm_5deg"]["note"]
    assert found["inspection.collisions"]["value"] == 1
    assert found["inspection.brush_angle_rms"]["value"] == pytest.approx(1.0)
    assert found["inspection.stand_off_rms"]["value"] == pytest.approx(1.0)

    tilted = [row | {"brush_angle_rms_deg": 3.0} if row["part"] == "p1" else row for row in rows]
    found = {m["key"]: m for m in study.summarize(tilted, {"hybrid": 10.0})}
    assert found["inspection.brush_angle_best_part"]["value"] == pytest.approx(1.0)
    assert found["inspection.brush_angle_worst_part"]["value"] == pytest.approx(3.0)
    assert "of p1;" in found["inspection.brush_angle_worst_part"]["note"]

    assert steady_from([1, 2, 3, 4, 5], [0.0, 9.0, 10.2, 9.9, 10.0], 0.05) == 3
    assert steady_from([1, 2], [1.0, 1.0], 0.05) == 1

    class Blank:
        def metrics(self, stage):
            return [{"step": 1, "cost_over_optimum": 1.0, "success": 0.5, "episodes": 3.0}]

    class Trained:
        preset = DEFAULT

        def metrics(self, stage):
            return {
                "map": [{"step": 1000, "feasible": 0.25}],
                "lfd": [{"step": 7, "cost_over_optimum": 1.0}] * 6,
            }.get(stage, [{"step": 1, "return": 2.0, "success": 0.5, "episodes": 3.0}] * 6)

    found = {m["key"]: m["value"] for m in study.learning(Trained())}
    assert found["inspection.map_feasible"] == 0.25
    assert found["inspection.lfd_steady_episodes"] == 7
    assert found["inspection.drl_steady_episodes"] == 15
    assert found["inspection.drl_training_success"] == 0.5
    Trained.preset = PAPER
    paper = {m["key"]: m["value"] for m in study.learning(Trained())}
    assert paper["inspection.paper_map_feasible"] == 0.25 and not paper.keys() & found.keys()

    draw_study(tmp_path / "study.png", rows, Blank())
    assert (tmp_path / "study.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("old", "new", "kind", "message"),
    [
        ('kind = "inspection"', 'kind = "painting"', UnknownNameError, "handling, inspection"),
        ('face = "left_hand"', 'face = "flat"', UnknownNameError, "left_hand"),
        ("brush_speed = 0.10\n", "", WorkcellError, "brush_speed"),
        ('tray = "tray"', 'tray = "box"', UnknownNameError, "tray"),
    ],
)
def test_mistakes_in_the_task_data_are_named(fpi, tmp_path, old, new, kind, message):
    text = fpi.source.path.with_suffix(".toml").read_text()
    assert old in text
    robots = str(fpi.source.path.parent.parent)
    model = fpi.source.path.read_text().replace('file="../', f'file="{robots}/')
    (tmp_path / "cell.xml").write_text(model)
    (tmp_path / "cell.toml").write_text(text.replace(old, new))
    with pytest.raises(kind, match=message):
        load_workcell(tmp_path / "cell.xml")


def test_steadiness_is_told_in_episodes_and_in_computing_time():
    """Ten updates of 100 steps at 50 steps/s; the curve is flat from the third on."""

    class Trained:
        def metrics(self, stage):
            values = [0.0, 5.0] + [10.0] * 8 if stage == "drl" else [1.0]
            return [
                {"step": 100 * (i + 1), "episodes": 4, "rate": 50.0, "return": value}
                for i, value in enumerate(values)
            ]

    metrics = Metrics("some")
    curves = {"drl": ("drl", "return", "return"), "switch": ("switch", "return", "return")}
    add_steadiness(metrics, Trained(), curves)  # pyright: ignore[reportArgumentType]
    found = {row["key"]: row["value"] for row in metrics.rows}
    # the first mean of five that holds no early value ends with the seventh update
    assert found == {"some.drl_steady_episodes": 28.0, "some.drl_steady_seconds": 14.0}
