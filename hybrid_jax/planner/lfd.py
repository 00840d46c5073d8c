# SPDX-License-Identifier: MIT
"""RL-LfD at work: a task and a skill library become a path of tool poses (Algorithm 2, online)."""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import numpy as np

from hybrid_jax.skills.costs import SegmentCosts, pad_costs, pad_task, segment_costs
from hybrid_jax.skills.covering import map_segment
from hybrid_jax.skills.library import SkillConfig, SkillLibrary
from hybrid_jax.skills.segmentation import MissingSkill, Plan, missing_skills, optimal_plan
from hybrid_jax.skills.task import Task

POINTS = 30
"""Way points of a unit segment."""

SkillChooser = Callable[[SegmentCosts], Plan]
"""Picks segments and skills from what they cost; empty if the task cannot be covered."""


def optimal_chooser(costs: SegmentCosts) -> Plan:
    """The exact task planner (a `SkillChooser`)."""
    return optimal_plan(np.asarray(costs.cost), int(costs.count))[0]


@dataclass(frozen=True)
class SkillPath:
    """What RL-LfD makes of a task."""

    plan: Plan
    """Segments and skills; empty where a demonstration is missing."""
    missing: list[MissingSkill]
    """Demonstrations to give, where the plan is empty."""
    poses: np.ndarray
    """`[segment, POINTS, 8]` tool poses of each unit segment, from key pose to key pose."""


_costs = jax.jit(segment_costs, static_argnames="config")


def skill_path(
    library: SkillLibrary, task: Task, choose: SkillChooser, config: SkillConfig
) -> SkillPath:
    """Choose skills for a task and map them; never uses an inadmissible skill."""
    poses, carrying, count = pad_task(task)
    costs = pad_costs(jax.device_get(
        _costs(library, poses[:count], carrying[:count], np.int32(count), config=config)
    ))  # fmt: skip
    plan = choose(costs)
    if not plan:
        missing = missing_skills(costs.cost, costs.nearest, count, library.names, config.tolerance)
        return SkillPath([], missing, np.zeros((0, POINTS, 8), np.float32))
    segments = [map_segment(library, poses, a, b, k, config, POINTS) for a, b, k in sorted(plan)]
    return SkillPath(plan, [], np.concatenate(segments).reshape(-1, POINTS, 8))
