# SPDX-License-Identifier: MIT
"""The examples run to their ends and print what they promise."""

import runpy
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
PRINTED = {
    "01_kernels_in_your_jit": "configurations are free of collision",
    "02_ik_and_branches": "branches bring the tool to where it is at home",
    "03_feasibility_map": "poses  FEASIBLE",
    "04_joint_motion": "OK: ",
    "05_teach_and_map_a_skill": "ends       at [0.5  0.3  0.15] m",
    "06_whole_plan": "written to block_1.csv",
    "07_batch_of_plans": "second batch: {'OK': 8}",
    "08_own_cell": "OK: ",
    "09_plan_in_physics": "success: True",
    "10_joint_policy_elsewhere": "actions of four observations: (4, 7)",
}
"""A piece of what each example prints."""


def test_every_example_is_tried():
    assert {path.stem for path in EXAMPLES.glob("*.py")} == set(PRINTED)


@pytest.mark.parametrize("name", PRINTED)
def test_an_example_prints_what_it_promises(name, request, tmp_path, monkeypatch, capsys):
    path = EXAMPLES / f"{name}.py"
    needs_run = "sys.argv" in path.read_text()
    folder = [str(request.getfixturevalue("smoke_run"))] if needs_run else []
    monkeypatch.setattr(sys, "argv", [str(path), *folder])
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(path), run_name="__main__")
    assert PRINTED[name] in capsys.readouterr().out


def test_examples_are_short():
    assert all(len(path.read_text().splitlines()) <= 60 for path in EXAMPLES.glob("*.py"))
