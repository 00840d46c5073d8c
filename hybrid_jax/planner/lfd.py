# SPDX-License-Identifier: MIT
"""Tool paths of tasks from a library of skills: RL-LfD online (paper, Algorithm 2)."""

import itertools
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from hybrid_jax.contracts import SkillChooser
from hybrid_jax.kernels.batching import padded_chunks
from hybrid_jax.runtime.kept_programs import kept
from hybrid_jax.skills.costs import SegmentCosts, pad_costs, pad_task, segment_costs
from hybrid_jax.skills.library import SkillConfig, SkillLibrary
from hybrid_jax.skills.matching import cut_segment, map_pieces
from hybrid_jax.skills.task_segmentation import (
    MissingSkill,
    SkillPlan,
    best_plans,
    missing_skills,
    optimal_plan,
)
from hybrid_jax.tasks.task import Task

POINTS = 30
"""Way points of a unit segment."""
TASKS_PER_CALL = 16
"""Tasks whose segment costs are computed in one call."""
SLOTS = 8
"""Skill slots of a library are evaluated in multiples of this: most of them are empty."""


def optimal_chooser(costs: SegmentCosts) -> SkillPlan:
    """The exact task planner (a `SkillChooser`).

    Args:
        costs: of one task, `cost` `[a, b, skill]`.

    Returns:
        The cheapest admissible plan; empty where there is none.
    """
    return optimal_plan(np.asarray(costs.cost), int(costs.count))[0]


@dataclass(frozen=True)
class SkillPath:
    """What RL-LfD makes of a task."""

    plan: SkillPlan
    """Segments and skills; empty where a demonstration is missing. Key poses are numbered from the
    first one that skills cover (see `Task.shown`)."""
    missing: list[MissingSkill]
    """Demonstrations to give, where the plan is empty."""
    poses: np.ndarray
    """`[segment, POINTS, 8]` tool poses of each unit segment, from key pose to key pose."""


@kept(static=("config", "slots"))
def _costs(library: SkillLibrary, poses, carrying, config: SkillConfig, slots: int) -> SegmentCosts:
    """Costs of tasks with equally many key poses.

    Args:
        library: the skills.
        poses: `[task, key pose, 8]`.
        carrying: `[task, key pose]` is the object held on the segment that begins there?
        config: distance and tolerance.
        slots: number of slots of the library that are evaluated.
    """
    used = library.replace(
        poses=library.poses[:slots], valid=library.valid[:slots], closed=library.closed[:slots]
    )
    judge = lambda p, c: segment_costs(used, p, c, jnp.asarray(poses.shape[1]), config)  # noqa: E731
    return jax.vmap(judge)(poses, carrying)


def _all_costs(library: SkillLibrary, tasks: list[Task], config: SkillConfig) -> list[SegmentCosts]:
    """Costs of each task, padded to one size, on the host."""
    slots, padded = SLOTS * -(-len(library.names) // SLOTS), [pad_task(task) for task in tasks]
    by_task: dict[int, SegmentCosts] = {}
    for size in {count for *_, count in padded}:
        # tasks of one size go together, so that no padding is evaluated
        rows = [i for i, (*_, count) in enumerate(padded) if count == size]
        for index, count in padded_chunks(len(rows), TASKS_PER_CALL):
            task_rows = [padded[rows[i]] for i in index]
            poses, carrying = (np.stack([row[k][:size] for row in task_rows]) for k in (0, 1))
            costs = jax.device_get(_costs(library, poses, carrying, config, slots))
            for i in range(count):
                task_costs = jax.tree.map(lambda a, i=i: a[i], costs)
                by_task[rows[index[i]]] = pad_costs(task_costs)
    return [by_task[i] for i in range(len(tasks))]


def skill_paths(
    library: SkillLibrary,
    tasks: list[Task],
    choose: SkillChooser,
    config: SkillConfig,
    plans: int = 1,
) -> list[list[SkillPath]]:
    """Choose skills for tasks and map them onto the key poses.

    An inadmissible skill is never used.

    Args:
        library: the skills.
        tasks: what is to be done.
        choose: picks segments and skills; its plan comes first.
        config: how skills are judged and mapped.
        plans: largest number of plans of each task; those after the first are the cheapest.

    Returns:
        For each task one or more paths, with tool poses `[segment, POINTS, 8]`. Where a
        demonstration is missing there is one path, whose plan is empty.
    """
    costs = _all_costs(library, tasks, config)
    task_plans = [_plans(task_costs, choose, plans) for task_costs in costs]
    # pieces stand in the order of the key poses, whatever the order of the plan
    pieces = [
        [
            piece
            for a, b, k in sorted(plan)
            for piece in cut_segment(library, task.shown[0], a, b, k, config)
        ]
        for task, alternatives in zip(tasks, task_plans, strict=True)
        for plan in alternatives
    ]
    poses = map_pieces(library, list(itertools.chain(*pieces)), config, POINTS)
    mapped = iter(np.split(poses, np.cumsum([len(p) for p in pieces])[:-1]))
    paths = []
    # skills number key poses from the end of a transit on, hence `first`
    for task, task_costs, alternatives in zip(tasks, costs, task_plans, strict=True):
        missing = (
            []
            if alternatives[0]
            else missing_skills(
                np.asarray(task_costs.cost),
                np.asarray(task_costs.nearest),
                int(task_costs.count),
                library.names,
                config.tolerance,
                first=int(task.transit),
            )
        )
        paths.append(
            [SkillPath(plan, missing, _with_transit(task, next(mapped))) for plan in alternatives]
        )
    return paths


def _with_transit(task: Task, poses: np.ndarray) -> np.ndarray:
    """The poses `[segment, POINTS, 8]` of skills, preceded by those of the task's transit, if any.

    In a transit the tool stands where it is, and then at key pose 1: a gap for the joint agent.
    """
    if not (task.transit and len(poses)):
        return poses
    return np.concatenate([_transits(task.key_poses[:2]), poses])


def _transits(key_poses: np.ndarray) -> np.ndarray:
    """Poses `[segment, POINTS, 8]` that stay at a key pose and then jump to the next one."""
    resting = key_poses[:-1, None].repeat(POINTS - 1, axis=1)
    return np.concatenate([resting, key_poses[1:, None]], axis=1)


def without_skills(tasks: list[Task]) -> list[list[SkillPath]]:
    """Paths of tasks without skills: every segment is a gap for the joint agent.

    Returns:
        For each task one path, with tool poses `[segment, POINTS, 8]` and an empty plan.
    """
    return [[SkillPath([], [], _transits(task.key_poses))] for task in tasks]


def _plans(costs: SegmentCosts, choose: SkillChooser, count: int) -> list[SkillPlan]:
    """The chosen plan, and the cheapest others up to a number."""
    first = choose(costs)
    if count == 1 or not first:
        return [first]
    cheapest = best_plans(np.asarray(costs.cost), int(costs.count), count)
    return [first, *(plan for plan in cheapest if plan != sorted(first))][:count]


def skill_path(
    library: SkillLibrary, task: Task, choose: SkillChooser, config: SkillConfig
) -> SkillPath:
    """Choose and map the skills of one task, by one plan.

    Returns:
        Tool poses `[segment, POINTS, 8]` with the plan, see `skill_paths`.
    """
    return skill_paths(library, [task], choose, config)[0][0]
