# SPDX-License-Identifier: MIT
"""Files and machines that are not as expected: one sentence, nothing lost, nothing that hangs."""

import json
import os
import subprocess
import sys
import threading
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest

from hybrid_jax.demonstrations.demonstration import (
    check_demonstration,
    load_demonstration,
    load_demonstrations,
    save_demonstration,
)
from hybrid_jax.demonstrations.importing import read_recording
from hybrid_jax.errors import (
    DemonstrationError,
    HybridJaxError,
    RunFolderError,
    TaskError,
    UnknownNameError,
    WorkcellError,
)
from hybrid_jax.runs.run_folder import create_run, open_run, read_config
from hybrid_jax.runtime import compile_cache, devices, input_files, output_files, terminal
from hybrid_jax.runtime.input_files import MOST_TEXT, read_text
from hybrid_jax.runtime.output_files import write_text
from hybrid_jax.tasks.registry import read_task
from hybrid_jax.workcell.assets import robots_folder
from hybrid_jax.workcell.description import read_task_data


def timed(seconds, action):
    """An action that must not hang."""
    found = []
    thread = threading.Thread(target=lambda: found.append(_caught(action)), daemon=True)
    thread.start()
    thread.join(seconds)
    assert not thread.is_alive(), "it hangs"
    return found[0]


def _caught(action):
    try:
        return action()
    except HybridJaxError as error:
        return error


def test_pipes_devices_and_giants_are_refused_at_once(cell, tmp_path):
    pipe, giant = tmp_path / "pipe.json", tmp_path / "giant.json"
    os.mkfifo(pipe)
    with giant.open("wb") as file:
        file.truncate(MOST_TEXT + 1)
    for path, words in (
        (pipe, "no regular file"),
        (Path("/dev/zero"), "no regular file"),
        (giant, "at most 32 MiB"),
        (tmp_path / "none", "No such file"),
    ):
        found = timed(5, lambda path=path: read_task(cell, path))
        assert isinstance(found, TaskError) and words in str(found)
    for reader in (read_task_data, read_recording):
        toml = pipe.with_suffix(".csv" if reader is read_recording else ".toml")
        os.mkfifo(toml)
        found = timed(5, lambda reader=reader, toml=toml: reader(toml))
        assert found is None or isinstance(found, HybridJaxError)
    found = timed(5, lambda: read_text(Path("a\0b"), TaskError))
    assert "a\\0b" in str(found)


def test_messages_repeat_no_endless_value(cell, tmp_path):
    path = tmp_path / "task.json"
    path.write_text(json.dumps({"object": "x" * 10**6}))
    with pytest.raises(HybridJaxError) as error:
        read_task(cell, path)
    assert len(str(error.value)) < 1000
    assert len(str(UnknownNameError("object", "y" * 10**6, ["a"]))) < 1000


def archive(path, **sizes):
    """An `.npz` whose members unpack to so many bytes of zeros."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name, size in sizes.items():
            header = np.lib.format.magic(1, 0)
            text = f"{{'descr': '|u1', 'fortran_order': False, 'shape': ({size},), }}".ljust(117)
            with file.open(f"{name}.npy", "w", force_zip64=True) as member:
                length = (len(text) + 1).to_bytes(2, "little")
                member.write(header + length + text.encode() + b"\n")
                for _ in range(size >> 20):
                    member.write(bytes(1 << 20))


def test_archives_are_not_unpacked_before_they_are_looked_at(tmp_path, monkeypatch):
    archive(tmp_path / "a.npz", unused=192 << 20)
    monkeypatch.setattr(input_files, "MOST_ARRAYS", 64 << 20)
    began = time.monotonic()
    with pytest.raises(DemonstrationError, match="'poses' is missing"):
        read_recording(tmp_path / "a.npz")
    assert time.monotonic() - began < 0.5
    with pytest.raises(RunFolderError, match="would unpack to 0.2 GiB"):
        load_demonstration(tmp_path / "a.npz")


HEADER = "time [s], x [m], y [m], z [m], qw, qx, qy, qz, gripper\n"


def recording(path, begin, header=HEADER, step=0.05):
    rows = [
        f"{begin + step * i:.3f}, {0.4 + 0.01 * i}, .1, .3, 1, 0, 0, 0, {int(i > 15)}"
        for i in range(30)
    ]
    path.write_text(header + "\n".join(rows) + "\n")
    return path


@pytest.mark.parametrize("begin", [0.0, 2_600_000.0, 1_764_331_171.0])
def test_clocks_of_any_recorder_count_from_zero(tmp_path, begin):
    (demo,) = read_recording(recording(tmp_path / "a.csv", begin))
    save_demonstration(tmp_path / "skills", demo)
    (stored,) = load_demonstrations(tmp_path / "skills")
    np.testing.assert_allclose(stored.times, 0.05 * np.arange(30), atol=1e-6)
    for values in ("times", "poses", "gripper"):
        np.testing.assert_array_equal(getattr(stored, values), getattr(demo, values))


def test_what_is_stored_is_what_was_checked(tmp_path):
    """Also where single precision would let two times fall together."""
    (demo,) = read_recording(recording(tmp_path / "a.csv", 0.0))
    late = type(demo)(**{**demo.__dict__, "times": demo.times + 2**26})
    check_demonstration(late)
    stored = load_demonstration(save_demonstration(tmp_path, late))
    np.testing.assert_array_equal(stored.times, late.times)


def test_a_column_that_stands_there_twice_is_refused(tmp_path):
    header = HEADER.replace("gripper", "x [m]")
    with pytest.raises(DemonstrationError, match="'x' stands there twice, as number 2 and 9"):
        read_recording(recording(tmp_path / "a.csv", 0.0, header))


def test_names_of_unfinished_files_are_refused_and_others_kept(tmp_path):
    (demo,) = read_recording(recording(tmp_path / "a1.csv", 0.0))
    with pytest.raises(DemonstrationError, match="'a1.partial' is no name"):
        save_demonstration(tmp_path, type(demo)(**{**demo.__dict__, "name": "a1.partial"}))
    save_demonstration(tmp_path, demo)
    assert [d.name for d in load_demonstrations(tmp_path)] == ["a1"]


@pytest.mark.parametrize(
    "name, old, new, words",
    [
        ("gen3_handling", "lift = 0.12", "lift = 1e308", "lift is 1e+308"),
        ("gen3_handling", "open = 0.0425", "open = -0.0425", "open is -0.0425"),
        ("gen3_handling", "half_size = [0.15, 0.19]", "half_size = [-0.15, 0.19]", "half_size is"),
        ("gen3_handling", "spawn = [0.67, 0.0, 0.0]", "spawn = [1e300, 0.0, 0.0]", "spawn is"),
        ("gen3_handling", "hover = 0.12", f"hover = 1{'0' * 400}", "hover is 1000"),
        ("fpi", "brush_speed = 0.10", "brush_speed = 0", "brush_speed is 0"),
        ("fpi", "guides = 2", "guides = -1", "guides is -1"),
        ("fpi", "guides = 2", "guides = 1000000000", "guides is 1000000000"),
        ("fpi", "length = 0.096", "length = -0.096", "length is -0.096"),
    ],
)
def test_each_number_of_the_task_data_that_cannot_be_is_named(tmp_path, name, old, new, words):
    text = (robots_folder() / "workcells" / f"{name}.toml").read_text()
    assert old in text
    path = tmp_path / "cell.toml"
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(WorkcellError) as error:
        read_task_data(path)
    assert words in str(error.value) and len(str(error.value)) < 600


def test_two_runs_that_begin_at_once_get_a_folder_each(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = []
    threads = [
        threading.Thread(target=lambda: found.append(create_run("fpi", "smoke", 0, None).folder))
        for _ in range(6)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(set(found)) == 6 and all(read_config(folder) for folder in found)
    with pytest.raises(RunFolderError, match="already holds a run"):
        create_run("fpi", "smoke", 0, found[0])


def test_the_newest_run_of_a_cell_is_the_one_with_the_largest_number(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    create_run("fpi", "smoke", 0, Path("runs/fpi-999"))
    newest = create_run("fpi", "smoke", 0, Path("runs/fpi-1000"))
    create_run("fpi", "smoke", 0, Path("runs/fpi-2-001"))  # a cell that is called fpi-2
    assert open_run(None, "fpi").folder == newest.folder
    assert create_run("fpi", "smoke", 0, None).folder == Path("runs/fpi-1001")


def test_a_full_disk_names_the_file(tmp_path, monkeypatch):
    def full(self, content):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OSError) as error:
        write_text(tmp_path / "plan.json", "{}")
    assert error.value.filename == str(tmp_path / "plan.json")


def test_no_home_means_no_cache_and_no_traceback(monkeypatch):
    def none():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(Path, "home", none)
    assert compile_cache._caches() is None


def test_cores_are_counted_on_any_system(monkeypatch):
    assert devices.usable_cores() == len(os.sched_getaffinity(0))
    monkeypatch.delattr(os, "sched_getaffinity")
    assert devices.usable_cores() == os.cpu_count()


def test_a_platform_that_is_not_there_is_said_in_a_sentence():
    done = subprocess.run(
        [sys.executable, "-m", "hybrid_jax.check", "fpi", "--quiet"],
        capture_output=True,
        text=True,
        env={**os.environ, "JAX_PLATFORMS": "cuda", "JAX_ENABLE_X64": "1"},
    )
    assert done.returncode == terminal.BAD_INPUT
    assert "error: JAX has no device of the platforms 'cuda'" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_file_system_without_hard_links_holds_runs(tmp_path, monkeypatch):
    def refuse(*_):
        raise PermissionError("no links here")

    monkeypatch.setattr(os, "link", refuse)
    output_files.write_new(tmp_path / "config.json", "{}")
    with pytest.raises(FileExistsError):
        output_files.write_new(tmp_path / "config.json", "[]")
    assert [path.name for path in tmp_path.iterdir()] == ["config.json"]
    assert (tmp_path / "config.json").read_text() == "{}"
