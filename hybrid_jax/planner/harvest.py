# SPDX-License-Identifier: MIT
"""Collect the infeasible segments that RL-LfD leaves on random tasks (Algorithm 1, lines 4-7).

They are what the joint agent trains on, and its only training data.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from hybrid_jax.agents.segments import Segments
from hybrid_jax.errors import InputError
from hybrid_jax.planner.labelling import LabelConfig
from hybrid_jax.planner.lfd import SkillChooser, skill_paths
from hybrid_jax.planner.routing import TOGETHER, Leg, Routes, label_paths
from hybrid_jax.planner.scenes import task_scenes
from hybrid_jax.skills.library import SkillConfig, SkillLibrary
from hybrid_jax.skills.task import Task
from hybrid_jax.skills.tasks import random_task
from hybrid_jax.types import Scene, Workcell

ROUTES = 2
"""Routes of a task whose gaps are collected: the second uses none of the first one's gaps."""


def gaps_of(routes: Routes, scenes: Scene) -> list[Segments]:
    """Infeasible segments on the cheapest routes of one task."""
    found = []
    for _ in range(ROUTES):
        names = routes.cheapest()
        legs = [leg for leg in map(routes.leg, names or []) if leg.has_gap]
        found += [gap_segment(leg, scenes) for leg in legs]
        for leg in legs:
            routes.forbid(leg.name)
    return found


def gap_segment(leg: Leg, scenes: Scene) -> Segments:
    """The gap of a leg as a problem of the joint agent; one, without a leading axis."""
    scene = jax.tree.map(lambda a: a[leg.name[0]], scenes)
    return Segments(scene, leg.q[leg.first], leg.q[leg.last])


def harvest(
    cell: Workcell,
    library: SkillLibrary,
    choose: SkillChooser,
    skills: SkillConfig,
    labels: LabelConfig,
    scale: float,
    *,
    tasks: range,
    seed: int,
    progress: Callable[[int, int], None] | None = None,
) -> Segments:
    """Infeasible segments of random tasks.

    Args:
        tasks: seeds of the tasks; those used for training are never evaluated on.
        seed: draws the IK seeds.
        progress: called with (tasks done, tasks in all).

    Raises:
        InputError: no task left an infeasible segment: there is nothing to train on.
    """
    found: list[Segments] = []
    for part, first in enumerate(range(0, len(tasks), TOGETHER)):
        some = tasks[first : first + TOGETHER]
        key = jax.random.fold_in(jax.random.key(seed), part)
        found += task_gaps(
            cell, library, [random_task(cell, number) for number in some], choose, skills, labels,
            scale, key,
        )  # fmt: skip
        if progress:
            progress(first + len(some), len(tasks))
    if not found:
        raise InputError(
            f"none of {len(tasks)} random tasks left an infeasible segment to train on: either the "
            "skills alone suffice, or they cover none of these tasks. What they lack is said by: "
            "python -m hybrid_jax.check CELL --tasks 5 --skills DIR"
        )
    return jax.tree.map(lambda *leaves: jnp.asarray(np.stack(leaves)), *found)


def task_gaps(
    cell: Workcell,
    library: SkillLibrary,
    tasks: list[Task],
    choose: SkillChooser,
    skills: SkillConfig,
    labels: LabelConfig,
    scale: float,
    key,
) -> list[Segments]:
    """Infeasible segments of tasks; those without skills leave none."""
    paths = [paths[0] for paths in skill_paths(library, tasks, choose, skills)]
    covered = [(task, path) for task, path in zip(tasks, paths, strict=True) if path.plan]
    kinds = [(len(path.poses), task.end is None) for task, path in covered]
    found = []
    for number, kind in enumerate(sorted(set(kinds))):
        rows = [row for row, other in zip(covered, kinds, strict=True) if other == kind]
        scenes = [task_scenes(cell, task) for task, _ in rows]
        routes = label_paths(
            cell, [task for task, _ in rows], scenes, [path.poses for _, path in rows], scale,
            jax.random.fold_in(key, number), labels,
        )  # fmt: skip
        for one, scene in zip(routes, scenes, strict=True):
            found += gaps_of(one, scene)
    return found
