# SPDX-License-Identifier: MIT
"""The cell's primitives as the collision kernels read them: components first, batch last.

Rows are the robot's and the payload's primitives, kind by kind (`primitive_kinds`). Columns are
obstacles. In shapes `b` is the batch, or 1 for what all of it shares.
"""

import functools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from hybrid_jax.kernels import vec3
from hybrid_jax.kernels.collision.distance import FAR
from hybrid_jax.kernels.collision.gjk import convex_distance
from hybrid_jax.kernels.collision.primitive_kinds import (
    KINDS,
    PAIRS,
    POLYTOPE,
    joined_order,
    kinds_of,
    rows_as_boxes,
    spans,
)
from hybrid_jax.kernels.kinematics import link_frames
from hybrid_jax.kernels.vec3 import Vector
from hybrid_jax.types import PRIMITIVE_AXIS, Shapes, Workcell


class RoundedBoxes(NamedTuple):
    """Boxes or hulls swept by balls, in the world: blocks for short."""

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
    hull: Array | None = None
    """`[n, b]` number of the hull as a float, as obstacles are picked by products; None in a cell
    without polytopes."""
    scale: Vector | None = None
    """`[3, n, b]` scales of the hull along its axes: half extents where it is the cube, else 1."""


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


def world_boxes(cell: Workcell, shapes: Shapes) -> RoundedBoxes:
    """Fixtures or objects as blocks.

    Args:
        cell: that has them.
        shapes: in the world, leaves `[1 or b, n, ...]`.

    Returns:
        Leaves `[..., n, 1 or b]`.
    """
    centre, rotation, half = _local(shapes)
    extent = vec3.stack(_reach(rotation, half))
    blocks = RoundedBoxes(centre, vec3.stack(rotation), half, extent, _radius(shapes).T)
    return blocks._replace(**_hulls(cell, shapes, half))


def has_polytopes(cell: Workcell) -> bool:
    """Are there convex hulls among the primitives? Then all of them are measured as hulls."""
    return cell.hulls.faces.shape[-3] > 0


def _hulls(cell: Workcell, shapes: Shapes, half: Array) -> dict[str, Array]:
    """`hull` and `scale` of `RoundedBoxes` where a cell has them, from half extents `[3, n, b]`."""
    if not has_polytopes(cell):
        return {}
    is_polytope = jnp.array([KINDS[k].name == POLYTOPE for k in kinds_of(shapes.counts)], bool)
    scale = jnp.where(is_polytope[:, None], 1.0, half)
    return {"hull": shapes.hull.T.astype(half.dtype), "scale": scale}


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
    links, box_rows = row_links(cell), _box_rows(cell)
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
    blocks = RoundedBoxes(centre, rotation, half, extent, radius)
    hulls = _hulls(cell, shapes, _local(shapes)[2])
    return rows, blocks._replace(
        **{
            name: jnp.concatenate([_some(a, cover(cell)), _some(a, box_rows)], axis=-2)
            for name, a in hulls.items()
        }
    )


def _box_rows(cell: Workcell) -> list[int]:
    """Rows that are measured as blocks: of some kinds, and all where there are polytopes."""
    counts = row_counts(cell)
    return list(range(sum(counts))) if has_polytopes(cell) else rows_as_boxes(counts)


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
) -> tuple[RoundedBoxes, list[tuple[slice, RoundedBoxes | None, Callable]]]:
    """The blocks of `robot_rows` apart: the cover, then those of rows that are measured alike.

    Args:
        cell: the robot.
        blocks: leaves `[..., n, b]`.

    Returns:
        The cover, and for each run of rows its span, its rows as blocks (None where they are not
        read so), and the distance of a pair, as in `primitive_kinds.PAIRS`.
    """
    first = cell.pairs.cover.shape[-1]
    part = lambda start, stop: jax.tree.map(lambda a: a[..., start:stop, :], blocks)  # noqa: E731
    if has_polytopes(cell):
        hulls = jax.tree.map(lambda a: a[0], cell.hulls)

        def measure(rows, own, block, enough: Array | float = jnp.inf):
            return convex_distance(hulls, own, block, enough)

        span = slice(0, sum(row_counts(cell)))
        return part(0, first), [(span, part(first, first + span.stop), measure)]
    cover_blocks, runs = part(0, first), []
    for kind, span in zip(KINDS, spans(row_counts(cell)), strict=True):
        count, own = span.stop - span.start, None
        if kind.as_box:
            own, first = part(first, first + count), first + count
        if count:
            runs.append((span, own, PAIRS[kind.name, "rounded box"]))
    return cover_blocks, runs


def row_counts(cell: Workcell) -> tuple[int, ...]:
    """How many rows there are of each kind."""
    robot, payload = cell.robot.shapes, cell.scene.payload
    return tuple(map(sum, zip(robot.counts, payload.counts, strict=True)))
