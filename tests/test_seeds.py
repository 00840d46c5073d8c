# SPDX-License-Identifier: MIT
"""No scene of a study is one that anything was trained, tuned or looked at on."""

import itertools
import re
from pathlib import Path

import pytest

from hybrid_jax import presets, seeds, stages
from hybrid_jax.studies import handling, inspection

ROOT = Path(__file__).resolve().parent.parent
FIRST = r"^(?:FIRST|TEST|UNSEEN|SCENE|TRAINING\w*|\w*SEEDS?)\b.*= *\d[\d_]{4,}"
"""A constant that is the seed of a first scene."""
RANGES = {name: value for name, value in vars(seeds).items() if isinstance(value, range)}


def meets(a: range, b: range) -> bool:
    return a.start < b.stop and b.start < a.stop


def test_every_range_says_what_it_is_for():
    assert set(RANGES) == {*seeds.SEEN, *seeds.HELD_OUT}


@pytest.mark.parametrize("one, other", itertools.combinations(RANGES, 2))
def test_no_two_ranges_meet(one, other):
    assert not meets(RANGES[one], RANGES[other])


def test_trainings_and_studies_stay_inside_their_ranges():
    most = max(max(p.tasks, p.switch_tasks, p.held_out) for p in presets.PRESETS.values())
    assert stages.TRAINING_TASKS + most <= seeds.TRAINING.stop
    assert stages.HELD_OUT_TASKS + most <= seeds.VALIDATION.stop
    assert handling.SEEDS is seeds.HANDLING_STUDY and inspection.SEEDS is seeds.INSPECTION_STUDY
    assert len(seeds.INSPECTION_STUDY) >= 100 * 100, "trials of 100 runs of up to 100 parts"


def test_no_other_module_has_a_range_of_its_own():
    """Large numbers that look like the seed of a first scene stand in one place."""
    paths = [*(ROOT / "hybrid_jax").rglob("*.py"), *(ROOT / "benchmarks").glob("*.py")]
    for path in paths:
        if path.name == "seeds.py":
            continue
        for line in path.read_text().splitlines():
            found = re.match(FIRST, line)
            assert not found, f"{path.name}: {line}"


def test_what_was_looked_at_before_is_spent():
    for past in (10_000, 10_099, 30_000, 50_000, 60_000, 100_000, 120_000, 200_000, 300_000):
        assert past in seeds.SPENT
