# SPDX-License-Identifier: MIT
"""Change a scene without a new trace: put objects down, pick one up, open the gripper."""

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from hybrid_jax.errors import UnknownNameError
from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.types import Shapes, Workcell


def _moved(shapes: Shapes, capsule_pose: Array, box_pose: Array) -> Shapes:
    """Shapes moved by one pose `[7]` each."""
    ends = capsule_pose[:, None, :3] + dq.quat_rotate(
        jnp.broadcast_to(capsule_pose[:, None, 3:], (*shapes.capsule_ends.shape[:2], 4)),
        shapes.capsule_ends,
    )
    centre = box_pose[:, :3] + dq.quat_rotate(box_pose[:, 3:], shapes.box_pose[:, :3])
    turn = dq.quat_mul(box_pose[:, 3:], shapes.box_pose[:, 3:])
    return shapes.replace(capsule_ends=ends, box_pose=jnp.concatenate([centre, turn], -1))


def place_objects(cell: Workcell, poses: Float[Array, "object 7"]) -> Workcell:
    """The cell with its movable objects at the given poses (position [m], quaternion), all seen."""
    of_capsule, of_box = (jnp.array(o, int) for o in cell.source.owners)
    objects = _moved(cell.objects, poses[of_capsule], poses[of_box])
    return cell.replace(scene=cell.scene.replace(objects=objects))


def object_index(cell: Workcell, name: str) -> int:
    """Position of an object in the cell's order."""
    names = cell.source.layout.object_names
    if name not in names:
        raise UnknownNameError("object", name, names)
    return names.index(name)


def _select(shapes: Shapes, capsules: list[int], boxes: list[int], like: Shapes) -> Shapes:
    """Some slots of `shapes`, padded with the empty slots of `like`."""
    c, b = jnp.array(capsules, int), jnp.array(boxes, int)
    return Shapes(
        capsule_ends=like.capsule_ends.at[: c.size].set(shapes.capsule_ends[c]),
        capsule_radius=like.capsule_radius.at[: c.size].set(shapes.capsule_radius[c]),
        capsule_on=jnp.zeros_like(like.capsule_on).at[: c.size].set(1.0),
        box_pose=like.box_pose.at[: b.size].set(shapes.box_pose[b]),
        box_half=like.box_half.at[: b.size].set(shapes.box_half[b]),
        box_on=jnp.zeros_like(like.box_on).at[: b.size].set(1.0),
    )


def attach(cell: Workcell, name: str, object_in_tool: Float[Array, "7"]) -> Workcell:
    """The cell with one object in the gripper: it counts as robot and no longer as obstacle."""
    k = object_index(cell, name)
    capsules, boxes = ([i for i, o in enumerate(owner) if o == k] for owner in cell.source.owners)
    held = _select(cell.objects, capsules, boxes, cell.scene.payload)
    held = _moved(
        held,
        jnp.broadcast_to(object_in_tool, (held.capsule_on.size, 7)),
        jnp.broadcast_to(object_in_tool, (held.box_on.size, 7)),
    )
    objects = cell.scene.objects
    objects = objects.replace(
        capsule_on=objects.capsule_on.at[jnp.array(capsules, int)].set(0.0),
        box_on=objects.box_on.at[jnp.array(boxes, int)].set(0.0),
    )
    return cell.replace(scene=cell.scene.replace(objects=objects, payload=held))


def with_opening(cell: Workcell, opening: float | Array) -> Workcell:
    """The cell with each finger `opening` metres away from closed."""
    return cell.replace(scene=cell.scene.replace(opening=jnp.asarray(opening, jnp.float32)))


def with_support(cell: Workcell, bodies: tuple[str, ...]) -> Workcell:
    """The cell in which the payload may touch the given fixtures (it stands on them)."""
    known = cell.source.fixture_bodies
    for body in bodies:
        if body not in known:
            raise UnknownNameError("fixture", body, set(known))
    on = jnp.array([0.0 if b in bodies else 1.0 for b in known], jnp.float32)
    objects = jnp.ones(cell.scene.payload_support_on.size - on.size)
    return cell.replace(scene=cell.scene.replace(payload_support_on=jnp.concatenate([on, objects])))
