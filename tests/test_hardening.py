# SPDX-License-Identifier: MIT
"""Full disks, folders that cannot be written, processes that are killed; nothing is executed."""

import ast
import json
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import hybrid_jax
from hybrid_jax import plan, train
from hybrid_jax.demonstrations.demonstration import load_demonstrations
from hybrid_jax.errors import RunFolderError
from hybrid_jax.runs.load_planner import load_planner
from hybrid_jax.runs.run_folder import Run, open_run
from hybrid_jax.runtime import artifacts
from hybrid_jax.workcell.assets import demonstrations_folder

PACKAGE = Path(hybrid_jax.__file__).parent
FORBIDDEN_CALLS = {"eval", "exec", "compile", "__import__"}
FORBIDDEN_MODULES = {
    "pickle",
    "marshal",
    "shelve",
    "dill",
    "cloudpickle",
    "joblib",
    "requests",
    "urllib.request",
    "http.client",
    "socket",
    "ftplib",
    "yaml",
}
ASKED_FOR = {"web/listening.py": {"socket"}, "serve/client.py": {"urllib.request"}}
"""A server listens where its user says, and `plan --server` asks the one that its user names."""
LITTLE_DISK = """
import resource, runpy, sys
resource.setrlimit(resource.RLIMIT_FSIZE, ({bytes}, {bytes}))
sys.argv = {argv!r}
runpy.run_module({module!r}, run_name="__main__")
"""
"""Files cannot grow beyond a size: to the process it looks like a full disk."""


def test_nothing_is_executed_and_nothing_is_fetched():
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                names = [node.module or ""]
            elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                assert node.func.id not in FORBIDDEN_CALLS, f"{path.name}:{node.lineno}"
            elif isinstance(node, ast.keyword) and node.arg == "allow_pickle":
                assert ast.unparse(node.value) == "False", f"{path.name}:{node.lineno}"
            allowed = ASKED_FOR.get(path.relative_to(PACKAGE).as_posix(), set())
            forbidden = FORBIDDEN_MODULES - allowed
            assert not forbidden & set(names), f"{path.name}:{node.lineno}"


def test_pickled_objects_are_refused(tmp_path):
    np.savez(tmp_path / "map.npz", __header__=np.array({"a": 1}, object))
    with pytest.raises(RunFolderError, match="not one of our files"):
        artifacts.load(tmp_path / "map.npz", "map", None)


def run_limited(module, arguments, size):
    """A command on a disk that takes no file larger than a size [bytes]."""
    code = LITTLE_DISK.format(bytes=size, argv=[module, *arguments], module=module)
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)


def one_sentence(done):
    """Did a command end with code 2 and one sentence?"""
    assert done.returncode == 2 and "Traceback" not in done.stderr, done.stderr
    lines = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    return len(lines) == 1 and lines[0]


def test_a_full_disk_is_said_and_nothing_is_left_over(tmp_path):
    recording = tmp_path / "log.npz"
    poses = np.zeros((2000, 7))
    poses[:, 0], poses[:, 3] = np.linspace(0, 1, 2000), 1.0
    poses[:, 1] = np.random.default_rng(0).normal(size=2000) * 1e-4
    np.savez(recording, poses=poses, length_unit="m", quaternion="wxyz", rate=60.0)
    skills = tmp_path / "skills"
    arguments = ["import", str(recording), "--library", str(skills)]
    done = run_limited("hybrid_jax.demos", arguments, 4096)
    assert re.search(r"cannot read or write.*(large|space)", one_sentence(done))
    assert list(skills.iterdir()) == []


@pytest.mark.parametrize("out", ["/proc/run", "/dev/null/run"])
def test_folders_that_cannot_be_written_are_named(out):
    done = subprocess.run(
        [sys.executable, "-m", "hybrid_jax.train", "--preset", "smoke", "--out", out],
        capture_output=True,
        text=True,
    )
    assert out.rsplit("/", 1)[0] in one_sentence(done)


def test_an_interrupted_write_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "a.npz"
    artifacts.save(path, "thing", "", {"x": np.arange(3)})

    def full(*args, **kwargs):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez_compressed", full)
    with pytest.raises(OSError, match="No space"):
        artifacts.save(path, "thing", "", {"x": np.arange(4)})
    assert artifacts.load(path, "thing", None)[1]["x"].size == 3
    assert [p.name for p in tmp_path.iterdir()] == ["a.npz"]


def test_a_torn_line_of_metrics_costs_no_other(cell, tmp_path):
    run = Run(tmp_path, cell, "smoke", 0)
    run.log("drl", {"step": 1, "reward": 0.5})
    with run.path("drl.jsonl").open("a") as file:
        file.write('{"step": 2, "rew')
    run.log("drl", {"step": 3, "reward": 0.7})
    assert [row["step"] for row in run.metrics("drl")] == [1, 3]


def test_arrays_of_another_agent_are_refused(smoke_run, tmp_path):
    folder = shutil.copytree(smoke_run, tmp_path / "run")
    run = open_run(folder)
    header, state = run.load("switch.npz", "switching agent")
    run.save("drl.npz", "joint agent", state)
    with pytest.raises(RunFolderError, match=r"drl\.npz holds"):
        load_planner(run)


def test_demonstrations_that_are_no_files_are_left_out(tmp_path):
    for path in list(demonstrations_folder().glob("*.npz"))[:2]:
        shutil.copy(path, tmp_path)
    (tmp_path / "broken.npz").write_bytes(b"PK\x03\x04 not a zip")
    with pytest.warns(UserWarning, match="broken.npz"):
        assert len(load_demonstrations(tmp_path)) == 2


def test_the_answer_is_json_and_nothing_else(smoke_run, tmp_path, capsys):
    (tmp_path / "task.json").write_text('{"object": "block_1", "scene_seed": 3}')
    code = plan.main(
        run=smoke_run, task=tmp_path / "task.json", out=tmp_path / "plan.csv", json=True
    )
    out = json.loads(capsys.readouterr().out)
    assert (code == 0) == (out["status"] == "OK") == (tmp_path / "plan.csv").is_file()
    assert train.main(out=smoke_run, resume=True, json=True, quiet=True) == 0
    assert json.loads(capsys.readouterr().out) == {"run": str(smoke_run), "stages": []}


def test_metrics_for_tensorboard(cell, tmp_path):
    pytest.importorskip("tensorboardX")
    from hybrid_jax.reports.tensorboard import board

    run = Run(tmp_path, cell, "smoke", 0, listener=board(tmp_path / "tensorboard"))
    run.log("drl", {"step": 1, "reward": 0.25, "note": "text is left out"})
    path, until = next((tmp_path / "tensorboard").iterdir()), time.monotonic() + 20
    while b"drl/reward" not in path.read_bytes() and time.monotonic() < until:
        time.sleep(0.2)  # a thread of its own writes
    assert b"drl/reward" in path.read_bytes() and b"note" not in path.read_bytes()


def test_ctrl_c_is_not_lost_in_the_garbage_collector():
    """Python only reports what is raised there, and goes on."""
    code = """
import gc, signal, time
from hybrid_jax.runtime.terminal import run_cli

signal.signal(signal.SIGINT, signal.default_int_handler)  # a background shell ignores it

def interrupted(phase, info):
    gc.callbacks.clear()
    raise KeyboardInterrupt

def command():
    gc.callbacks.append(interrupted)
    gc.collect()
    time.sleep(1)
    return 0

run_cli(command)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (130, "\nstopped\n")


def test_ctrl_c_in_code_made_of_text_ends_with_130(tmp_path):
    """Python then ends by the signal itself, whatever exit code it is asked for."""
    code = """
from hybrid_jax.runtime.terminal import run_cli

def command():
    try:
        exec("raise KeyboardInterrupt")
    except KeyboardInterrupt:
        return 130

run_cli(command)
"""
    (tmp_path / "stopping.py").write_text(code)
    done = subprocess.run([sys.executable, "-m", "stopping"], cwd=tmp_path)
    assert done.returncode == 130


@pytest.mark.parametrize("later", [0.1, 2.0], ids=["importing", "computing"])
def test_ctrl_c_ends_with_130_and_says_how_to_go_on(tmp_path, later):
    folder = tmp_path / "run"
    # what a shell starts in the background ignores Ctrl-C, and so would its children
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    process = subprocess.Popen(
        [sys.executable, "-m", "hybrid_jax.train", "map", "--out", str(folder)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    signal.signal(signal.SIGINT, before)
    until = time.monotonic() + 60
    while not (folder / "config.json").is_file() and time.monotonic() < until:
        time.sleep(0.1)
    time.sleep(later)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130 and f"--resume --out {folder}" in err, err


@pytest.mark.slow
def test_killed_trainings_end_the_same(capsys):
    """One run of `python -m benchmarks.kills`."""
    from benchmarks import kills

    kills.main(kills=1, seed=1)
    out = capsys.readouterr().out
    count = re.search(r"kills\.survived +(\d+)", out)[1]
    assert int(count) > 0 and f"of {count} kills" in out
