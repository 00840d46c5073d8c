# SPDX-License-Identifier: MIT
"""No scene of a study is one that anything was trained, tuned or looked at on."""

import ast
import itertools
import re
from pathlib import Path

import pytest

from hybrid_jax.runs import presets, seeds, stages
from hybrid_jax.studies import handling, inspection

ROOT = Path(__file__).resolve().parent.parent
DRAWING = {"range", "random_task", "sample_scene", "sort_scenes", "harvest", "collect", "Trial"}
"""Calls that scenes are drawn by, or their seeds counted."""
RANGES = {name: value for name, value in vars(seeds).items() if isinstance(value, range)}


def meets(a: range, b: range) -> bool:
    return a.start < b.stop and b.start < a.stop


def test_every_range_says_what_it_is_for():
    assert set(RANGES) == {*seeds.SEEN, *seeds.HELD_OUT}


@pytest.mark.parametrize("one, other", list(itertools.combinations(RANGES, 2)))
def test_no_two_ranges_meet(one, other):
    assert not meets(RANGES[one], RANGES[other])


def test_trainings_and_studies_stay_inside_their_ranges():
    most = max(max(p.tasks, p.switch_tasks, p.held_out) for p in presets.PRESETS.values())
    assert stages.TRAINING_TASKS + most <= seeds.TRAINING.stop
    assert stages.HELD_OUT_TASKS + most <= seeds.VALIDATION.stop
    assert handling.SEEDS is seeds.HANDLING_STUDY and inspection.SEEDS is seeds.INSPECTION_STUDY
    assert len(seeds.INSPECTION_STUDY) >= 100 * 100, "trials of 100 runs of up to 100 parts"


def own_seeds(text: str) -> list[str]:
    """Large numbers of a module that scenes are drawn by, or that are named a seed or a first."""
    found = []
    for node in ast.walk(ast.parse(text)):
        name = ""
        if isinstance(node, ast.Call):
            name = getattr(node.func, "id", getattr(node.func, "attr", ""))
            drawn = name in DRAWING
        elif isinstance(node, ast.Assign | ast.AnnAssign | ast.keyword):
            single = [getattr(node, "target", node)]
            targets = node.targets if isinstance(node, ast.Assign) else single
            names = [getattr(one, "id", getattr(one, "arg", "")) or "" for one in targets]
            drawn = any(re.search(r"seed|first|scene|(?:^|_)tasks?(?:$|_)", n, re.I) for n in names)
        else:
            continue
        large = [
            n.value
            for n in ast.walk(node)
            if isinstance(n, ast.Constant) and type(n.value) is int and n.value >= 10_000
        ]
        found += [f"{name} {value}" for value in large if drawn]
    return found


def test_no_other_module_has_a_range_of_its_own():
    paths = [*(ROOT / "hybrid_jax").rglob("*.py"), *(ROOT / "benchmarks").glob("*.py")]
    for path in paths:
        if path.name != "seeds.py":
            assert not own_seeds(path.read_text()), path


def test_seeds_of_a_modules_own_are_found():
    for text in (
        "random_task(cell, 120_000 + i)",
        "TASKS = range(10_000, 11_000)",
        "FIRST_SCENE = 30_000",
        "study(seed=10_000)",
    ):
        assert own_seeds(text), text
    assert not own_seeds("STEPS = 16_384\nrange(100)\njax.random.key(123_456)")


def test_what_was_looked_at_before_is_spent():
    for past in (10_000, 10_099, 30_000, 50_000, 60_000, 100_000, 120_000, 200_000, 300_000):
        assert past in seeds.SPENT
