# SPDX-License-Identifier: MIT
"""A study that is stopped goes on where it was."""

import json

import numpy as np
import pytest

from hybrid_jax import evaluate
from hybrid_jax.errors import RunFolderError
from hybrid_jax.execution.handling import SortingReport
from hybrid_jax.execution.sorting import ObjectReport
from hybrid_jax.runs.run_folder import Run
from hybrid_jax.studies import handling as study
from hybrid_jax.studies import methods
from hybrid_jax.studies.journal import Journal


def run_of(seed: int, causes: list[str]) -> SortingReport:
    reports = [
        ObjectReport(f"o{i}", not c, not c, c, tries=1, asked=1) for i, c in enumerate(causes)
    ]
    return SortingReport(seed, reports, [], np.zeros((3, 45), np.float32), 60.0)


def test_a_study_that_was_stopped_goes_on_with_what_it_lacks(cell, tmp_path, monkeypatch):
    calls = []

    def runs(_, one, numbers, quiet=False):
        calls.append((one.name, list(numbers)))
        if len(calls) == 3:
            raise KeyboardInterrupt
        return [run_of(number, [""]) for number in numbers], 1.0

    monkeypatch.setattr(study, "run_method", runs)
    monkeypatch.setattr(evaluate, "BLOCK", 2)
    some = [methods.Method(name, None, None) for name in ("hybrid", "lfd")]
    run, out = Run(tmp_path, cell, "smoke", 0), tmp_path / "study.json"
    seeds = range(7, 10)
    with pytest.raises(KeyboardInterrupt):
        evaluate.run_study(study, run, some, seeds, out, True)
    with pytest.raises(RunFolderError, match="other"):
        evaluate.run_study(study, run, some, seeds, out, True, Run(tmp_path / "other", cell, "", 0))
    evaluate.run_study(study, run, some, seeds, out, True)
    blocks = [[7, 8], [9]]
    again = [(name, block) for name in ("hybrid", "lfd") for block in blocks]
    assert calls == [*again[:2], ("lfd", [7, 8]), *again[2:]]
    found = json.loads(out.read_text())["runs"]
    assert [(row["method"], row["seed"]) for row in found] == [
        (name, seed) for name in ("hybrid", "lfd") for seed in seeds
    ]
    assert not out.with_suffix(".progress").exists()


def test_what_a_kill_tore_is_made_again_and_kept(tmp_path):
    path, about = tmp_path / "a.progress", {"runs": 4}
    journal = Journal(path, about)
    journal.add("hybrid", [1, 2], [{"seed": 1}], 1.0)
    journal.close(finished=False)
    path.write_text(path.read_text() + '{"method": "hybrid", "numbers": [3')
    for missing in ([3, 4], []):
        again = Journal(path, about)
        assert again.missing("hybrid", [1, 2, 3, 4]) == missing
        again.add("hybrid", missing, [{"seed": 3}], 1.0)
        again.close(finished=False)


def test_two_studies_do_not_share_a_file(tmp_path):
    first = Journal(tmp_path / "a.progress", {"runs": 3})
    with pytest.raises(RunFolderError, match="another study is being written"):
        Journal(tmp_path / "a.progress", {"runs": 3})
    first.close(finished=False)
    with pytest.raises(RunFolderError, match="belongs to a study of"):
        Journal(tmp_path / "a.progress", {"runs": 4})
    Journal(tmp_path / "a.progress", {"runs": 3}).close(finished=True)
