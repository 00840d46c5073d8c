# SPDX-License-Identifier: MIT
"""Distance of one pair of primitives, whichever it is: what the clearance's slope follows."""

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, Int

from hybrid_jax.kernels import vec3
from hybrid_jax.kernels.collision import distance
from hybrid_jax.kernels.collision.distance import FAR
from hybrid_jax.kernels.collision.gjk import nearest_points
from hybrid_jax.kernels.collision.primitive_kinds import KINDS, POLYTOPE, kinds_of
from hybrid_jax.kernels.collision.rounded_boxes import (
    RoundedBoxes,
    has_polytopes,
    local_shapes,
    row_links,
    world_count,
)
from hybrid_jax.kernels.kinematics import link_frames
from hybrid_jax.types import ConvexHulls, Shapes, Workcell


def _block(shapes: Shapes, position, rotation, index, hulls: bool) -> RoundedBoxes:
    """Primitive `index` in the world, by components, from the pose of the frame that carries it."""
    pose, half = shapes.pose[index], shapes.half_extents[index]
    local = vec3.quat_matrix(pose[3:])
    axes = [vec3.turn(rotation, [local[i][k] for i in range(3)]) for k in range(3)]
    turned = [[axes[k][i] for k in range(3)] for i in range(3)]
    radius = jnp.where(shapes.active[index] > 0, shapes.radius[index], -FAR)
    block = RoundedBoxes(
        vec3.add(position, vec3.turn(rotation, pose[:3])), turned, half, half, radius
    )
    if hulls:
        is_polytope = jnp.array([KINDS[k].name == POLYTOPE for k in kinds_of(shapes.counts)])[index]
        block = block._replace(hull=shapes.hull[index], scale=jnp.where(is_polytope, 1.0, half))
    return block


def _hull_distance(hulls: ConvexHulls, a: RoundedBoxes, b: RoundedBoxes) -> Array:
    """Signed distance of two hulls, whose slope is that of the points where they are nearest."""
    direction, on_a, on_b = jax.tree.map(
        jax.lax.stop_gradient, nearest_points(hulls, *jax.lax.stop_gradient((a, b)))
    )
    point_a = vec3.add(a.centre, vec3.turn(a.rotation, on_a))
    point_b = vec3.add(b.centre, vec3.turn(b.rotation, on_b))
    return vec3.dot(direction, vec3.sub(point_a, point_b)) - a.radius - b.radius


def pair_distance(
    cell: Workcell, q: Float[Array, " n"], row: Int[Array, ""], column: Int[Array, ""]
) -> Float[Array, ""]:
    """Signed distance of one pair, differentiable in `cell` and `q`.

    Args:
        cell: robot and scene.
        q: `[joint]` configuration [rad or m].
        row: `[]` number of the robot's or payload's primitive.
        column: `[]` number of the obstacle: fixtures, then objects, then the robot's own `cover`.

    Returns:
        `[]` [m].
    """
    chain, hulls = jax.tree.map(lambda a: a[None], cell.chain), has_polytopes(cell)
    positions, rotations = (a[..., 0] for a in link_frames(chain, q[None]))
    shapes, links = local_shapes(cell), row_links(cell)
    cover = jnp.append(cell.pairs.cover, 0)

    def on_robot(index):
        link = links[index]
        return _block(shapes, positions[:, link], rotations[:, :, link], index, hulls)

    obstacle = on_robot(cover[jnp.clip(column - world_count(cell), 0, cover.size - 1)])
    # indices are traced: each group is looked up, and the one that has the column is kept
    column_offset = 0
    for world_group in (cell.fixtures, cell.scene.objects):
        if world_group.count:
            selected = (column >= column_offset) & (column < column_offset + world_group.count)
            local_index = jnp.clip(column - column_offset, 0, world_group.count - 1)
            block = _block(world_group, jnp.zeros(3), jnp.eye(3), local_index, hulls)
            obstacle = jax.tree.map(
                lambda a, b, selected=selected: jnp.where(selected, a, b), block, obstacle
            )
        column_offset += world_group.count
    if hulls:
        return _hull_distance(cell.hulls, on_robot(row), obstacle)
    return distance.rounded_box_rounded_box(on_robot(row), obstacle)
