# SPDX-License-Identifier: MIT
"""Change a scene without a new trace: put objects down, pick one up, open the gripper.

Only values change, never shapes, so compiled programs serve the new scene as well.
"""

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from hybrid_jax.errors import UnknownNameError
from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels.collision.primitive_kinds import kinds_of, spans
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
    objects = _moved(cell.objects, poses[jnp.array(cell.source.owners, int)])
    return cell.replace(scene=cell.scene.replace(objects=objects))


def object_index(cell: Workcell, name: str) -> int:
    """Index of an object in the cell's order.

    Raises:
        UnknownNameError: no such object.
    """
    names = cell.source.layout.object_names
    if name not in names:
        raise UnknownNameError("object", name, names)
    return names.index(name)


def _own(cell: Workcell, name: str) -> list[int]:
    """Indices of the primitives of one object in `Workcell.objects`."""
    k = object_index(cell, name)
    return [i for i, owner in enumerate(cell.source.owners) if owner == k]


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
    rows, slots = _own(cell, name), cell.scene.payload
    shapes = _moved(cell.objects, jnp.broadcast_to(object_in_tool, (cell.objects.count, 7)))
    kinds = kinds_of(shapes.counts)
    free = [iter(range(span.start, span.stop)) for span in spans(slots.counts)]
    # each primitive takes the next of the payload's slots for its kind
    targets = jnp.array([next(free[kinds[i]]) for i in rows], int)
    sources = jnp.array(rows, int)
    filled = {
        name: getattr(slots, name).at[targets].set(getattr(shapes, name)[sources])
        for name in PRIMITIVE_AXIS
        if name != "active"
    }
    payload = slots.replace(**filled, active=jnp.zeros_like(slots.active).at[targets].set(1.0))
    objects = cell.scene.objects
    objects = objects.replace(active=objects.active.at[jnp.array(rows, int)].set(0.0))
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
    rows = jnp.array(_own(cell, name), int)
    placed = _moved(cell.objects, jnp.broadcast_to(pose, (cell.objects.count, 7)))
    objects, payload = cell.scene.objects, cell.scene.payload
    objects = objects.replace(
        pose=objects.pose.at[rows].set(placed.pose[rows]), active=objects.active.at[rows].set(1.0)
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
    fixture_bodies = cell.source.fixture_bodies
    for body in bodies:
        if body not in fixture_bodies:
            raise UnknownNameError("fixture", body, set(fixture_bodies))
    support_on = jnp.array([0.0 if b in bodies else 1.0 for b in fixture_bodies], jnp.float32)
    return cell.replace(scene=cell.scene.replace(support_on=support_on))
