# SPDX-License-Identifier: MIT
"""The study: disturbances, what runs add up to, and the film."""

import functools
import importlib
from dataclasses import replace

import jax
import mujoco
import numpy as np
import pytest

from hybrid_jax import evaluate
from hybrid_jax.baselines.ablations import ABLATIONS, ablated, straight_bridger
from hybrid_jax.errors import InputError, RunFolderError, UnknownNameError
from hybrid_jax.execution.contact_sensors import sense_cell
from hybrid_jax.execution.disturbances import CALM, DISTURBED, disturbed_model, measured, push
from hybrid_jax.execution.handling import SortingReport, sort_scenes
from hybrid_jax.execution.plant import Plant
from hybrid_jax.execution.scheduler import planning
from hybrid_jax.execution.sorting import ObjectReport, in_tray
from hybrid_jax.reports import film
from hybrid_jax.runs import run_folder
from hybrid_jax.runs.presets import PRESETS
from hybrid_jax.runs.run_folder import Run
from hybrid_jax.studies import handling as study
from hybrid_jax.studies import handling_pictures, inspection, methods, single_tasks
from hybrid_jax.tasks.scene_sampling import sample_scene
from hybrid_jax.tasks.task import yaw_of
from hybrid_jax.types import Source, Status
from hybrid_jax.workcell.description import TASK_KINDS, kind_module
from hybrid_jax.workcell.layout import home_qpos
from hybrid_jax.workcell.load import load_workcell


def run_of(seed: int, causes: list[str]) -> SortingReport:
    reports = [
        ObjectReport(f"o{i}", not c, not c, c, tries=1, asked=1) for i, c in enumerate(causes)
    ]
    return SortingReport(seed, reports, [], np.zeros((3, 45), np.float32), 60.0)


def test_measured_poses_scatter_as_stated_and_stay_upright(cell):
    poses = sample_scene(cell, 0)
    rng = np.random.default_rng(0)
    seen = np.array([measured(poses, DISTURBED, rng) for _ in range(2000)])
    away = seen[:, :, :3] - poses[:, :3]
    np.testing.assert_allclose(away[..., :2].std(axis=0), DISTURBED.position, rtol=0.1)
    assert np.abs(away[..., 2]).max() == 0.0
    turns = np.array([[yaw_of(p) for p in row] for row in seen[:500]])
    turns -= [yaw_of(p) for p in poses]
    np.testing.assert_allclose(turns.std(axis=0), DISTURBED.yaw, rtol=0.15)
    np.testing.assert_allclose(measured(poses, CALM, rng), poses, atol=1e-7)


def test_the_disturbed_model_is_heavier_and_slides_more(cell):
    sensed = sense_cell(cell)
    model = disturbed_model(sensed.model, cell, DISTURBED)
    hammer = model.body("hammer").id
    assert model.body_mass[hammer] == pytest.approx(1.5 * sensed.model.body_mass[hammer])
    assert model.body("bracelet_link").mass == sensed.model.body("bracelet_link").mass
    np.testing.assert_allclose(model.geom_friction, 0.7 * sensed.model.geom_friction)
    assert disturbed_model(sensed.model, cell, CALM) is sensed.model


def test_a_push_moves_an_object_to_a_free_place(cell):
    sensed, scene = sense_cell(cell), sample_scene(cell, 1)
    for seed in range(5):
        plant = Plant(sensed, scene, 25)
        assert push(plant, 1, 0.03, np.random.default_rng(seed))
        address = 1 + plant.layout.object_qpos[1]
        assert np.linalg.norm(plant.state[address : address + 2] - scene[1, :2]) == pytest.approx(
            0.03, abs=1e-6
        )
        plant.data.qpos[:] = plant.state[1 : 1 + plant.model.nq]
        mujoco.mj_forward(plant.model, plant.data)
        touching = sensed.touching(plant.data.sensordata)
        assert touching[3, :5].sum() == 0, "no other object"


def test_runs_add_up_with_their_intervals_and_causes():
    runs = [run_of(i, ["", ""]) for i in range(9)] + [run_of(9, ["", "missed grasp"])]
    rows = [study.row_of("hybrid", run) for run in runs]
    metrics = {m["key"]: m for m in study.summarize(rows, {"hybrid": 20.0})}
    success = metrics["handling.hybrid_success"]
    assert success["value"] == 0.9 and "missed grasp 1" in success["note"]
    # Wilson's interval of 9 of 10, by its formula
    z, p, n = 1.959964, 0.9, 10
    middle = (p + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z * np.sqrt(p * (1 - p) / n + z**2 / (4 * n**2)) / (1 + z**2 / n)
    assert f"from {middle - half:.3f} to {middle + half:.3f}" in success["note"]
    assert metrics["handling.hybrid_object_success"]["value"] == 19 / 20
    assert metrics["handling.hybrid_first_try"]["value"] == 0.9
    assert metrics["handling.seconds_100"]["value"] == 200.0
    assert metrics["handling.hybrid_cycle_time"]["value"] == 60.0


def test_a_contact_spoils_a_run_in_which_everything_was_placed():
    from hybrid_jax.execution.plant import Touch

    run = replace(run_of(0, ["", ""]), touches=[Touch(1.0, "arm", "table")])
    assert not run.success
    row = study.row_of("hybrid", run)
    assert row["cause"] == "collision" and row["touches"] == ["arm touched table at 1.00 s"]


def test_the_chart_is_drawn(tmp_path):
    rows = [study.row_of(m, run_of(0, [c, ""])) for m, c in (("hybrid", ""), ("lfd", "no plan"))]
    handling_pictures.draw_study(tmp_path / "study.png", rows)
    assert (tmp_path / "study.png").stat().st_size > 10_000


def test_films_stand_side_by_side_until_the_longer_ends():
    short, long = ([np.full((40, 60, 3), v, np.uint8) for v in range(n)] for n in (2, 5))
    frames = film.side_by_side({"a": short, "b": long})
    assert len(frames) == 5 and frames[0].shape == (40, 120, 3)
    assert frames[-1][30, 50, 0] == 1 and frames[-1][30, 110, 0] == 4


def test_scenes_side_by_side_are_as_one_by_one(cell, planner):
    """What becomes of a run does not depend on the runs beside it."""

    def plan(tasks):
        from hybrid_jax.planner.pipeline import plan_motion

        return [plan_motion(planner, task, key=jax.random.key(0)) for task in tasks]

    both = sort_scenes(cell, plan, [1, 2], ["block_2"])
    alone = sort_scenes(cell, plan, [2], ["block_2"])[0]
    assert both[1].success and both[0].success
    np.testing.assert_allclose(both[1].frames, alone.frames, atol=1e-6)


def test_ompl_plans_tasks_as_our_planner_does(cell, planner, planned):
    from hybrid_jax.baselines.ompl_tasks import OmplTasks

    tasks = OmplTasks(planner.cell, planner.config, 0.002)
    tasks.way_points(planned[0], jax.random.key(0))  # compiling counts as its time
    result = tasks.plan(planned[0], jax.random.key(0))
    assert result.status is Status.OK and len(result.phases) == 3
    assert result.shares[Source.RRT] == 1.0
    np.testing.assert_allclose(result.phases[0].positions[0], cell.home, atol=1e-5)
    np.testing.assert_allclose(result.phases[2].positions[-1], cell.home, atol=1e-3)


def test_a_second_try_is_no_first_one():
    run = run_of(0, ["", ""])
    run.reports[0].tries = run.reports[0].asked = 2
    rows = [study.row_of("hybrid", run), study.row_of("hybrid", run_of(1, ["", ""]))]
    metrics = {m["key"]: m["value"] for m in study.summarize(rows, {"hybrid": 1.0})}
    assert metrics["handling.hybrid_success"] == 1.0
    assert metrics["handling.hybrid_first_try"] == 0.5
    assert metrics["handling.hybrid_object_first_try"] == 0.75


def test_plans_that_came_to_nothing_count_in_their_mean_time():
    run = run_of(0, [""])
    run.reports[0].asked, run.reports[0].tries, run.reports[0].planning_s = 3, 0, 0.6
    metrics = study.summarize([study.row_of("lfd", run)], {"lfd": 1.0})
    each = next(m["value"] for m in metrics if m["key"] == "handling.lfd_planning_time")
    np.testing.assert_allclose(each, 0.2)


def test_what_stands_out_over_the_rim_does_not_lie_in_its_tray(cell):
    """Its middle is inside; and one that hovers over the floor does not lie on it."""
    sensed, index = sense_cell(cell), cell.source.layout.object_names.index("hammer")
    task = cell.source.task
    tray, spec = task.tray(task.object("hammer").tray), task.object("hammer")
    middle = cell.model.body(tray.name).pos
    height = home_qpos(cell.model)[cell.source.layout.object_qpos[index] + 2] + tray.floor
    for shift, up, lies in (
        (0.0, 0.0, True),
        (tray.half_size[0] - 0.01, 0.0, False),
        (0.0, 0.03, False),
    ):
        poses = sample_scene(cell, 0)
        poses[index] = [
            middle[0] + spec.slot[0] * (not shift) + shift,
            middle[1] + spec.slot[1],
            middle[2] + height + up,
            1,
            0,
            0,
            0,
        ]
        plant = Plant(sensed, poses, 25)
        mujoco.mj_kinematics(plant.model, plant.data)
        assert in_tray(plant, "hammer") == lies, (shift, up)


def test_skills_alone_are_executed_and_their_collisions_counted(cell, planner):
    from hybrid_jax.baselines.unchecked import follow_skills
    from hybrid_jax.execution.plan_execution import ExecutionConfig

    plan = planning(functools.partial(follow_skills, planner), 0)
    (report,) = sort_scenes(cell, plan, [3], ["block_2"], config=ExecutionConfig(tries=1))
    assert not report.success and report.reports[0].tries == 1
    assert any(touch.mover == "arm" and touch.thing == "enclosure" for touch in report.touches)


@pytest.mark.parametrize("name", ABLATIONS)
def test_each_ablation_replaces_one_part_only(cell, planner, name):
    found = ablated(name, planner, PRESETS["smoke"], lambda: "chooser")
    parts = {
        "rrt": "bridge",
        "untrained": "bridge",
        "straight": "bridge",
        "rule": "switch",
        "optimal_switch": "switch",
        "dqn": "choose",
    }
    for part in ("bridge", "switch", "choose", "library", "scale", "config"):
        same = getattr(found, part) is getattr(planner, part)
        assert same == (part != parts[name])
    assert f"ablation_{name}" in study.METHODS


def test_the_straight_line_bridges_where_it_is_free(cell, planner):
    from hybrid_jax.contracts import Segments

    scenes = jax.tree.map(lambda a: np.stack([a, a]), cell.scene)
    home = np.asarray(cell.home)
    through_itself = home + np.array([0, 0, 0, -4.0, 0, 0, 0], np.float32)
    goals = np.stack([home + np.float32(0.01), through_itself])
    ways = straight_bridger(cell)(Segments(scenes, np.stack([home, home]), goals), None)
    assert ways[0] is not None and len(ways[0]) == 2 and ways[1] is None


def test_a_study_states_the_seeds_that_it_draws(cell):
    fpi = load_workcell("fpi")
    assert study.drawn(cell, 7, 3) == range(7, 10)
    first, parts = inspection.SEEDS.start, len(fpi.source.task.parts)
    assert inspection.drawn(fpi, first, 2) == range(first, first + 2 * parts)
    assert inspection.drawn(fpi, first + 1, 1) == range(first + parts, first + 2 * parts)
    with pytest.raises(InputError, match="ask for fewer runs"):
        inspection.drawn(fpi, first, 10_001)


def test_an_ablation_that_is_none_is_refused(planner):
    with pytest.raises(UnknownNameError, match="dqn"):
        ablated("dqm", planner, PRESETS["smoke"], lambda: None)


def test_a_study_without_methods_is_refused(cell, tmp_path, monkeypatch):
    monkeypatch.setattr(methods, "make_method", lambda *_: None)
    monkeypatch.setattr(run_folder, "open_run", lambda _: Run(tmp_path, cell, "smoke", 0))
    with pytest.raises(InputError, match="nothing is left to compare: ompl"):
        evaluate.main(tmp_path, tmp_path / "a.json", methods=("ompl",))


def test_every_method_of_the_command_exists():
    modules = [importlib.import_module(kind_module(kind).STUDY) for kind in TASK_KINDS]
    for one in (*modules, single_tasks):
        assert set(one.METHODS) <= set(methods.METHODS)


def test_what_the_study_cannot_do_is_said(cell, tmp_path):
    with pytest.raises(InputError, match="--out FILE.json"):
        evaluate.main(tmp_path)
    with pytest.raises(InputError, match="at least 1"):
        evaluate.main(tmp_path, tmp_path / "out.json", runs=0)
    with pytest.raises(RunFolderError, match="config.json is missing"):
        evaluate.main(tmp_path, tmp_path / "out.json")
    run = Run(tmp_path, cell, "smoke", 0)
    with pytest.raises(UnknownNameError, match="hybrid"):
        methods.make_method("hybird", run, None)


def test_a_run_of_another_cell_is_refused(cell, tmp_path):
    from hybrid_jax.workcell.load import load_workcell

    text = (cell.source.path).read_text().replace('pos=".26 .56 0"', 'pos=".28 .56 0"')
    folder = tmp_path / "workcells"
    folder.mkdir()
    robots = str(cell.source.path.parent.parent)
    (folder / "other.xml").write_text(text.replace('file="../', f'file="{robots}/'))
    (folder / "other.toml").write_text(cell.source.path.with_suffix(".toml").read_text())
    other = load_workcell(folder / "other.xml")
    with pytest.raises(RunFolderError, match="was trained for cell 'other'"):
        methods.make_method(
            "paper", Run(tmp_path / "a", cell, "smoke", 0), Run(tmp_path / "b", other, "paper", 0)
        )


@pytest.mark.parametrize("name", ["lfd", "drl", "ablation_rrt"])
def test_a_run_of_preset_paper_is_not_measured_by_methods_that_change_nothing_in_it(
    tmp_path, cell, name
):
    paper = Run(tmp_path, cell, "paper", 0)
    with pytest.raises(InputError, match="paper_lfd"):
        methods.make_method(name, paper, None)
