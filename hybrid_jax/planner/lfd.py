# SPDX-License-Identifier: MIT
"""RL-LfD at work: a task and a skill library become a path of tool poses (Algorithm 2, online)."""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from hybrid_jax.skills.costs import SegmentCosts, pad_task, segment_costs
from hybrid_jax.skills.covering import map_segment
from hybrid_jax.skills.library import SkillConfig, SkillLibrary
from hybrid_jax.skills.segmentation import MissingSkill, Plan, missing_skills, optimal_plan
from hybrid_jax.skills.task import Task, object_in_tool, place_pose, require_handling
from hybrid_jax.types import Scene, Workcell
from hybrid_jax.workcell import scene as scenes
from hybrid_jax.workcell.geometry import as_row, pose_of

POINTS = 50
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
    phases: list[np.ndarray]
    """Tool poses of each phase, `[n, 8]`."""


_costs = jax.jit(segment_costs, static_argnames="config")


def skill_path(
    library: SkillLibrary, task: Task, choose: SkillChooser, config: SkillConfig
) -> SkillPath:
    """Choose skills for a task and map them; never uses an inadmissible skill."""
    poses, carrying, count = pad_task(task)
    costs = jax.device_get(
        _costs(
            library, jnp.asarray(poses), jnp.asarray(carrying), jnp.asarray(count), config=config
        )
    )
    plan = choose(costs)
    if not plan:
        missing = missing_skills(costs.cost, costs.nearest, count, library.names, config.tolerance)
        return SkillPath([], missing, [])
    segments = {a: map_segment(library, poses, a, b, k, config, POINTS) for a, b, k in plan}
    starts = sorted(segments)
    phases = [
        np.concatenate([segments[a] for a in starts if low <= a < high])
        for low, high in task.phases
    ]
    return SkillPath(plan, [], phases)


def phase_cell(cell: Workcell, task: Task, carrying: bool, placed: bool) -> Workcell:
    """The cell as one phase of a task sees it.

    Args:
        cell: any scene of the cell.
        task: where the objects lie.
        carrying: the object is in the gripper.
        placed: the object already lies in its tray.
    """
    data = require_handling(cell)
    spec = data.object(task.object_name)
    index = scenes.object_index(cell, task.object_name)
    poses = np.array(task.object_poses)
    if placed:
        poses[index] = placed_pose(cell, task)
    cell = scenes.place_objects(cell, jnp.asarray(poses))
    if not carrying:
        return scenes.with_opening(cell, data.gripper.open)
    held = scenes.attach(cell, task.object_name, jnp.asarray(object_in_tool(spec), jnp.float32))
    return scenes.with_support(scenes.with_opening(held, spec.grip), task.support)


def placed_pose(cell: Workcell, task: Task) -> np.ndarray:
    """`[7]` where the object lies once it has been let go."""
    spec = require_handling(cell).object(task.object_name)
    row = object_in_tool(spec)
    return as_row(place_pose(cell, spec) * pose_of(row[:3], row[3:]))


def stack_scenes(found: list[Scene]) -> Scene:
    """Scenes with a leading axis."""
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *found)
