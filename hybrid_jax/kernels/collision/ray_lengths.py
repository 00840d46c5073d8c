# SPDX-License-Identifier: MIT
"""Length of a ray until it meets one primitive.

A direction is three components, each an array of the rays' shape or a scalar; lengths have that
shape. Origins and primitives are shared by all rays.
"""

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels.vec3 import dot, sub


def ray_capsule(origin, direction, ends, radius) -> Float[Array, "*rays"]:
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


def ray_box(
    origin, direction, pose: Float[Array, "7"], half: Float[Array, "3"]
) -> Float[Array, "*rays"]:
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


def ray_polytope(
    origin, direction, pose: Float[Array, "7"], radius, faces: Float[Array, "face 4"]
) -> Float[Array, "*rays"]:
    """Distance to a convex hull along rays [m]; infinity for a miss, from inside that to the exit.

    Each face is moved out by the radius of the ball that sweeps the hull: rays that pass an edge
    within the ball may meet it a little early.

    Args:
        origin: `[3]` where the rays start [m].
        direction: three components `[...]` of unit vectors.
        pose: `[7]` of the hull's frame in the world [m], quaternion.
        radius: `[]` of the ball [m].
        faces: `[face, 4]` outward normals and distances of the planes [m].
    """
    rotation, offset = dq.quat_matrix(pose[3:]), sub(origin, pose)
    start = [sum(offset[j] * rotation[j, i] for j in range(3)) for i in range(3)]
    slope = [sum(direction[j] * rotation[j, i] for j in range(3)) for i in range(3)]

    def cut(state, face):
        t_entry, t_exit = state
        height = dot(face, start) - face[3] - radius
        approach = dot(face, slope)
        parallel = jnp.abs(approach) < 1e-9
        t = -height / jnp.where(parallel, 1.0, approach)
        # a ray along a face is on its inner side everywhere or nowhere
        entry = jnp.where(parallel, jnp.where(height > 0, jnp.inf, -jnp.inf), t)
        t_entry = jnp.where((approach < 0) | parallel, jnp.maximum(t_entry, entry), t_entry)
        t_exit = jnp.where((approach > 0) & ~parallel, jnp.minimum(t_exit, t), t_exit)
        return (t_entry, t_exit), None

    everywhere = jnp.full_like(direction[0], jnp.inf)
    (t_entry, t_exit), _ = jax.lax.scan(cut, (-everywhere, everywhere), faces)
    return jnp.where(
        (t_entry <= t_exit) & (t_exit >= 0), jnp.where(t_entry >= 0, t_entry, t_exit), jnp.inf
    )
