# SPDX-License-Identifier: MIT
"""A kind of task that the package does not know: one module, and one line that names it."""

import ast
import itertools
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest
import toy_kind

import hybrid_jax
from hybrid_jax.errors import UnknownNameError, WorkcellError
from hybrid_jax.execution.single_tasks import execute, execution_of
from hybrid_jax.planner.pipeline import plan_batch, plan_motion
from hybrid_jax.runs.load_planner import untrained_planner
from hybrid_jax.runs.run_folder import Run
from hybrid_jax.studies import single_tasks
from hybrid_jax.studies.methods import Method
from hybrid_jax.studies.registry import Study, study_of
from hybrid_jax.tasks.registry import kind_of, make_task, random_task
from hybrid_jax.tasks.scene_sampling import sample_scene
from hybrid_jax.types import Status
from hybrid_jax.workcell.description import TASK_KINDS
from hybrid_jax.workcell.load import load_workcell

PACKAGE = Path(hybrid_jax.__file__).parent
SHIPPED = "gen3_handling", "fpi"
DATA = """
kind = "lifting"
tool_site = "tool"
table = "table"
height = 0.12
gripper = { joints = ["slide_l", "slide_r"], actuator = "grip", open = 0.0425, squeeze = -0.02 }
objects = [
  { name = "block_1", grip = 0.025, spawn = [0.49, -0.07, 0.0], jitter = [0.02, 0.02, 0.3] },
  { name = "block_2", grip = 0.02, spawn = [0.49, -0.20, 0.0], jitter = [0.02, 0.02, 0.3] },
]
"""


@pytest.fixture(scope="module")
def lifting(cell, tmp_path_factory):
    """The handling cell's robot and objects, with data of the toy kind."""
    folder = tmp_path_factory.mktemp("lifting")
    robots = str(cell.source.path.parent.parent)
    text = cell.source.path.read_text().replace('file="../', f'file="{robots}/')
    (folder / "lifting.xml").write_text(text)
    (folder / "lifting.toml").write_text(DATA)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(TASK_KINDS, "lifting", "toy_kind")
        yield load_workcell(folder / "lifting.xml")


@pytest.fixture(scope="module")
def lifter(lifting):
    """A planner of the toy's cell."""
    return untrained_planner(lifting, 0.1)


def test_its_task_is_planned_carried_out_and_judged(lifting, lifter):
    task = make_task(lifting, "block_1", sample_scene(lifting, 1))
    plan = plan_motion(lifter, task, key=jax.random.key(0))
    assert plan.status is Status.OK, plan.detail
    report = execute(lifting, task, plan)
    assert report.success and report.judgement.measures["moved_mm"] < 5, report.judgement
    heights = report.frames[:, lifting.source.layout.object_qpos[0] + 2]
    assert heights.max() > heights[0] + 0.1, "it was lifted"


def test_what_carries_nothing_is_carried_out_too(lifting, lifter):
    """The object goes on lying where it lies, between open fingers."""
    task = make_task(lifting, "block_1", sample_scene(lifting, 1))
    task = replace(task, carrying=(False,) * 3, hold=None, stops=(1, 2))
    direct = replace(lifter, config=replace(lifter.config, direct=True))
    plan = plan_motion(direct, task, key=jax.random.key(0))
    assert plan.status is Status.OK, plan.detail
    report = execute(lifting, task, plan)
    assert report.success, (report.judgement, report.touches)


@pytest.mark.parametrize(
    "change, words",
    [
        ({"hold": None}, "give it a `hold`"),
        ({"in_tool": np.full(7, np.nan)}, "7 finite numbers"),
        ({"support": ("tabel",)}, "hold.support names 'tabel'"),
    ],
)
def test_a_hold_that_is_wrong_is_named(lifting, lifter, change, words):
    task = make_task(lifting, "block_1", sample_scene(lifting, 1))
    hold = None if "hold" in change else replace(task.hold, **change)
    plan = plan_motion(lifter, replace(task, hold=hold), key=jax.random.key(0))
    assert plan.status is Status.INVALID_TASK and words in plan.detail


def test_its_study_compares_methods(lifting, lifter, tmp_path):
    study = study_of(lifting)
    assert study is single_tasks
    reports, seconds = study.run_method(lifting, Method("hybrid", lifter, plan_batch), [0, 1], True)
    rows = [study.row_of("hybrid", report) for report in reports]
    metrics = {row["key"]: row["value"] for row in study.summarize(rows, {"hybrid": seconds})}
    assert metrics["tasks.hybrid_success"] == np.mean([study.succeeded(r) for r in reports])
    assert metrics["tasks.hybrid_success"] > 0 and metrics["tasks.hybrid_moved_mm"] < 5
    study.draw(tmp_path / "study.png", rows, Run(tmp_path, lifting, "smoke", 0))
    assert (tmp_path / "study.png").stat().st_size > 5_000


def test_its_showcase_says_what_became_of_each_task(lifting):
    def refuse(tasks):
        return [hybrid_jax.PlanResult(Status.NEED_DEMO, "nothing was shown") for _ in tasks]

    showcase = execution_of(lifting).show(lifting, refuse, 0, 2)
    assert [row["cause"] for row in showcase.rows] == ["no plan"] * 2
    assert showcase.frames.shape == (0, lifting.model.nq) and showcase.touched == 0


def test_what_its_reader_refuses_is_said(lifting, tmp_path):
    text = lifting.source.path.read_text()
    (tmp_path / "bad.xml").write_text(text)
    (tmp_path / "bad.toml").write_text(DATA.replace("height = 0.12", 'height = "high"'))
    with pytest.raises(WorkcellError, match="height is 'high'"):
        load_workcell(tmp_path / "bad.xml")
    (tmp_path / "bad.toml").write_text(DATA.replace('"lifting"', '"liftin"'))
    with pytest.raises(UnknownNameError, match="'liftin'.*lifting"):
        load_workcell(tmp_path / "bad.xml")


def test_every_kind_is_that_of_a_shipped_cell(monkeypatch):
    monkeypatch.delitem(TASK_KINDS, "lifting", raising=False)  # the toy, while its cell is in use
    assert {load_workcell(name).source.task.kind for name in SHIPPED} == set(TASK_KINDS)


@pytest.mark.parametrize("name", SHIPPED)
def test_every_kind_has_what_the_contract_asks_for(name):
    own = load_workcell(name)
    kind, module = own.source.task.kind, kind_of(own)
    assert module.__name__ == TASK_KINDS[kind]
    for name in ("read", "make_task", "random_task", "EXECUTION", "STUDY"):
        assert hasattr(module, name), name
    assert all(callable(getattr(execution_of(own), name)) for name in ("judge", "show"))
    members = [name for name in {**vars(Study), **Study.__annotations__} if name[0] != "_"]
    assert {"SEEDS", "METHODS", "draw"} <= set(members)
    assert all(hasattr(study_of(own), name) for name in members)
    assert random_task(own, 3).object_name in own.source.layout.object_names


def test_the_planner_knows_no_kind_of_task():
    """Nor does any other part but those that carry out, show or compare one kind."""
    knowing = {"execution", "studies", "demonstrations", "tasks"}
    for path in PACKAGE.rglob("*.py"):
        if path.relative_to(PACKAGE).parts[0] in knowing:
            continue
        nodes = [n for n in ast.walk(ast.parse(path.read_text())) if isinstance(n, ast.ImportFrom)]
        imported = itertools.chain.from_iterable(
            (n.module, *(f"{n.module}.{a.name}" for a in n.names)) for n in nodes
        )
        assert not {*TASK_KINDS.values()} & {*imported}, path


def test_the_toy_is_short_and_the_document_quotes_it():
    toy = Path(toy_kind.__file__).read_text()
    assert toy.count("\n") < 80
    document = PACKAGE.parent / "docs" / "adding_a_task.md"
    blocks = document.read_text().split("```py\n")[1:]
    assert blocks, "the document shows no code"
    for block in blocks:
        assert block.partition("```")[0].strip() in toy
