# SPDX-License-Identifier: MIT
"""Programs that are kept on disk: read by later processes, made anew where a file is no good."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from hybrid_jax.errors import InputError
from hybrid_jax.kernels.collision import nearest_pair
from hybrid_jax.runtime import kept_programs, program_files
from hybrid_jax.runtime.kept_programs import KeptProgram, kept
from hybrid_jax.runtime.tree_descriptions import describe, structure_of
from hybrid_jax.types import Status, Trajectory

X = np.arange(6, dtype=np.float32).reshape(2, 3)


def doubled(x, *, times=2):
    """A function that says in `runs` when it is traced."""
    runs.append(times)
    return {"sum": (x * times).sum(), "all": (x * times, None)}


runs: list[int] = []


@pytest.fixture(autouse=True)
def folder(tmp_path):
    """An empty folder for compiled programs."""
    before = jax.config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    runs.clear()
    yield tmp_path / "programs"
    jax.config.update("jax_compilation_cache_dir", before)


def fresh() -> KeptProgram:
    """The function as a new process has it."""
    return kept(doubled, static=("times",))


def same(got, times=2) -> bool:
    return np.array_equal(got["all"][0], X * times) and got["sum"] == X.sum() * times


def test_a_program_is_traced_once_for_all_processes(folder):
    assert same(fresh()(X)) and runs == [2]
    assert same(fresh()(X)) and runs == [2]
    assert same(fresh()(jnp.asarray(X), times=2)) and runs == [2]
    assert len(list(folder.iterdir())) == 1


def test_a_hot_program_is_read_as_one(folder):
    """It is compiled with other options, which whoever loads its file ahead must know, too."""
    assert same(kept(doubled, static=("times",), hot=True)(X))
    assert [path.name.endswith(program_files.HOT) for path in folder.iterdir()] == [True]
    assert same(kept(doubled, static=("times",), hot=True)(X)) and runs == [2]
    assert same(fresh()(X)) and runs == [2, 2]


def test_shapes_types_and_constants_make_programs_of_their_own(folder):
    program = fresh()
    assert same(program(X)) and same(program(X, times=3), 3)
    assert program(X[:1])["all"][0].shape == (1, 3)
    assert program(X.astype(np.int32))["sum"].dtype == jnp.int32
    assert len(runs) == 4 == len(list(folder.iterdir()))
    program(X), program(X[:1])
    assert len(runs) == 4


@pytest.mark.parametrize("damage", [b"", b"not a program", None])
def test_a_damaged_file_is_made_anew(folder, damage):
    fresh()(X)
    (path,) = folder.iterdir()
    whole = path.read_bytes()
    path.write_bytes(whole[:-7] if damage is None else damage)
    assert same(fresh()(X)) and runs == [2, 2]
    assert same(fresh()(X)) and runs == [2, 2]


def test_a_file_of_another_jax_is_made_anew(folder):
    import hashlib

    fresh()(X)
    (path,) = folder.iterdir()
    foreign = b"a program of an unknown version"
    path.write_bytes(hashlib.sha256(foreign).digest() + foreign)
    assert same(fresh()(X)) and runs == [2, 2]


def test_another_source_has_other_programs(folder, monkeypatch):
    fresh()(X)
    monkeypatch.setattr(program_files, "source_digest", lambda: "changed")
    assert same(fresh()(X)) and runs == [2, 2]


def test_a_folder_that_cannot_be_written_costs_one_line(folder, capsys):
    folder.write_text("a file stands where the folder should be")
    program_files.say_once.cache_clear()
    assert same(fresh()(X)) and same(fresh()(X, times=3), 3)
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and str(folder) in said


def test_without_a_folder_nothing_is_kept():
    jax.config.update("jax_compilation_cache_dir", None)
    assert same(fresh()(X)) and runs == [2]


def test_the_programs_that_were_not_used_for_longest_go_first(folder, monkeypatch):
    program = fresh()
    for times in (2, 3, 4):
        program(X, times=times)
    files = sorted(folder.iterdir(), key=lambda path: path.stat().st_mtime_ns)
    for age, path in enumerate(reversed(files)):
        os.utime(path, (1e9 - age, 1e9 - age))
    fresh()(X, times=2)  # read, so that it is the youngest now
    monkeypatch.setattr(program_files, "LIMIT", 3 * files[0].stat().st_size)
    fresh()(X, times=5)
    left = set(folder.iterdir())
    assert files[0] in left and files[1] not in left and files[2] in left


def test_what_cannot_be_kept_runs_all_the_same(folder):
    def asking(x):
        return {"sum": jax.pure_callback(np.sum, jax.ShapeDtypeStruct((), x.dtype), x)}

    program = kept(asking)
    for _ in range(2):
        assert program(X)["sum"] == X.sum()
    assert not list(folder.glob("*.program"))


def test_errors_of_the_function_are_its_own(folder):
    def refusing(x):
        raise InputError(f"{x.shape} is wrong")

    for _ in range(2):
        with pytest.raises(InputError, match="is wrong"):
            kept(refusing)(X)


def test_inside_other_programs_it_is_a_part_of_them(folder):
    program = fresh()
    assert same(jax.jit(program)(X))
    np.testing.assert_array_equal(jax.vmap(program)(X)["sum"], 2 * X.sum(axis=1))
    np.testing.assert_array_equal(jax.grad(lambda x: program(x)["sum"])(X), 2 + 0 * X)
    assert not folder.exists()


def test_results_may_be_records(folder):
    made = lambda: kept(record)(X[0])  # noqa: E731
    assert isinstance(made(), Trajectory) and isinstance(made(), Trajectory)
    np.testing.assert_array_equal(made().positions, X[0] + 1)
    assert Status.OK.sentence


def record(x) -> Trajectory:
    return Trajectory(x, x + 1, x, x, x)


def test_programs_are_loaded_ahead_for_what_took_them_before(folder, monkeypatch):
    monkeypatch.setattr(kept_programs, "_noting", {})
    kept_programs.load_ahead("a purpose")
    assert same(fresh()(X)) and same(fresh()(X, times=3), 3)
    (names,) = (path.read_text().split() for path in folder.glob("*.list"))
    assert len(names) == 2 == len(list(folder.glob("*.program")))
    monkeypatch.setattr(kept_programs, "_noting", {})
    (folder / names[1]).unlink()  # a program that is gone is made anew
    kept_programs.load_ahead("a purpose")
    (loaded,) = kept_programs._ahead.values()
    assert loaded.result() is not None
    assert same(fresh()(X)) and not kept_programs._ahead and runs == [2, 3]
    assert same(fresh()(X, times=3), 3) and runs == [2, 3, 3]
    (again,) = (path.read_text().split() for path in folder.glob("*.list"))
    assert len(again) == 3  # of the two, only the one that was gone is noted once more
    kept_programs.load_ahead("another purpose")
    assert not kept_programs._ahead


def test_lists_name_programs_in_their_folder_only(tmp_path):
    (tmp_path / "a.program").write_text("")
    (tmp_path / "x.list").write_text("a.program\nb.program\n../../a.program\n\nx.list")
    assert program_files.read_list(tmp_path / "x.list") == [tmp_path / "a.program"]
    (tmp_path / "x.list").write_bytes(b"\xff\xfe")
    assert program_files.read_list(tmp_path / "x.list") == []


def test_structures_are_described_and_only_those_of_the_package(cell):
    shapes = jax.tree.map(np.asarray, cell.scene)
    nearest = nearest_pair.Nearest(1, 2, 3, 4)
    for tree in (None, 3, [X, (X, None)], {"b": X, "a": [X]}, shapes, (nearest, {"x": shapes})):
        structure = jax.tree.structure(tree)
        assert structure_of(describe(structure)) == structure
    with pytest.raises(TypeError, match="none of hybrid_jax"):
        describe(jax.tree.structure(optax.EmptyState()))
    for wrong in ("", "[]", '["os:system", {}, {}]', '["hybrid_jax.types:Gone", {}, {}]', "[1, 2]"):
        with pytest.raises(ValueError):
            structure_of(wrong)


def test_arrays_are_kept_and_made_anew_where_their_file_is_damaged(folder):
    made = []

    def make():
        made.append(1)
        return X

    for _ in range(2):
        np.testing.assert_array_equal(program_files.kept_array("x", (1,), make), X)
    assert len(made) == 1
    (path,) = folder.iterdir()
    path.write_bytes(path.read_bytes()[:-1])
    np.testing.assert_array_equal(program_files.kept_array("x", (1,), make), X)
    np.testing.assert_array_equal(program_files.kept_array("x", (2,), make), X)
    assert len(made) == 3


SCRIPT = """
import numpy as np
from hybrid_jax import clearance, load_workcell, solve_ik
from hybrid_jax.kernels.collision.motion_validation import path_is_free
from hybrid_jax.runtime.kept_programs import traced
cell = load_workcell("fpi")
q = np.asarray(cell.home)
print(float(clearance(cell, q)), path_is_free(cell, np.stack([q, q + 0.1])), len(traced))
"""


def test_processes_share_programs_also_at_once(tmp_path):
    """Several write at the same time, a later one traces nothing; all say the same."""
    environment = os.environ | {"JAX_COMPILATION_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-c", SCRIPT]
    pipes = {"env": environment, "text": True, "stdout": subprocess.PIPE}
    processes = [subprocess.Popen(command, **pipes) for _ in range(2)]
    answers = [process.communicate()[0].split() for process in processes]
    answers.append(subprocess.run(command, **pipes, check=True).stdout.split())
    assert len({tuple(answer[:2]) for answer in answers}) == 1
    assert answers[0][2] != "0" and answers[-1][2] == "0"
