# SPDX-License-Identifier: MIT
"""Distance along a ray to a primitive or to the whole cell: the paper's 25-ray sensor.

A direction is three components, each an array of the rays' shape or a scalar; distances have that
shape. Origins and primitives are shared by all rays.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels.argument_checks import checks
from hybrid_jax.kernels.argument_checks import pose as pose_input
from hybrid_jax.kernels.collision.rounded_boxes import world_shapes
from hybrid_jax.kernels.vec3 import dot, sub
from hybrid_jax.types import Workcell

RAY_COUNT = 25
"""Rays of the sensor (paper, eq. 16)."""
RAY_RANGE = 1.0
"""Length of a ray that hits nothing [m]."""


def fibonacci_directions(count: int) -> np.ndarray:
    """Evenly spread unit directions `[count, 3]` (Fibonacci sphere); the paper leaves them open."""
    k = np.arange(count) + 0.5
    z = 1 - 2 * k / count
    angle = np.pi * (1 + np.sqrt(5)) * k
    ring = np.sqrt(1 - z * z)
    return np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=-1)


_DIRECTIONS = fibonacci_directions(RAY_COUNT)


def ray_capsule(origin, direction, ends, radius) -> Float[Array, ""]:
    """Distance to a capsule along rays [m]; infinity for a miss.

    From inside, the distance to where the ray leaves, as in MuJoCo.

    Args:
        origin: `[3]` where the rays start [m].
        direction: three components `[...]` of unit vectors.
        ends: `[2, 3]` ends of the capsule's axis [m]; equal for a sphere.
        radius: of the capsule [m].

    Returns:
        `[...]` distances [m].
    """
    axis, m = sub(ends[1], ends[0]), sub(origin, ends[0])
    sq = dot(axis, axis)
    # a sphere's axis has no length: with 1 here the cylinder below is the sphere itself
    sq = jnp.where(sq > 0, sq, 1.0)
    md, nd, dd = dot(m, axis), dot(direction, axis), dot(m, direction)
    a = 1 - nd * nd / sq
    usable = a > 1e-9
    b, c = dd - nd * md / sq, dot(m, m) - md * md / sq - radius * radius
    det = b * b - a * c
    root = jnp.sqrt(jnp.maximum(det, 0.0))
    nearest = jnp.inf
    for sign in (-1.0, 1.0):
        t = (-b + sign * root) / jnp.where(usable, a, 1.0)
        share = (md + t * nd) / sq
        on_side = usable & (det >= 0) & (share >= 0) & (share <= 1) & (t >= 0)
        nearest = jnp.minimum(nearest, jnp.where(on_side, t, jnp.inf))
    for end, outer in ((ends[0], -1.0), (ends[1], 1.0)):
        m_end = sub(origin, end)
        bc, det_c = dot(m_end, direction), dot(m_end, m_end) - radius * radius
        det_c = bc * bc - det_c
        root_c = jnp.sqrt(jnp.maximum(det_c, 0.0))
        for sign in (-1.0, 1.0):
            t = -bc + sign * root_c
            # only the half of the sphere that sticks out of the cylinder belongs to the surface
            beyond = outer * (dot(m_end, axis) + t * nd) >= 0
            nearest = jnp.minimum(nearest, jnp.where((det_c >= 0) & (t >= 0) & beyond, t, jnp.inf))
    return nearest


def ray_box(origin, direction, pose: Float[Array, "7"], half: Array) -> Float[Array, ""]:
    """Distance to a box along rays [m]; infinity for a miss, and from inside that to the exit.

    Args:
        origin: `[3]` where the rays start [m].
        direction: three components `[...]` of unit vectors.
        pose: `[7]` the box's centre in the world [m], quaternion.
        half: `[3]` half extents [m].

    Returns:
        `[...]` distances [m].
    """
    rotation, offset = dq.quat_matrix(pose[3:]), sub(origin, pose)
    t_entry, t_exit = -jnp.inf, jnp.inf
    for i in range(3):
        start = sum(offset[j] * rotation[j, i] for j in range(3))
        slope = sum(direction[j] * rotation[j, i] for j in range(3))
        parallel = jnp.abs(slope) < 1e-9
        inverse = 1.0 / jnp.where(parallel, 1.0, slope)
        t0, t1 = (-half[i] - start) * inverse, (half[i] - start) * inverse
        # a ray along a slab meets it everywhere or nowhere
        blocked = jnp.where(jnp.abs(start) <= half[i], -jnp.inf, jnp.inf)
        t_entry = jnp.maximum(t_entry, jnp.where(parallel, blocked, jnp.minimum(t0, t1)))
        t_exit = jnp.minimum(t_exit, jnp.where(parallel, -blocked, jnp.maximum(t0, t1)))
    return jnp.where(
        (t_entry <= t_exit) & (t_exit >= 0), jnp.where(t_entry >= 0, t_entry, t_exit), jnp.inf
    )


def cast(
    cell: Workcell, origin: Float[Array, "3"], directions: Float[Array, "ray 3"]
) -> Float[Array, " ray"]:
    """Distances along rays to fixtures and objects; robot and payload are unseen.

    Args:
        cell: fixtures and objects.
        origin: `[3]` where the rays start, in the world [m].
        directions: `[ray, 3]` unit vectors in the world.

    Returns:
        `[ray]` distances [m]; infinity where a ray hits nothing.
    """
    world = world_shapes(cell)
    components = [directions[:, i] for i in range(3)]

    def nearest(best, kind, columns, on):
        def step(best, column):
            primitive, seen = column
            length = kind(origin, components, *primitive)
            return jnp.minimum(best, jnp.where(seen > 0, length, jnp.inf)), None

        return jax.lax.scan(step, best, (columns, on))[0] if on.size else best

    capsules, boxes = slice(0, world.capsule_count), slice(world.capsule_count, None)
    axis = dq.quat_rotate(world.pose[:, 3:], world.half_extents * jnp.array([0.0, 0.0, 1.0]))
    ends = jnp.stack([world.pose[:, :3] - axis, world.pose[:, :3] + axis], axis=1)
    best = jnp.full(directions.shape[0], jnp.inf, directions.dtype)
    best = nearest(
        best, ray_capsule, (ends[capsules], world.radius[capsules]), world.active[capsules]
    )
    return nearest(
        best, ray_box, (world.pose[boxes], world.half_extents[boxes]), world.active[boxes]
    )


@checks(pose=pose_input)
@jax.jit
def sense(cell: Workcell, pose: Float[Array, "8"]) -> Float[Array, "25"]:
    """What the paper's ray sensor sees at a tool pose; robot and payload are unseen.

    Args:
        cell: fixtures and objects.
        pose: `[8]` tool pose in the world, unit dual quaternion.

    Returns:
        `[25]` ray lengths, up to `RAY_RANGE` [m].

    Raises:
        InputError: `pose` is no rigid pose.
    """
    directions = jnp.asarray(_DIRECTIONS, pose.dtype) @ dq.quat_matrix(pose[:4]).T
    return jnp.minimum(cast(cell, dq.position(pose), directions), RAY_RANGE)
