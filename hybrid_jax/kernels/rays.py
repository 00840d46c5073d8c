# SPDX-License-Identifier: MIT
"""Distance along a ray to a primitive or to the whole cell: the paper's 25-ray sensor."""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels.components import dot, sub
from hybrid_jax.kernels.inputs import checks
from hybrid_jax.kernels.inputs import pose as pose_input
from hybrid_jax.kernels.primitives import world_shapes
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
    """Distance to a capsule along a unit direction; infinity for a miss.

    From inside, the distance to where the ray leaves, as in MuJoCo.
    """
    axis, m = sub(ends[1], ends[0]), sub(origin, ends[0])
    sq = dot(axis, axis)
    sq = jnp.where(sq > 0, sq, 1.0)
    md, nd, dd = dot(m, axis), dot(direction, axis), dot(m, direction)
    a = 1 - nd * nd / sq
    usable = a > 1e-9
    b, c = dd - nd * md / sq, dot(m, m) - md * md / sq - radius * radius
    det = b * b - a * c
    root = jnp.sqrt(jnp.maximum(det, 0.0))
    best = jnp.inf
    for sign in (-1.0, 1.0):
        t = (-b + sign * root) / jnp.where(usable, a, 1.0)
        along = (md + t * nd) / sq
        on_side = usable & (det >= 0) & (along >= 0) & (along <= 1) & (t >= 0)
        best = jnp.minimum(best, jnp.where(on_side, t, jnp.inf))
    for end, outer in ((ends[0], -1.0), (ends[1], 1.0)):
        mc = sub(origin, end)
        bc, det_c = dot(mc, direction), dot(mc, mc) - radius * radius
        det_c = bc * bc - det_c
        root_c = jnp.sqrt(jnp.maximum(det_c, 0.0))
        for sign in (-1.0, 1.0):
            t = -bc + sign * root_c
            # only the half of the sphere that sticks out of the cylinder belongs to the surface
            beyond = outer * (dot(mc, axis) + t * nd) >= 0
            best = jnp.minimum(best, jnp.where((det_c >= 0) & (t >= 0) & beyond, t, jnp.inf))
    return best


def ray_box(origin, direction, pose: Float[Array, "7"], half: Array) -> Float[Array, ""]:
    """Distance to a box along a unit direction; infinity for a miss; from inside, to the exit."""
    rotation, offset = dq.quat_matrix(pose[3:]), sub(origin, pose)
    near, far = -jnp.inf, jnp.inf
    for i in range(3):
        o = sum(offset[j] * rotation[j, i] for j in range(3))
        d = sum(direction[j] * rotation[j, i] for j in range(3))
        parallel = jnp.abs(d) < 1e-9
        inverse = 1.0 / jnp.where(parallel, 1.0, d)
        t0, t1 = (-half[i] - o) * inverse, (half[i] - o) * inverse
        blocked = jnp.where(jnp.abs(o) <= half[i], -jnp.inf, jnp.inf)
        near = jnp.maximum(near, jnp.where(parallel, blocked, jnp.minimum(t0, t1)))
        far = jnp.minimum(far, jnp.where(parallel, -blocked, jnp.maximum(t0, t1)))
    return jnp.where((near <= far) & (far >= 0), jnp.where(near >= 0, near, far), jnp.inf)


def cast(
    cell: Workcell, origin: Float[Array, "3"], directions: Float[Array, "ray 3"]
) -> Float[Array, "ray"]:
    """Distances from a world point along unit directions to fixtures and objects [m]."""
    world = world_shapes(cell)
    along = [directions[:, i] for i in range(3)]

    def nearest(best, kind, columns, on):
        def step(best, column):
            primitive, seen = column
            found = kind(origin, along, *primitive)
            return jnp.minimum(best, jnp.where(seen > 0, found, jnp.inf)), None

        return jax.lax.scan(step, best, (columns, on))[0] if on.size else best

    capsules, boxes = slice(0, world.slim), slice(world.slim, None)
    axis = dq.quat_rotate(world.pose[:, 3:], world.half * jnp.array([0.0, 0.0, 1.0]))
    ends = jnp.stack([world.pose[:, :3] - axis, world.pose[:, :3] + axis], axis=1)
    best = jnp.full(directions.shape[0], jnp.inf, directions.dtype)
    best = nearest(best, ray_capsule, (ends[capsules], world.radius[capsules]), world.on[capsules])
    return nearest(best, ray_box, (world.pose[boxes], world.half[boxes]), world.on[boxes])


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
