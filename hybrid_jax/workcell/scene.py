# SPDX-License-Identifier: MIT
"""Change a scene without a new trace: put objects down, pick one up, open the gripper."""

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from hybrid_jax.errors import UnknownNameError
from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.types import Shapes, Workcell


def _moved(shapes: Shapes, pose: Float[Array, "n 7"]) -> Shapes:
    """Shapes moved by one pose each."""
    centre = pose[:, :3] + dq.quat_rotate(pose[:, 3:], shapes.pose[:, :3])
    turn = dq.quat_mul(pose[:, 3:], shapes.pose[:, 3:])
    return shapes.replace(pose=jnp.concatenate([centre, turn], -1))


def place_objects(cell: Workcell, poses: Float[Array, "object 7"]) -> Workcell:
    """The cell with its movable objects at the given poses (position [m], quaternion), all seen."""
    objects = _moved(cell.objects, poses[jnp.array(cell.source.owners, int)])
    return cell.replace(scene=cell.scene.replace(objects=objects))


def object_index(cell: Workcell, name: str) -> int:
    """Position of an object in the cell's order."""
    names = cell.source.layout.object_names
    if name not in names:
        raise UnknownNameError("object", name, names)
    return names.index(name)


def _own(cell: Workcell, name: str) -> list[int]:
    """Primitives of one object."""
    k = object_index(cell, name)
    return [i for i, owner in enumerate(cell.source.owners) if owner == k]


def attach(cell: Workcell, name: str, object_in_tool: Float[Array, "7"]) -> Workcell:
    """The cell with one object in the gripper: it counts as robot and no longer as obstacle.

    `detach` undoes it. The compiled programs stay: only the values of the scene change.
    """
    mine, empty, slots = _own(cell, name), cell.scene.payload, cell.scene.payload.slim
    shapes = _moved(cell.objects, jnp.broadcast_to(object_in_tool, (cell.objects.count, 7)))
    slim = [i for i in mine if i < shapes.slim]
    boxes = [i for i in mine if i >= shapes.slim]
    into = jnp.array(list(range(len(slim))) + [slots + i for i in range(len(boxes))], int)
    taken = jnp.array(slim + boxes, int)
    payload = empty.replace(
        pose=empty.pose.at[into].set(shapes.pose[taken]),
        half=empty.half.at[into].set(shapes.half[taken]),
        radius=empty.radius.at[into].set(shapes.radius[taken]),
        on=jnp.zeros_like(empty.on).at[into].set(1.0),
    )
    objects = cell.scene.objects
    objects = objects.replace(on=objects.on.at[jnp.array(mine, int)].set(0.0))
    return cell.replace(scene=cell.scene.replace(objects=objects, payload=payload))


def detach(cell: Workcell, name: str, pose: Float[Array, "7"]) -> Workcell:
    """The cell with an empty gripper and the object that it held standing at a pose."""
    mine = jnp.array(_own(cell, name), int)
    put = _moved(cell.objects, jnp.broadcast_to(pose, (cell.objects.count, 7)))
    objects, payload = cell.scene.objects, cell.scene.payload
    objects = objects.replace(
        pose=objects.pose.at[mine].set(put.pose[mine]), on=objects.on.at[mine].set(1.0)
    )
    payload = payload.replace(on=jnp.zeros_like(payload.on))
    return cell.replace(scene=cell.scene.replace(objects=objects, payload=payload))


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
    return cell.replace(scene=cell.scene.replace(support_on=on))
