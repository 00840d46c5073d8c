# SPDX-License-Identifier: MIT
"""The hybrid method as the paper has it online: gaps, hand-overs, and what is executed."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from hybrid_jax.contracts import STEPS
from hybrid_jax.envs.paper_reach import home_manipulability
from hybrid_jax.planner.bridging import rrt_bridger
from hybrid_jax.planner.combined_path import PhasePath, Window
from hybrid_jax.planner.lfd import optimal_chooser, skill_paths
from hybrid_jax.planner.pipeline import plan_batch
from hybrid_jax.planner.records import Planner
from hybrid_jax.planner.rrt_connect import RrtConfig
from hybrid_jax.planner.skill_following import first_gap, follow_all
from hybrid_jax.planner.target_area import combine, plan_unchecked, task_judge, task_phases
from hybrid_jax.planner.target_area_data import harvest, switch_problems
from hybrid_jax.runs import seeds
from hybrid_jax.runs.load_planner import optimal_switcher, read_library
from hybrid_jax.runs.presets import PAPER
from hybrid_jax.tasks.registry import random_task
from hybrid_jax.types import Source, Status

KEY = jax.random.key(0)
BLOCK, BOLT = seeds.VALIDATION.start + 3, seeds.VALIDATION.start + 6
"""Tasks whose skills leave one gap each, on the way to the tray."""


def searching(cell):
    """RRT-Connect in the joint agent's place: one rollout, to the goal's configuration."""
    bridge = rrt_bridger(cell, RrtConfig(margin=0.01))

    def explore(segments, key):
        ways = bridge(segments, key)
        return np.stack([np.asarray(way)[None, 1:] for way in ways])

    return explore


def standing(segments, key):
    """An agent that does not move."""
    return np.repeat(np.asarray(segments.start)[:, None, None], 3, axis=2)


@pytest.fixture(scope="module")
def planner(cell):
    unit = float(home_manipulability(cell))
    switch = optimal_switcher(PAPER.switch)
    library, config = read_library(), PAPER.planner
    planner = Planner(cell, library, optimal_chooser, None, switch, unit, config)
    return replace(planner, explore=searching(cell))


@pytest.fixture(scope="module")
def task(cell):
    return random_task(cell, BLOCK)


@pytest.mark.parametrize(
    ("labels", "gap"),
    [
        ("......", None),
        ("..xx..", (2, 3)),
        ("..x.x.", (2, 4)),  # an island of one point
        ("x....x", (0, 0)),  # the second gap is a gap of its own
        ("...xxx", (3, 5)),
    ],
)
def test_the_first_gap_swallows_islands(labels, gap):
    assert first_gap(np.array([label == "." for label in labels]), island=4) == gap


def test_the_agent_leads_over_the_gap_and_the_skill_goes_on_from_there(planner, task):
    paths = skill_paths(planner.library, [task], optimal_chooser, planner.config.skills, 1)[0]
    judge = task_judge(planner, task)
    parts = follow_all(judge, paths[0], np.asarray(task.start, np.float32))
    gaps = [first_gap(part.feasible, 4) for part in parts]
    assert sum(gap is not None for gap in gaps) == 1
    _, _, phases = task_phases(planner, task, paths, KEY)
    (window,) = [window for phase in phases for window in phase.windows]
    carrying = phases[1]
    assert window in carrying.windows and window.source is Source.DRL
    np.testing.assert_allclose(window.path[0], carrying.q[window.first], atol=1e-4)
    np.testing.assert_allclose(window.path[-1], carrying.q[window.last], atol=1e-3)
    inside = np.zeros(len(carrying.q), bool)
    inside[window.first + 1 : window.last] = True
    assert not carrying.feasible[inside].all() and carrying.feasible[~inside].all()


def test_a_plan_passes_the_final_check_or_is_refused(planner, task):
    (found,) = plan_batch(planner, [task], key=KEY)
    assert found.status is Status.OK and 0 < found.drl_share < 1
    ends = [(a.positions[-1], b.positions[0]) for a, b in zip(found.phases, found.phases[1:])]  # noqa: B905
    assert all(np.array_equal(a, b) for a, b in ends)
    blind = replace(planner, explore=standing)
    (refused,) = plan_batch(blind, [task], key=KEY)
    assert refused.status is Status.COLLISION and "phase 1" in refused.detail
    # what the paper executes is there all the same
    (unchecked,) = plan_unchecked(blind, [task], key=KEY)
    assert unchecked.status is Status.OK and len(unchecked.phases) == 3


def test_a_task_ends_in_the_configuration_that_it_names(planner, task):
    """The skill ends at the pose of home, on some configuration of a redundant arm."""
    (found,) = plan_batch(planner, [task], key=KEY)
    np.testing.assert_allclose(found.phases[-1].positions[-1], task.end, atol=1e-5)


def test_agents_learn_from_the_same_gaps_and_motions(cell, planner):
    tasks = [random_task(cell, seed) for seed in (BLOCK, BOLT)]
    segments = harvest(planner, tasks)
    assert segments.start.shape == segments.goal.shape == (2, 7)
    problems = switch_problems(planner, tasks, KEY)
    assert problems.q.shape == (2, 2, STEPS, 7)
    # in the gaps the skill collides and the agent does not
    gap = np.asarray(problems.available, bool)
    collision = np.asarray(problems.collision)
    assert collision[:, 0][gap].any() and not collision[:, 1][gap].any()


def test_reward_is_the_papers_man_and_col(cell, planner):
    """Outside of windows both motions are one; man' is in units of home, and not capped."""
    q = np.repeat(np.asarray(cell.home)[None], 40, axis=0)
    phase = PhasePath(q, np.ones(40, bool), [Window(10, 20, q[:2], Source.DRL)])
    combined = combine(cell, phase, planner.scale, 0.008)
    np.testing.assert_allclose(combined.manipulability, 1.0, atol=1e-5)
    assert not np.asarray(combined.collision).any()
    half = combine(cell, phase, planner.scale / 2, 0.008)
    np.testing.assert_allclose(half.manipulability, 2.0, atol=1e-5)


def test_pure_drl_leads_from_key_pose_to_key_pose(planner, task):
    alone = replace(planner, config=replace(planner.config, direct=True))
    (found,) = plan_unchecked(alone, [task], key=KEY)
    assert found.status is Status.OK and found.drl_share > 0.5
