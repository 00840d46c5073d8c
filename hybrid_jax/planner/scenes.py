# SPDX-License-Identifier: MIT
"""What the cell looks like in each phase of a task: what is held, what already lies in its tray."""

import functools

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jax import Array
from jaxtyping import Float

from hybrid_jax.planner.checking import PhaseScene, pose_row
from hybrid_jax.skills.handling import object_in_tool, require_handling
from hybrid_jax.skills.scenes import require_task_data
from hybrid_jax.skills.task import Task
from hybrid_jax.types import Scene, Workcell
from hybrid_jax.workcell import scene as scenes
from hybrid_jax.workcell.layout import home_qpos

REACHING, CARRYING, LEAVING, TRANSFERRING = range(4)
"""Kinds of segments: before the object is held; while it is held beside what it is lifted from or
put on, which it may touch; once it lies in its tray; while it is held in between."""


def segment_kinds(task: Task) -> np.ndarray:
    """Kind of each unit segment `[segment]`."""
    held = np.array(task.carrying)
    kinds = np.where(held, CARRYING, np.where(np.cumsum(held) > 0, LEAVING, REACHING))
    kinds[np.flatnonzero(held)[1:-1]] = TRANSFERRING
    return kinds


def placed_pose(cell: Workcell, task: Task) -> np.ndarray:
    """`[7]` where the object of a task that carries lies once it has been let go."""
    last = task.key_poses[1 + int(np.flatnonzero(task.carrying)[-1])]
    hangs = object_in_tool(require_handling(cell).object(task.object_name), task.grasp)
    tool, place, quat = pose_row(last), np.empty(3), np.empty(4)
    mujoco.mju_mulPose(place, quat, tool[:3], tool[3:], hangs[:3], hangs[3:])
    return np.concatenate([place, quat])


@functools.partial(jax.jit, static_argnames=("name", "grasp", "support"))
def kind_scenes(
    cell: Workcell,
    poses: Float[Array, "object 7"],
    put: Float[Array, "7"],
    *,
    name: str,
    grasp: int,
    support: tuple[str, ...],
) -> Scene:
    """Scenes of the kinds of segments, stacked in their order.

    Args:
        cell: any scene of the cell.
        poses: where the objects lie at first.
        put: where the carried one lies in the end.
        name: object to be carried.
        grasp: which of its grasps is used.
        support: fixtures that it may touch where it is lifted and put down.
    """
    data = require_handling(cell)
    spec, index = data.object(name), scenes.object_index(cell, name)
    before = scenes.with_opening(scenes.place_objects(cell, poses), data.gripper.open)
    hangs = jnp.asarray(object_in_tool(spec, grasp), jnp.float32)
    held = scenes.with_opening(scenes.attach(before, name, hangs), spec.grip)
    moved = poses.at[index].set(put)
    after = scenes.with_opening(scenes.place_objects(cell, moved), data.gripper.open)
    low, high = scenes.with_support(held, support), scenes.with_support(held, ())
    return stack_scenes([c.scene for c in (before, low, after, high)])


def _open(cell: Workcell) -> float:
    """How far a finger is open where nothing is held [m]; 0 where there is no gripper."""
    gripper = require_task_data(cell).gripper
    return gripper.open if gripper else 0.0


@jax.jit
def _resting_scene(cell: Workcell, poses: Float[Array, "object 7"]) -> Scene:
    """Nothing is held."""
    return scenes.with_opening(scenes.place_objects(cell, poses), _open(cell)).scene


def task_scenes(cell: Workcell, task: Task) -> Scene:
    """Scene of every unit segment of a task, stacked."""
    poses = jnp.asarray(task.object_poses, jnp.float32)
    if not any(task.carrying):
        one, count = jax.device_get(_resting_scene(cell, poses)), len(task.carrying)
        return jax.tree.map(lambda a: np.broadcast_to(a, (count, *a.shape)), one)
    put = jnp.asarray(placed_pose(cell, task), jnp.float32)
    found = kind_scenes(
        cell, poses, put, name=task.object_name, grasp=task.grasp, support=task.support
    )
    found, kinds = jax.device_get(found), segment_kinds(task)
    return jax.tree.map(lambda a: a[kinds], found)


def phase_scene(cell: Workcell, task: Task, kind: int) -> PhaseScene:
    """The same for the final check, which knows nothing of the kernels' scenes."""
    poses = np.array(task.object_poses)
    if kind == LEAVING:
        index = cell.source.layout.object_names.index(task.object_name)
        poses[index] = placed_pose(cell, task)
    if kind in (REACHING, LEAVING):
        return PhaseScene(poses, _open(cell), None, None, ())
    spec = require_handling(cell).object(task.object_name)
    held, support = object_in_tool(spec, task.grasp), task.support if kind == CARRYING else ()
    return PhaseScene(poses, spec.grip, task.object_name, held, support)


def home_scene(cell: Workcell) -> PhaseScene:
    """Objects and fingers as they are in the keyframe `home`; nothing is held."""
    qpos, layout, model = home_qpos(cell.model), cell.source.layout, cell.model
    poses = np.array([qpos[a : a + 7] for a in layout.object_qpos]).reshape(-1, 7)
    fingers = [float(qpos[model.jnt_qposadr[j]]) for j in layout.fingers]
    return PhaseScene(poses, fingers[0] if fingers else 0.0, None, None, ())


def in_scene(cell: Workcell, scene: PhaseScene) -> Workcell:
    """The cell for the kernels, in a scene that is described for the engine."""
    if cell.source.layout.object_names:
        cell = scenes.place_objects(cell, jnp.asarray(scene.poses, jnp.float32))
    cell = scenes.with_opening(cell, scene.opening)
    if scene.held is None:
        return cell
    held = jnp.asarray(scene.held_in_tool, jnp.float32)
    return scenes.with_support(scenes.attach(cell, scene.held, held), scene.support)


def inside(cell: Workcell, scenes: Scene, index: int) -> Workcell:
    """The cell in one of several stacked scenes."""
    return cell.replace(scene=jax.tree.map(lambda a: a[index], scenes))


def stack_scenes(found: list[Scene]) -> Scene:
    """Scenes with a leading axis."""
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *found)
