# SPDX-License-Identifier: MIT
"""The cell's primitives as the collision kernels read them: components first, batch last."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from hybrid_jax.kernels import components as co
from hybrid_jax.kernels.distance import FAR
from hybrid_jax.kernels.kinematics import link_frames
from hybrid_jax.types import KinematicChain, Shapes, Workcell


class Blocks(NamedTuple):
    """Boxes swept by balls, in the world; `b` is 1 (shared) or the batch."""

    centre: Array
    """`[3, n, b]` [m]."""
    rotation: Array
    """`[3, 3, n, b]`, component before axis."""
    half: Array
    """`[3, n, b]` half extents [m]."""
    extent: Array
    """`[3, n, b]` half extents of the enclosing box along the world's axes, without the ball."""
    radius: Array
    """`[n, b]` [m]; `-FAR` for an empty slot, which is thereby `FAR` from everything."""


class Rows(NamedTuple):
    """The robot's primitives in the world, as far as bounds and capsules need them."""

    centre: Array
    """`[3, row, b]` [m]."""
    axis: Array
    """`[3, row, b]` half the axis of a capsule: from the centre to an end [m]."""
    extent: Array
    """`[3, row, b]` as in `Blocks`."""
    radius: Array
    """`[row, b]` as in `Blocks`."""


def _concatenate(parts: list[Array], axis: int) -> Array:
    """Concatenate along a negative axis; axes before it broadcast."""
    lead = jnp.broadcast_shapes(*(p.shape[:axis] for p in parts))
    return jnp.concatenate([jnp.broadcast_to(p, lead + p.shape[axis:]) for p in parts], axis)


def join(a: Shapes, b: Shapes) -> Shapes:
    """Two lists of primitives as one: capsules of both, then boxes of both."""

    def both(x, y, axis):
        parts = [(x, slice(0, a.slim)), (y, slice(0, b.slim)), (x, slice(a.slim, None)),
                 (y, slice(b.slim, None))]  # fmt: skip
        own = (slice(None),) * (-axis - 1)
        return _concatenate([array[(..., rows, *own)] for array, rows in parts], axis)

    return Shapes(
        pose=both(a.pose, b.pose, -2),
        half=both(a.half, b.half, -2),
        radius=both(a.radius, b.radius, -1),
        on=both(a.on, b.on, -1),
        slim=a.slim + b.slim,
        round=(a.round or not a.count) and (b.round or not b.count),
    )


def joined_order(slim: tuple[int, int], count: tuple[int, int]) -> list[int]:
    """Where the primitives of two joined lists come from; the second list counts on."""
    a, b = list(range(count[0])), list(range(count[0], count[0] + count[1]))
    return a[: slim[0]] + b[: slim[1]] + a[slim[0] :] + b[slim[1] :]


def world_shapes(cell: Workcell) -> Shapes:
    """Fixtures and objects, in the world."""
    return join(cell.fixtures, cell.scene.objects)


def world_count(cell: Workcell) -> int:
    """How many fixtures and objects there are."""
    return cell.fixtures.count + cell.scene.objects.count


def local_shapes(cell: Workcell) -> Shapes:
    """Links, fingers and payload, each in the frame that carries it."""
    shapes = cell.robot.shapes
    centre = shapes.pose[..., :3] + cell.scene.opening[..., None, None] * cell.robot.stroke
    moved = shapes.replace(pose=_concatenate([centre, shapes.pose[..., 3:]], -1))
    return join(moved, cell.scene.payload)


def row_links(cell: Workcell) -> list[int]:
    """Frame that carries each row: a joint's, or the tool's for the payload."""
    robot, payload = cell.robot.shapes, cell.scene.payload
    own = list(cell.robot.link)
    tool = [_joints(cell.chain)] * payload.count
    order = joined_order((robot.slim, payload.slim), (len(own), len(tool)))
    return [(own + tool)[i] for i in order]


def _joints(chain: KinematicChain) -> int:
    return chain.axis.shape[-2]


def _radius(shapes: Shapes) -> Array:
    return jnp.where(shapes.on > 0, shapes.radius, -FAR)


def _reach(rotation, half) -> list:
    """Half extents of the enclosing box along the world's axes."""
    return [sum(jnp.abs(rotation[i][k]) * half[k] for k in range(3)) for i in range(3)]


def world_blocks(shapes: Shapes) -> Blocks:
    """Fixtures or objects; leaves carry a leading axis of 1 or b."""
    centre, rotation, half = _local(shapes)
    extent = co.stack(_reach(rotation, half))
    return Blocks(centre, co.stack(rotation), half, extent, _radius(shapes).T)


def _local(shapes: Shapes):
    """Centre, rotation by components and half extents, batch last."""
    pose = jnp.moveaxis(shapes.pose, 0, -1)  # [n, 7, b]
    centre = jnp.swapaxes(pose[:, :3], 0, 1)
    rotation = co.quat_matrix([pose[:, 3 + i] for i in range(4)])
    return centre, rotation, jnp.moveaxis(shapes.half, (0, 2), (2, 0))


def robot_rows(cell: Workcell, q: Array) -> tuple[Rows, Blocks]:
    """The robot's primitives in the world, and those of them that bounds alone do not serve.

    Args:
        cell: leaves `[1 or b, ...]`.
        q: `[b, joint]`.

    Returns:
        All rows, and as blocks the rows of `block_rows`.
    """
    shapes = local_shapes(cell)
    links, wanted = jnp.array(row_links(cell)), block_rows(cell)
    place, rotations = link_frames(cell.chain, q)
    place, turn = (jnp.take(a, links, axis=-2, mode="clip") for a in (place, rotations))
    centre, rotation, half = _local(shapes)
    radius = _radius(shapes).T
    centre = co.stack(co.add(place, co.turn(turn, centre)))
    axes = [co.turn(turn, [rotation[i][k] * half[k] for i in range(3)]) for k in range(3)]
    extent = co.stack([sum(jnp.abs(axis[i]) for axis in axes) for i in range(3)])
    rows = Rows(centre, co.stack(axes[2]), extent, radius)
    parts = (centre, turn, co.stack(rotation), half, extent, radius)
    centre, turn, rotation, half, extent, radius = (_some(a, wanted) for a in parts)
    axes = [co.turn(turn, rotation[:, k]) for k in range(3)]
    rotation = co.stack([[axes[k][i] for k in range(3)] for i in range(3)])
    return rows, Blocks(centre, rotation, half, extent, radius)


def _some(array: Array, rows: list[int]) -> Array:
    """Some rows by slices, which a CPU copies faster than it gathers."""
    if not rows:
        return array[..., :0, :]
    return jnp.stack([array[..., r, :] for r in rows], axis=-2)


def block_rows(cell: Workcell) -> list[int]:
    """Rows that are needed whole: the cover of the self pairs, then boxes."""
    slim = cell.robot.shapes.slim + cell.scene.payload.slim
    count = cell.robot.shapes.count + cell.scene.payload.count
    return list(cell.pairs.cover) + list(range(slim, count))
