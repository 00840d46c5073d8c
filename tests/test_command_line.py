# SPDX-License-Identifier: MIT
"""The commands as a user calls them: errors are sentences, runs can be resumed and opened."""

import itertools
import json
import shutil
import subprocess
import sys

import pytest

from hybrid_jax import evaluate, plan, train
from hybrid_jax.errors import RunFolderError, UnknownNameError
from hybrid_jax.runs.run_folder import create_run, open_run
from hybrid_jax.runs.seeds import HANDLING_STUDY
from hybrid_jax.tasks.scene_sampling import sample_scene
from hybrid_jax.workcell.load import load_workcell


@pytest.fixture(scope="module")
def run_folder(smoke_run, tmp_path_factory):
    """A complete run of the smoke preset, to be changed."""
    return shutil.copytree(smoke_run, tmp_path_factory.mktemp("copy") / "smoke")


def test_a_run_leaves_what_it_promises(run_folder):
    names = {path.name for path in run_folder.iterdir()}
    assert {
        "config.json",
        "map.npz",
        "map.png",
        "lfd.npz",
        "lfd.png",
        "lfd.jsonl",
        "drl.npz",
    } <= names
    assert {
        "drl.png",
        "drl.jsonl",
        "switch.npz",
        "switch.png",
        "showcase.json",
        "segments.npz",
    } <= names
    assert not any(name.endswith(("checkpoint.npz", ".partial.npz")) for name in names)


def test_resume_does_only_what_is_missing(run_folder, capsys):
    (run_folder / "lfd.npz").unlink()
    before = (run_folder / "drl.npz").stat().st_mtime_ns
    assert train.main(out=run_folder, resume=True, quiet=True) == 0
    text = capsys.readouterr().out
    assert "\nlfd " in text and "\nmap " not in text
    assert (run_folder / "drl.npz").stat().st_mtime_ns == before


def test_plan_writes_a_trajectory_and_ends_with_0(run_folder, tmp_path):
    (tmp_path / "task.json").write_text('{"object": "block_1", "scene_seed": 3}')
    assert plan.main(run=run_folder, task=tmp_path / "task.json", out=tmp_path / "out.json") == 0
    out = json.loads((tmp_path / "out.json").read_text())
    assert out["status"] == "OK" and len(out["points"]) > 100
    times = [point["time_from_start"] for point in out["points"]]
    assert times[0] == 0 and all(a < b for a, b in itertools.pairwise(times))


def test_plan_writes_why_there_is_none_and_ends_with_1(run_folder, tmp_path):
    """A block that lies out of the arm's reach."""
    cell = load_workcell("gen3_handling")
    poses = sample_scene(cell, 3)
    poses[cell.source.layout.object_names.index("block_1"), :2] = 2.5, 2.5
    values = {"object": "block_1", "object_poses": poses.tolist()}
    (tmp_path / "task.json").write_text(json.dumps(values))
    assert plan.main(run=run_folder, task=tmp_path / "task.json", out=tmp_path / "out.json") == 1
    out = json.loads((tmp_path / "out.json").read_text())
    assert out["status"] != "OK" and out["detail"] and not out["points"]


def test_evaluate_writes_runs_metrics_and_a_chart(run_folder, tmp_path):
    path, figures = tmp_path / "study.json", tmp_path / "figures.json"
    methods = ("lfd", "drl")
    assert evaluate.main(run_folder, path, runs=1, methods=methods, figures=figures) == 0
    backed = json.loads(figures.read_text())
    assert backed["metrics"] == json.loads(path.read_text())["metrics"] and backed["versions"]
    assert backed["seeds"] == {"scenes": [HANDLING_STUDY.start, HANDLING_STUDY.start + 1]}
    out = json.loads(path.read_text())
    assert [row["method"] for row in out["runs"]] == ["lfd", "drl"]
    assert {"key", "value", "unit", "better", "device", "note"} == set(out["metrics"][0])
    assert path.with_suffix(".png").is_file() and (run_folder / "alone.npz").is_file()


def test_damaged_and_incomplete_runs_are_refused(run_folder, tmp_path):
    with pytest.raises(RunFolderError, match="config.json is missing"):
        open_run(tmp_path)
    config = json.loads((run_folder / "config.json").read_text())
    (tmp_path / "config.json").write_text(json.dumps(config | {"digest": "0" * 64}))
    with pytest.raises(RunFolderError, match="another version of cell"):
        open_run(tmp_path)
    (tmp_path / "config.json").write_text(json.dumps(config))
    from hybrid_jax.runs.load_planner import load_planner

    with pytest.raises(RunFolderError, match="map.npz is missing"):
        load_planner(open_run(tmp_path))


def test_a_second_run_does_not_overwrite_the_first(run_folder):
    with pytest.raises(RunFolderError, match="already holds a run"):
        train.main(preset="smoke", out=run_folder)


def test_unknown_names_list_the_known_ones():
    with pytest.raises(UnknownNameError, match="map"):
        train.main(("mop",))
    with pytest.raises(UnknownNameError, match="smoke"):
        train.main(preset="huge")


def test_errors_are_one_sentence_on_the_terminal():
    done = subprocess.run(
        [sys.executable, "-m", "hybrid_jax.train", "--workcell", "nowhere"],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 2 and "Traceback" not in done.stderr
    assert "gen3_handling" in done.stderr


def test_interrupt_keeps_a_checkpoint_that_resume_takes(tmp_path, monkeypatch, capsys):
    """Ctrl-C in the middle of the joint agent's training."""
    from hybrid_jax.agents import networks, training
    from hybrid_jax.runs import checkpoints

    folder = tmp_path / "run"
    run = create_run("gen3_handling", "smoke", 0, folder)
    real, seen = training.train, []

    def interrupted(*args, report, **kwargs):
        def stop(steps, state, metrics):
            report(steps, state, metrics)
            seen.append(steps)
            if len(seen) == 2:
                raise KeyboardInterrupt

        return real(*args, report=stop, **kwargs)

    monkeypatch.setattr(training, "train", interrupted)
    toy = pytest.importorskip("test_agents")
    net = networks.make_networks(1, 1, toy.SMALL.hidden, False)
    with pytest.raises(KeyboardInterrupt):
        checkpoints.train_agent(run, "drl", toy.Track(), net, toy.SMALL, True)
    assert (folder / "drl_checkpoint.npz").is_file()
    monkeypatch.setattr(training, "train", real)
    state = checkpoints.train_agent(run, "drl", toy.Track(), net, toy.SMALL, True)
    assert int(state.learner.iteration[0]) == toy.SMALL.iterations
    again = checkpoints.train_agent(run, "drl", toy.Track(), net, toy.SMALL, True)
    assert int(again.learner.iteration[0]) == toy.SMALL.iterations, "a finished one is not redone"
    steps = [row["step"] for row in run.metrics("drl")]
    assert steps == sorted(set(steps)) and len(steps) == toy.SMALL.iterations
