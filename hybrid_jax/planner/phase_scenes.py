# SPDX-License-Identifier: MIT
"""Scenes of the segments of a task: where the objects lie, what is held, what it may touch."""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from hybrid_jax.planner.trajectory_check import PhaseScene
from hybrid_jax.runtime.kept_programs import kept
from hybrid_jax.tasks.task import Task
from hybrid_jax.types import Scene, Workcell
from hybrid_jax.workcell.layout import home_qpos
from hybrid_jax.workcell.scene import (
    attach,
    object_index,
    place_objects,
    with_opening,
    with_support,
)

REACHING, CARRYING, LEAVING, TRANSFERRING = range(4)
"""Kinds of segments: before the object is held; while it is lifted or put down, and may touch its
support; once it lies in its tray; while it is held in between, and may touch nothing."""


def segment_kinds(task: Task) -> np.ndarray:
    """Kind of each unit segment of a task: `[segment]`, `REACHING` to `TRANSFERRING`."""
    held = np.array(task.carrying)
    kinds = np.where(held, CARRYING, np.where(np.cumsum(held) > 0, LEAVING, REACHING))
    # the first segment with the object lifts it and the last puts it down: both touch the support
    kinds[np.flatnonzero(held)[1:-1]] = TRANSFERRING
    return kinds


@kept(static=("name", "support"))
def kind_scenes(
    cell: Workcell,
    poses: Float[Array, "object 7"],
    put: Float[Array, "7"],
    in_tool: Float[Array, "7"],
    openings: Float[Array, "2"],
    *,
    name: str,
    support: tuple[str, ...],
) -> Scene:
    """Scenes of the four kinds of segments, stacked in their order.

    Args:
        cell: the cell, in any scene.
        poses: `[object, 7]` where the objects lie at first: position [m], quaternion.
        put: `[7]` where the carried object lies in the end.
        in_tool: `[7]` the carried object in the tool: position [m], quaternion.
        openings: `[2]` opening of each finger while nothing is held, and around the object [m].
        name: object to be carried.
        support: fixtures that it may touch where it is lifted and put down.

    Returns:
        Scenes with a leading axis `[kind]`.
    """
    cell_before = with_opening(place_objects(cell, poses), openings[0])
    held_cell = with_opening(attach(cell_before, name, in_tool), openings[1])
    final_poses = poses.at[object_index(cell, name)].set(put)
    cell_after = with_opening(place_objects(cell, final_poses), openings[0])
    on_support, lifted = with_support(held_cell, support), with_support(held_cell, ())
    # the kinds of segments are indices into this order
    return stack_scenes([c.scene for c in (cell_before, on_support, cell_after, lifted)])


def _opening_at_home(cell: Workcell) -> float:
    """Opening of each finger in the keyframe `home` [m]; 0 where there are no fingers."""
    fingers, model = cell.source.layout.fingers, cell.model
    return float(home_qpos(model)[model.jnt_qposadr[fingers[0]]]) if fingers else 0.0


def _opening(cell: Workcell, task: Task) -> float:
    """Opening of each finger while nothing is held [m]."""
    if task.opening is not None:
        return task.opening
    gripper = cell.source.task.gripper if cell.source.task else None
    return gripper.open if gripper else _opening_at_home(cell)


@kept
def _resting_scene(cell: Workcell, poses: Float[Array, "object 7"], opening: float) -> Scene:
    """The scene with objects at `poses` `[object, 7]` while nothing is held."""
    return with_opening(place_objects(cell, poses), opening).scene


def task_scenes(cell: Workcell, task: Task) -> Scene:
    """Scenes of the unit segments of a task, for the kernels.

    Returns:
        Scenes with a leading axis `[segment]`, on the host.
    """
    poses = jnp.asarray(task.object_poses, jnp.float32)
    if not any(task.carrying):
        scene = jax.device_get(_resting_scene(cell, poses, _opening(cell, task)))
        count = len(task.carrying)
        return jax.tree.map(lambda a: np.broadcast_to(a, (count, *a.shape)), scene)
    hold = task.require_hold()
    put, in_tool, openings = (
        jnp.asarray(values, jnp.float32)
        for values in (task.placed_pose, hold.in_tool, (_opening(cell, task), hold.opening))
    )
    kind_stack = kind_scenes(
        cell, poses, put, in_tool, openings, name=task.object_name, support=hold.support
    )
    kind_stack, kinds = jax.device_get(kind_stack), segment_kinds(task)
    return jax.tree.map(lambda a: a[kinds], kind_stack)


def phase_scene(cell: Workcell, task: Task, kind: int) -> PhaseScene:
    """The scene of one kind of segments, for the final check.

    The check knows nothing of the kernels' scenes (see `trajectory_check`).

    Args:
        cell: the cell of the task.
        task: what is done.
        kind: one of `REACHING`, `CARRYING`, `LEAVING`, `TRANSFERRING`.

    Returns:
        Poses of the objects `[object, 7]`, the opening, and what is held how.
    """
    poses = np.array(task.object_poses)
    if kind == LEAVING:
        index = cell.source.layout.object_names.index(task.object_name)
        poses[index] = task.placed_pose
    if kind in (REACHING, LEAVING):
        return PhaseScene(poses, _opening(cell, task), None, None, ())
    hold = task.require_hold()
    support = hold.support if kind == CARRYING else ()
    return PhaseScene(poses, hold.opening, task.object_name, hold.in_tool, support)


def home_scene(cell: Workcell) -> PhaseScene:
    """The scene of the keyframe `home`, for the final check: nothing is held."""
    qpos, addresses = home_qpos(cell.model), cell.source.layout.object_qpos
    poses = np.array([qpos[a : a + 7] for a in addresses]).reshape(-1, 7)
    return PhaseScene(poses, _opening_at_home(cell), None, None, ())


def in_scene(cell: Workcell, scene: PhaseScene) -> Workcell:
    """The cell for the kernels, in a scene that is described for the final check."""
    if cell.source.layout.object_names:
        cell = place_objects(cell, jnp.asarray(scene.poses, jnp.float32))
    cell = with_opening(cell, scene.opening)
    if scene.held is None:
        return cell
    in_tool = jnp.asarray(scene.held_in_tool, jnp.float32)
    return with_support(attach(cell, scene.held, in_tool), scene.support)


def inside(cell: Workcell, scenes: Scene, index: int) -> Workcell:
    """The cell in one of several stacked scenes (leaves `[scene, ...]`)."""
    return cell.replace(scene=jax.tree.map(lambda a: a[index], scenes))


def stack_scenes(found: list[Scene]) -> Scene:
    """Scenes stacked along a new leading axis `[scene]`."""
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *found)
