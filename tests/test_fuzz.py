# SPDX-License-Identifier: MIT
"""No broken file crashes a reader without a named error (`python -m benchmarks.fuzz`: 100,000)."""

import pytest
from fuzzing import attempt, make_targets, mutate
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

NAMES = (
    "mjcf",
    "urdf",
    "handling data",
    "inspection data",
    "task",
    "csv recording",
    "npz recording",
    "ros bag",
    "ros bag of sqlite",
    "demonstration",
    "map",
    "policy",
    "run's settings",
    "metrics",
    "tp program",
)


@pytest.fixture(scope="module")
def targets(cell, tmp_path_factory):
    return make_targets(tmp_path_factory.mktemp("sound"), cell)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("broken")


def test_every_reader_is_tried(targets):
    assert set(targets) == set(NAMES)


@pytest.mark.parametrize("name", [n for n in NAMES if n != "ros bag of sqlite"])
def test_sound_files_are_read(targets, folder, name):
    assert attempt(targets[name], targets[name].sound, folder) == ("read", "")


@pytest.mark.parametrize("name", NAMES)
def test_broken_files_are_refused_by_name(targets, folder, name):
    target = targets[name]
    models = name in ("mjcf", "urdf")

    @settings(
        max_examples=40 if models else 150,
        deadline=None,
        database=None,
        derandomize=True,
        suppress_health_check=list(HealthCheck),
    )
    @given(st.randoms(use_true_random=False))
    def try_one(rng):
        outcome, what = attempt(target, mutate(rng, target), folder)
        assert outcome != "crashed", what

    try_one()
