# SPDX-License-Identifier: MIT
"""Training data of the agents of the paper's own way: gaps of skill paths, motions of phases."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from hybrid_jax.contracts import Combined, Segments
from hybrid_jax.errors import InputError
from hybrid_jax.planner.phase_scenes import inside
from hybrid_jax.planner.records import Planner
from hybrid_jax.planner.skill_following import (
    fewest_infeasible,
    first_gap,
    follow_all,
    starting_point,
)
from hybrid_jax.planner.target_area import paths_of, switch_problem, task_judge, task_phases
from hybrid_jax.runtime.keys import fold_in
from hybrid_jax.tasks.task import Task


def harvest(planner: Planner, tasks: Sequence[Task]) -> Segments:
    """Infeasible segments of tasks, each from D_(i-1) to D_(j+1) (Algorithm 1, lines 4-7).

    Returns:
        Segments stacked, with ends `[segment, joint]` [rad or m].

    Raises:
        InputError: skills leave none.
    """
    config, found = planner.config.handover, []
    assert config
    for task, paths in zip(tasks, paths_of(planner, list(tasks)), strict=True):
        judge, start = task_judge(planner, task), np.asarray(task.start, np.float32)
        if not len(paths[0].poses):
            continue
        path = fewest_infeasible(judge, paths, start)
        for number, part in enumerate(follow_all(judge, path, start)):
            gap = first_gap(part.feasible, config.island)
            if gap and gap[1] < len(part.q) - 1:
                ends = part.q[starting_point(part, gap[0])], part.q[gap[1] + 1]
                found.append(Segments(jax.tree.map(lambda a, n=number: a[n], judge.scenes), *ends))
    if not found:
        raise InputError(f"the skills of {len(tasks)} tasks leave no infeasible segment")
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *found)


def switch_problems(planner: Planner, tasks: Sequence[Task], key: Array) -> Combined:
    """Problems of the switching agent: the phases of tasks over whose gaps the agent leads.

    Returns:
        `[problem, ...]`: configurations `[problem, 2, STEPS, joint]` [rad or m].

    Raises:
        InputError: there is none.
    """
    problems = []
    for row, (task, paths) in enumerate(zip(tasks, paths_of(planner, list(tasks)), strict=True)):
        if not len(paths[0].poses):
            continue
        _, judge, phases = task_phases(planner, task, paths, fold_in(key, row))
        for phase, (low, _) in zip(phases, task.phases, strict=True):
            if phase.windows:
                cell = inside(planner.cell, judge.scenes, low)
                problems.append(switch_problem(planner, cell, phase))
    if not problems:
        raise InputError(f"the joint agent leads over no gap of {len(tasks)} tasks")
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *problems)
