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
    attach_object,
    object_index,
    place_primitives,
    support_flags,
    with_opening,
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


@kept
def kind_scenes(
    cell: Workcell,
    bodies: Float[Array, "2 n 7"],
    carried: Array,
    in_tool: Float[Array, "7"],
    openings: Float[Array, "2"],
    support_on: Float[Array, " fixture"],
) -> Scene:
    """Scenes of the four kinds of segments, stacked in their order.

    Args:
        cell: the cell, in any scene.
        bodies: `[2, n, 7]` pose of the body of each primitive of an object, at first and in the
            end: position [m], quaternion.
        carried: `[]` number of the object to be carried.
        in_tool: `[7]` the carried object in the tool: position [m], quaternion.
        openings: `[2]` opening of each finger while nothing is held, and around the object [m].
        support_on: `[fixture]` 0 for those that the object may touch where it is lifted and put
            down.

    Returns:
        Scenes with a leading axis `[kind]`.
    """
    before, after = (with_opening(place_primitives(cell, a), openings[0]).scene for a in bodies)
    held = attach_object(cell.replace(scene=before), carried, in_tool)
    lifted = with_opening(held, openings[1]).scene
    lifted = lifted.replace(support_on=jnp.ones_like(support_on))
    # the kinds of segments are indices into this order
    return stack_scenes([before, lifted.replace(support_on=support_on), after, lifted])


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
def _resting_scene(cell: Workcell, bodies: Float[Array, "n 7"], opening) -> Scene:
    """The scene with the bodies of primitives at `[n, 7]` while nothing is held."""
    return with_opening(place_primitives(cell, bodies), opening).scene


def _bodies(cell: Workcell, poses: np.ndarray) -> np.ndarray:
    """Pose `[n, 7]` of the body of each primitive, from those of the objects `[object, 7]`."""
    # empty slots have the owner -1: some pose or other
    return np.asarray(poses, np.float32).reshape(-1, 7)[list(cell.source.owners)]


def task_scenes(cell: Workcell, task: Task) -> Scene:
    """Scenes of the unit segments of a task, for the kernels.

    Returns:
        Scenes with a leading axis `[segment]`, on the host.
    """
    before = _bodies(cell, task.object_poses)
    if not any(task.carrying):
        scene = jax.device_get(_resting_scene(cell, before, np.float32(_opening(cell, task))))
        count = len(task.carrying)
        return jax.tree.map(lambda a: np.broadcast_to(a, (count, *a.shape)), scene)
    hold, index = task.require_hold(), object_index(cell, task.object_name)
    final_poses = np.array(task.object_poses, np.float32)
    final_poses[index] = task.placed_pose
    stacked = kind_scenes(
        cell,
        np.stack([before, _bodies(cell, final_poses)]),
        np.int32(index),
        np.asarray(hold.in_tool, np.float32),
        np.array([_opening(cell, task), hold.opening], np.float32),
        support_flags(cell, hold.support),
    )
    stacked, kinds = jax.device_get(stacked), segment_kinds(task)
    return jax.tree.map(lambda a: a[kinds], stacked)


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
    bodies, opening = _bodies(cell, scene.poses), np.float32(scene.opening)
    if scene.held is None:
        return cell.replace(scene=_resting_scene(cell, bodies, opening))
    scenes = kind_scenes(
        cell,
        np.stack([bodies, bodies]),
        np.int32(object_index(cell, scene.held)),
        np.asarray(scene.held_in_tool, np.float32),
        np.array([opening, opening]),
        support_flags(cell, scene.support),
    )
    return inside(cell, scenes, CARRYING)


def inside(cell: Workcell, scenes: Scene, index: int) -> Workcell:
    """The cell in one of several stacked scenes (leaves `[scene, ...]`)."""
    return cell.replace(scene=jax.tree.map(lambda a: a[index], scenes))


def stack_scenes(found: list[Scene]) -> Scene:
    """Scenes stacked along a new leading axis `[scene]`."""
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *found)
