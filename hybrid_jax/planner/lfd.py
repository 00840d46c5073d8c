# SPDX-License-Identifier: MIT
"""RL-LfD at work: a task and a skill library become a path of tool poses (Algorithm 2, online)."""

import functools
import itertools
from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from hybrid_jax.kernels.batching import padded_chunks
from hybrid_jax.skills.costs import SegmentCosts, pad_costs, pad_task, segment_costs
from hybrid_jax.skills.covering import cut_segment, map_pieces
from hybrid_jax.skills.library import SkillConfig, SkillLibrary
from hybrid_jax.skills.segmentation import (
    MissingSkill,
    Plan,
    best_plans,
    missing_skills,
    optimal_plan,
)
from hybrid_jax.skills.task import Task

POINTS = 30
"""Way points of a unit segment."""
TOGETHER = 16
"""Tasks whose skills are judged in one call."""
SLOTS = 8
"""Slots of a library are judged in multiples of this: most of them are empty."""

SkillChooser = Callable[[SegmentCosts], Plan]
"""Picks segments and skills from what they cost; empty if the task cannot be covered."""


def optimal_chooser(costs: SegmentCosts) -> Plan:
    """The exact task planner (a `SkillChooser`)."""
    return optimal_plan(np.asarray(costs.cost), int(costs.count))[0]


@dataclass(frozen=True)
class SkillPath:
    """What RL-LfD makes of a task."""

    plan: Plan
    """Segments and skills, numbered from the first key pose that skills cover (see `Task.shown`);
    empty where a demonstration is missing."""
    missing: list[MissingSkill]
    """Demonstrations to give, where the plan is empty."""
    poses: np.ndarray
    """`[segment, POINTS, 8]` tool poses of each unit segment, from key pose to key pose."""


@functools.partial(jax.jit, static_argnames=("config", "slots"))
def _costs(library: SkillLibrary, poses, carrying, config: SkillConfig, slots: int) -> SegmentCosts:
    """Costs of tasks with as many key poses each; only the first slots of the library count."""
    some = library.replace(
        poses=library.poses[:slots], valid=library.valid[:slots], closed=library.closed[:slots]
    )
    judge = lambda p, c: segment_costs(some, p, c, jnp.asarray(poses.shape[1]), config)  # noqa: E731
    return jax.vmap(judge)(poses, carrying)


def _all_costs(library: SkillLibrary, tasks: list[Task], config: SkillConfig) -> list[SegmentCosts]:
    """Costs of several tasks, padded, on the host."""
    slots, padded = SLOTS * -(-len(library.names) // SLOTS), [pad_task(task) for task in tasks]
    found: dict[int, SegmentCosts] = {}
    for size in {count for *_, count in padded}:
        rows = [i for i, (*_, count) in enumerate(padded) if count == size]
        for index, count in padded_chunks(len(rows), TOGETHER):
            some = [padded[rows[i]] for i in index]
            poses, carrying = (np.stack([row[k][:size] for row in some]) for k in (0, 1))
            costs = jax.device_get(_costs(library, poses, carrying, config, slots))
            for i in range(count):
                one = jax.tree.map(lambda a, i=i: a[i], costs)
                found[rows[index[i]]] = pad_costs(one)
    return [found[i] for i in range(len(tasks))]


def skill_paths(
    library: SkillLibrary,
    tasks: list[Task],
    choose: SkillChooser,
    config: SkillConfig,
    plans: int = 1,
) -> list[list[SkillPath]]:
    """Choose skills for tasks and map them; never uses an inadmissible skill.

    Args:
        library, tasks: what there is, and what is to be done.
        choose: its plan comes first.
        config: how skills are judged and mapped.
        plans: of each task, as far as there are so many; the others are the cheapest.

    Returns:
        Of each task at least one path, with an empty plan where a demonstration is missing.
    """
    costs = _all_costs(library, tasks, config)
    chosen = [_plans(one, choose, plans) for one in costs]
    pieces = [
        [piece for a, b, k in sorted(plan)
         for piece in cut_segment(library, task.shown[0], a, b, k, config)]
        for task, some in zip(tasks, chosen, strict=True) for plan in some
    ]  # fmt: skip
    poses = map_pieces(library, list(itertools.chain(*pieces)), config, POINTS)
    each = iter(np.split(poses, np.cumsum([len(p) for p in pieces])[:-1]))
    found = []
    for task, one, some in zip(tasks, costs, chosen, strict=True):
        missing = [] if some[0] else missing_skills(
            one.cost, one.nearest, int(one.count), library.names, config.tolerance,
            first=int(task.transit),
        )  # fmt: skip
        found.append([SkillPath(plan, missing, _with_transit(task, next(each))) for plan in some])
    return found


def _with_transit(task: Task, poses: np.ndarray) -> np.ndarray:
    """The skills' poses `[segment, POINTS, 8]`, before them those of a transit where there is one.

    In a transit the tool stands where it is, and then at key pose 1: a gap for the joint agent.
    """
    if not (task.transit and len(poses)):
        return poses
    return np.concatenate([_transits(task.key_poses[:2]), poses])


def _transits(key_poses: np.ndarray) -> np.ndarray:
    """`[segment, POINTS, 8]`: the tool stands at a key pose, and is then at the next."""
    still = key_poses[:-1, None].repeat(POINTS - 1, axis=1)
    return np.concatenate([still, key_poses[1:, None]], axis=1)


def without_skills(tasks: list[Task]) -> list[list[SkillPath]]:
    """Paths of tasks that ask for no skill: every segment is a gap for the joint agent."""
    return [[SkillPath([], [], _transits(task.key_poses))] for task in tasks]


def _plans(costs: SegmentCosts, choose: SkillChooser, count: int) -> list[Plan]:
    """The chosen plan, and the cheapest others up to a number."""
    first = choose(costs)
    if count == 1 or not first:
        return [first]
    others = best_plans(costs.cost, int(costs.count), count)
    return [first, *(plan for plan in others if plan != sorted(first))][:count]


def skill_path(
    library: SkillLibrary, task: Task, choose: SkillChooser, config: SkillConfig
) -> SkillPath:
    """`skill_paths` of one task and one plan."""
    return skill_paths(library, [task], choose, config)[0][0]
