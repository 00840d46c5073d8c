# SPDX-License-Identifier: MIT
"""The cell's primitives as the collision kernels read them: components first, batch last.

Rows are the robot's and the payload's primitives, kind by kind (`primitive_kinds`). Columns are
obstacles. In shapes `b` is the batch, or 1 for what all of it shares.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from hybrid_jax.kernels import vec3
from hybrid_jax.kernels.collision.distance import FAR
from hybrid_jax.kernels.collision.primitive_kinds import KINDS, joined_order, rows_as_boxes, spans
from hybrid_jax.kernels.kinematics import link_frames
from hybrid_jax.kernels.vec3 import Vector
from hybrid_jax.types import PRIMITIVE_AXIS, Shapes, Workcell


class RoundedBoxes(NamedTuple):
    """Boxes swept by balls, in the world: blocks for short."""

    centre: Vector
    """`[3, n, b]` [m]."""
    rotation: Vector
    """`[3, 3, n, b]`, component before axis."""
    half_extents: Vector
    """`[3, n, b]` half extents [m]."""
    extent: Vector
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
    """`[3, row, b]` as in `RoundedBoxes`."""
    radius: Array
    """`[row, b]` as in `RoundedBoxes`."""


def _concatenate(parts: list[Array], axis: int) -> Array:
    """Concatenate along a negative axis; axes before it broadcast, as shared with batched ones."""
    lead = jnp.broadcast_shapes(*(p.shape[:axis] for p in parts))
    return jnp.concatenate([jnp.broadcast_to(p, lead + p.shape[axis:]) for p in parts], axis)


def join(a: Shapes, b: Shapes) -> Shapes:
    """Two lists of primitives as one, kind by kind: those of `a` before those of `b`.

    Args:
        a, b: leaves `[n, ...]` and `[m, ...]`, or `[1 or b, n or m, ...]` in a batch.

    Returns:
        Leaves `[n + m, ...]`, after the batch axis if there is one.
    """

    def both(x, y, axis):
        by_kind = zip(spans(a.counts), spans(b.counts), strict=True)
        parts = [part for own, other in by_kind for part in ((x, own), (y, other))]
        tail = (slice(None),) * (-axis - 1)
        return _concatenate([array[(..., rows, *tail)] for array, rows in parts], axis)

    arrays = {
        name: both(getattr(a, name), getattr(b, name), axis)
        for name, axis in PRIMITIVE_AXIS.items()
    }
    return Shapes(
        **arrays,
        counts=tuple(map(sum, zip(a.counts, b.counts, strict=True))),
        all_spheres=(a.all_spheres or not a.count) and (b.all_spheres or not b.count),
    )


def world_shapes(cell: Workcell) -> Shapes:
    """Fixtures and objects in the world as one list `[n, ...]`, as `join` makes it."""
    return join(cell.fixtures, cell.scene.objects)


def world_count(cell: Workcell) -> int:
    """How many fixtures and objects there are."""
    return cell.fixtures.count + cell.scene.objects.count


def local_shapes(cell: Workcell) -> Shapes:
    """Links, fingers and payload, each in the frame that carries it: `[row, ...]`.

    Leaves of the cell may have a leading axis of 1 or b, which the result keeps.
    """
    shapes = cell.robot.shapes
    # the opening moves fingers alone: any other primitive has no stroke
    centre = shapes.pose[..., :3] + cell.scene.opening[..., None, None] * cell.robot.stroke
    opened = shapes.replace(pose=_concatenate([centre, shapes.pose[..., 3:]], -1))
    return join(opened, cell.scene.payload)


def row_links(cell: Workcell) -> Array:
    """Number `[row]` of the frame that carries each row: a joint's, or the tool's, the last one.

    A batch axis of the cell, of 1, is dropped: a batch shares its robot.
    """
    robot, payload = cell.robot.shapes, cell.scene.payload
    link = jnp.reshape(cell.robot.link, robot.count)
    tool_links = jnp.full(payload.count, cell.chain.axis.shape[-2], link.dtype)
    order = joined_order(robot.counts, payload.counts)
    return jnp.concatenate([link, tool_links])[jnp.array(order, int)]


def _radius(shapes: Shapes) -> Array:
    """Radii `[1 or b, n]` [m], so small in empty slots that these are far from everything."""
    return jnp.where(shapes.active > 0, shapes.radius, -FAR)


def _reach(rotation, half) -> list:
    """Half extents [m] of the enclosing box along the world's axes, three components."""
    return [sum(jnp.abs(rotation[i][k]) * half[k] for k in range(3)) for i in range(3)]


def world_boxes(shapes: Shapes) -> RoundedBoxes:
    """Fixtures or objects as blocks.

    Args:
        shapes: in the world, leaves `[1 or b, n, ...]`.

    Returns:
        Leaves `[..., n, 1 or b]`.
    """
    centre, rotation, half = _local(shapes)
    extent = vec3.stack(_reach(rotation, half))
    return RoundedBoxes(centre, vec3.stack(rotation), half, extent, _radius(shapes).T)


def _local(shapes: Shapes):
    """Centre `[3, n, b]` [m], rotation by components `[n, b]`, and half extents `[3, n, b]` [m]."""
    pose = jnp.moveaxis(shapes.pose, 0, -1)  # [n, 7, b]
    centre = jnp.swapaxes(pose[:, :3], 0, 1)
    rotation = vec3.quat_matrix([pose[:, 3 + i] for i in range(4)])
    return centre, rotation, jnp.moveaxis(shapes.half_extents, (0, 2), (2, 0))


def robot_rows(cell: Workcell, q: Array) -> tuple[Rows, RoundedBoxes]:
    """The robot's primitives in the world, and as blocks those that are read so.

    Args:
        cell: leaves `[1 or b, ...]`.
        q: `[b, joint]` [rad or m].

    Returns:
        All rows, leaves `[..., row, b]`, and as blocks the cover of the self pairs, then the rows
        of the kinds that are read as boxes, leaves `[..., n, b]`; see `split_blocks`.
    """
    shapes = local_shapes(cell)
    links, box_rows = row_links(cell), rows_as_boxes(row_counts(cell))
    positions, rotations = link_frames(cell.chain, q)
    positions, to_world = (jnp.take(a, links, axis=-2, mode="clip") for a in (positions, rotations))
    centre, rotation, half = _local(shapes)
    radius = _radius(shapes).T
    centre = vec3.stack(vec3.add(positions, vec3.turn(to_world, centre)))
    axes = [vec3.turn(to_world, [rotation[i][k] * half[k] for i in range(3)]) for k in range(3)]
    extent = vec3.stack([sum(jnp.abs(axis[i]) for axis in axes) for i in range(3)])
    # a capsule lies along the z axis of its frame
    rows = Rows(centre, vec3.stack(axes[2]), extent, radius)
    parts = (centre, to_world, vec3.stack(rotation), half, extent, radius)
    centre, to_world, rotation, half, extent, radius = (
        jnp.concatenate([_some(a, cover(cell)), _some(a, box_rows)], axis=-2) for a in parts
    )
    axes = [vec3.turn(to_world, rotation[:, k]) for k in range(3)]
    rotation = vec3.stack([[axes[k][i] for k in range(3)] for i in range(3)])
    return rows, RoundedBoxes(centre, rotation, half, extent, radius)


def _some(array: Array, rows: list[int] | Array) -> Array:
    """Rows `[..., n, b]` by their numbers, as slices: a CPU copies these faster than it gathers."""
    if not len(rows):
        return array[..., :0, :]
    take = functools.partial(jax.lax.dynamic_index_in_dim, array, axis=-2, keepdims=False)
    return jnp.stack([take(r) for r in rows], axis=-2)


def cover(cell: Workcell) -> Array:
    """Rows `[cover]` of the cover of the self pairs, see `ContactPairs`; as in `row_links`."""
    return jnp.reshape(cell.pairs.cover, cell.pairs.cover.shape[-1])


def split_blocks(
    cell: Workcell, blocks: RoundedBoxes
) -> tuple[RoundedBoxes, list[RoundedBoxes | None]]:
    """The blocks of `robot_rows` apart: the cover, then those of each kind; None for no boxes.

    Args:
        cell: the robot.
        blocks: leaves `[..., n, b]`.
    """
    first = cell.pairs.cover.shape[-1]
    cover_blocks = RoundedBoxes(*(a[..., :first, :] for a in blocks))
    by_kind: list[RoundedBoxes | None] = []
    for kind, count in zip(KINDS, row_counts(cell), strict=True):
        if kind.as_box:
            span = slice(first, first + count)
            by_kind.append(RoundedBoxes(*(a[..., span, :] for a in blocks)))
            first += count
        else:
            by_kind.append(None)
    return cover_blocks, by_kind


def row_counts(cell: Workcell) -> tuple[int, ...]:
    """How many rows there are of each kind."""
    robot, payload = cell.robot.shapes, cell.scene.payload
    return tuple(map(sum, zip(robot.counts, payload.counts, strict=True)))
