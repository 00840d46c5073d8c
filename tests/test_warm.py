# SPDX-License-Identifier: MIT
"""What is compiled ahead of time is what planning takes."""

import jax
import numpy as np
import pytest

from hybrid_jax import warm
from hybrid_jax.errors import InputError
from hybrid_jax.planner.pipeline import plan_batch
from hybrid_jax.planner.point_to_point import plan_joint_motion
from hybrid_jax.runs.presets import SMOKE
from hybrid_jax.runs.warm_up import blank_planner, parts
from hybrid_jax.runtime.kept_programs import traced
from hybrid_jax.tasks.registry import random_task
from tests import arms


def test_planning_traces_nothing_after_it(cell):
    """Other tasks, in batches of other sizes: single plans, batches and motions."""
    planner = blank_planner(cell, SMOKE)
    for make in parts(planner).values():
        make()
    before = list(traced)
    for count in (1, 3, 20):
        plan_batch(
            planner, [random_task(cell, 40 + i) for i in range(count)], key=jax.random.key(1)
        )
    plan_joint_motion(cell, cell.home, np.asarray(cell.home) + 0.1, key=jax.random.key(1))
    assert traced[len(before) :] == []


def test_a_cell_without_tasks_is_warmed_for_motions(tmp_path):
    cell = arms.load(tmp_path, arms.CELL.format(more=""), "cell.xml")
    named = parts(blank_planner(cell, SMOKE))
    assert list(named) == ["a motion"]


def test_one_of_cell_run_and_all(tmp_path):
    with pytest.raises(InputError, match="name a cell, --run DIR, or --all"):
        warm.main(workcell="fpi", run=tmp_path)
