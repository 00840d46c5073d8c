# SPDX-License-Identifier: MIT
"""Change a scene without a new trace: put objects down, pick one up, open the gripper.

Only values change, never shapes, so compiled programs serve the new scene as well.
"""

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from hybrid_jax.errors import UnknownNameError
from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels.collision.primitive_kinds import spans
from hybrid_jax.types import PRIMITIVE_AXIS, Shapes, Workcell


def _moved(shapes: Shapes, pose: Float[Array, "n 7"]) -> Shapes:
    """Shapes, each of which is moved by its own pose (position [m], quaternion)."""
    centre = pose[:, :3] + dq.quat_rotate(pose[:, 3:], shapes.pose[:, :3])
    rotation = dq.quat_mul(pose[:, 3:], shapes.pose[:, 3:])
    return shapes.replace(pose=jnp.concatenate([centre, rotation], -1))


def place_objects(cell: Workcell, poses: Float[Array, "object 7"]) -> Workcell:
    """The cell with its movable objects at the given poses, all of them active.

    Args:
        cell: any.
        poses: `[object, 7]` in the world: position [m], quaternion.
    """
    return place_primitives(cell, jnp.asarray(poses)[cell.owners])


def place_primitives(cell: Workcell, bodies: Float[Array, "n 7"]) -> Workcell:
    """`place_objects` by the body's pose of each primitive `[n, 7]`: position [m], quaternion."""
    return cell.replace(scene=cell.scene.replace(objects=_moved(cell.objects, bodies)))


def object_index(cell: Workcell, name: str) -> int:
    """Index of an object in the cell's order.

    Raises:
        UnknownNameError: no such object.
    """
    names = cell.source.layout.object_names
    if name not in names:
        raise UnknownNameError("object", name, names)
    return names.index(name)


def attach(cell: Workcell, name: str, object_in_tool: Float[Array, "7"]) -> Workcell:
    """The cell with one object in the gripper: it counts as robot and no longer as obstacle.

    `detach` undoes it.

    Args:
        cell: with an empty gripper.
        name: of the object.
        object_in_tool: `[7]` pose of the object in the tool's frame: position [m], quaternion.

    Raises:
        UnknownNameError: no such object.
    """
    return attach_object(cell, object_index(cell, name), object_in_tool)


def attach_object(
    cell: Workcell, index: int | Array, object_in_tool: Float[Array, "7"]
) -> Workcell:
    """`attach` by the object's number `[]`."""
    slots, own = cell.scene.payload, cell.owners == index
    shapes = _moved(cell.objects, jnp.broadcast_to(object_in_tool, (cell.objects.count, 7)))
    rows = []
    for kind, free in zip(spans(shapes.counts), spans(slots.counts), strict=True):
        # the object's primitives come first; others fill the slots that it leaves empty
        own_first = jnp.argsort(~own[kind], stable=True)[: free.stop - free.start]
        rows.append(kind.start + own_first)
    row = jnp.concatenate(rows)
    filled = {name: getattr(shapes, name)[row] for name in PRIMITIVE_AXIS if name != "active"}
    payload = slots.replace(**filled, active=own[row].astype(slots.active.dtype))
    objects = cell.scene.objects
    objects = objects.replace(active=jnp.where(own, 0.0, objects.active))
    return cell.replace(scene=cell.scene.replace(objects=objects, payload=payload))


def detach(cell: Workcell, name: str, pose: Float[Array, "7"]) -> Workcell:
    """The cell with an empty gripper and the object that it held at a pose in the world.

    Args:
        cell: with the object in the gripper.
        name: of the object.
        pose: `[7]` of the object: position [m], quaternion.

    Raises:
        UnknownNameError: no such object.
    """
    own = cell.owners == object_index(cell, name)
    placed = _moved(cell.objects, jnp.broadcast_to(pose, (cell.objects.count, 7)))
    objects, payload = cell.scene.objects, cell.scene.payload
    objects = objects.replace(
        pose=jnp.where(own[:, None], placed.pose, objects.pose),
        active=jnp.where(own, 1.0, objects.active),
    )
    payload = payload.replace(active=jnp.zeros_like(payload.active))
    return cell.replace(scene=cell.scene.replace(objects=objects, payload=payload))


def with_opening(cell: Workcell, opening: float | Array) -> Workcell:
    """The cell with each finger at a distance `opening` `[]` [m] from its closed position."""
    return cell.replace(scene=cell.scene.replace(opening=jnp.asarray(opening, jnp.float32)))


def with_support(cell: Workcell, bodies: tuple[str, ...]) -> Workcell:
    """The cell in which the payload may touch the given fixtures: it stands on them.

    Args:
        cell: any.
        bodies: names of the fixtures' bodies; all others are obstacles to the payload again.

    Raises:
        UnknownNameError: no such fixture.
    """
    support_on = jnp.asarray(support_flags(cell, bodies))
    return cell.replace(scene=cell.scene.replace(support_on=support_on))


def support_flags(cell: Workcell, bodies: tuple[str, ...]) -> np.ndarray:
    """`Scene.support_on` `[fixture]` for the fixtures of some bodies, see `with_support`."""
    fixture_bodies = cell.source.fixture_bodies
    for body in bodies:
        if not body or body not in fixture_bodies:
            raise UnknownNameError("fixture", body, set(fixture_bodies) - {""})
    return np.array([body not in bodies for body in fixture_bodies], np.float32)
