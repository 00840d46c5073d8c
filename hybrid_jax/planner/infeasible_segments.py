# SPDX-License-Identifier: MIT
"""Collect the infeasible segments that RL-LfD leaves on random tasks (Algorithm 1, lines 4-7).

They are what the joint agent trains on. Where skills leave none, as in an open cell, these are the
whole legs from key pose to key pose, which the agent may be asked for as well.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from hybrid_jax.contracts import Segments, SkillChooser
from hybrid_jax.errors import InputError
from hybrid_jax.planner.branch_selection import TASKS_PER_CALL, Leg, Routes, label_paths
from hybrid_jax.planner.key_pose_ik import PathIkConfig
from hybrid_jax.planner.lfd import skill_paths
from hybrid_jax.planner.phase_scenes import task_scenes
from hybrid_jax.runtime.terminal import remark
from hybrid_jax.skills.library import SkillConfig, SkillLibrary
from hybrid_jax.tasks.registry import random_task
from hybrid_jax.tasks.task import Task
from hybrid_jax.types import Scene, Workcell


class TaskSegments(NamedTuple):
    """Segments of some tasks, each without a leading axis: start and goal `[joint]` [rad or m]."""

    gaps: list[Segments]
    """Infeasible segments."""
    legs: list[Segments]
    """Whole legs of the cheapest routes, from key pose to key pose."""


ROUTES = 2
"""Routes of a task whose gaps are collected: the second uses none of the first one's gaps."""


def gaps_of(routes: Routes, scenes: Scene) -> list[Segments]:
    """Infeasible segments on the `ROUTES` cheapest routes of one task.

    Args:
        routes: the task's legs; those that have gaps here are forbidden in it afterwards.
        scenes: of each unit segment, leaves `[segment, ...]`.

    Returns:
        The gaps as problems of the joint agent, see `gap_segment`.
    """
    gaps = []
    for _ in range(ROUTES):
        names = routes.cheapest()
        legs = [leg for leg in map(routes.leg, names or []) if leg.has_gap]
        gaps += [gap_segment(leg, scenes) for leg in legs]
        for leg in legs:
            routes.forbid(leg.name)
    return gaps


def whole_legs(routes: Routes, scenes: Scene) -> list[Segments]:
    """The legs of a task's cheapest route as problems of the joint agent, see `gaps_of`."""
    legs = map(routes.leg, routes.cheapest() or [])
    return [_segment(leg, 0, len(leg.q) - 1, scenes) for leg in legs]


def gap_segment(leg: Leg, scenes: Scene) -> Segments:
    """The gap of a leg as one problem of the joint agent.

    Args:
        leg: the leg, which has a gap.
        scenes: of each unit segment of the task, leaves `[segment, ...]`.

    Returns:
        Scene, start `[joint]` and goal `[joint]` [rad or m], without a leading axis.
    """
    return _segment(leg, leg.first, leg.last, scenes)


def _segment(leg: Leg, first: int, last: int, scenes: Scene) -> Segments:
    scene = jax.tree.map(lambda a: a[leg.name[0]], scenes)
    return Segments(scene, leg.q[first], leg.q[last])


def harvest(
    cell: Workcell,
    library: SkillLibrary,
    choose: SkillChooser,
    skills: SkillConfig,
    labels: PathIkConfig,
    scale: float,
    *,
    tasks: range,
    seed: int,
    progress: Callable[[int, int], None] | None = None,
) -> Segments:
    """Infeasible segments of random tasks: the training data of the joint agent.

    Args:
        cell: robot and fixtures.
        library: the skills.
        choose: picks segments and skills of a task.
        skills: how skills are judged and mapped.
        labels: thresholds of feasible way points.
        scale: manipulability that counts as 1.
        tasks: seeds of the tasks; those used for training are never evaluated on.
        seed: draws the seeds of inverse kinematics.
        progress: called with (tasks done, tasks in all).

    Returns:
        All segments, stacked: start and goal `[segment, joint]` [rad or m].

    Raises:
        InputError: the skills cover no task: there is nothing to train on.
    """
    gaps: list[Segments] = []
    legs: list[Segments] = []
    for part, first in enumerate(range(0, len(tasks), TASKS_PER_CALL)):
        batch = tasks[first : first + TASKS_PER_CALL]
        key = jax.random.fold_in(jax.random.key(seed), part)
        found = task_segments(
            cell,
            library,
            [random_task(cell, number) for number in batch],
            choose,
            skills,
            labels,
            scale,
            key,
        )
        gaps, legs = gaps + found.gaps, legs + found.legs
        if progress:
            progress(first + len(batch), len(tasks))
    if not legs:
        raise InputError(
            f"the skills cover none of {len(tasks)} random tasks: there is nothing to train on. "
            "What they lack is said by: python -m hybrid_jax.check CELL --tasks 5 --skills DIR"
        )
    if not gaps:
        remark(
            f"the skills alone suffice for {len(tasks)} random tasks: in place of infeasible "
            "segments the joint agent gets whole legs from key pose to key pose"
        )
    segments = gaps or legs
    return jax.tree.map(lambda *leaves: jnp.asarray(np.stack(leaves)), *segments)


def task_segments(
    cell: Workcell,
    library: SkillLibrary,
    tasks: list[Task],
    choose: SkillChooser,
    skills: SkillConfig,
    labels: PathIkConfig,
    scale: float,
    key,
) -> TaskSegments:
    """Segments of tasks, see `harvest`. A task that skills do not cover leaves none."""
    paths = [options[0] for options in skill_paths(library, tasks, choose, skills)]
    covered = [(task, path) for task, path in zip(tasks, paths, strict=True) if path.plan]
    # tasks with equally many segments, and all with or all without an end, are labelled together
    kinds = [(len(path.poses), task.end is None) for task, path in covered]
    found = TaskSegments([], [])
    for number, kind in enumerate(sorted(set(kinds))):
        rows = [row for row, row_kind in zip(covered, kinds, strict=True) if row_kind == kind]
        scenes = [task_scenes(cell, task) for task, _ in rows]
        routes = label_paths(
            cell,
            [task for task, _ in rows],
            scenes,
            [path.poses for _, path in rows],
            scale,
            jax.random.fold_in(key, number),
            labels,
        )
        for task_routes, scene in zip(routes, scenes, strict=True):
            found.legs.extend(whole_legs(task_routes, scene))
            found.gaps.extend(gaps_of(task_routes, scene))
    return found
