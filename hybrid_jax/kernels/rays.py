# SPDX-License-Identifier: MIT
"""Distances along rays to the cell: the paper's 25-ray sensor."""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels.argument_checks import checks
from hybrid_jax.kernels.argument_checks import pose as pose_input
from hybrid_jax.kernels.collision.primitive_kinds import (
    KINDS,
    POLYTOPE,
    PrimitiveKind,
    spans,
)
from hybrid_jax.kernels.collision.rounded_boxes import world_shapes
from hybrid_jax.runtime.kept_programs import kept
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

    def nearest(best, kind: PrimitiveKind, span: slice):
        def step(best, column):
            primitive, seen = column
            length = kind.ray(origin, components, *primitive)
            return jnp.minimum(best, jnp.where(seen > 0, length, jnp.inf)), None

        if span.start == span.stop:
            return best
        faces = cell.hulls.faces[world.hull[span]] if kind.name == POLYTOPE else None
        operands = kind.ray_operands(
            world.pose[span], world.half_extents[span], world.radius[span], faces
        )
        return jax.lax.scan(step, best, (operands, world.active[span]))[0]

    best = jnp.full(directions.shape[0], jnp.inf, directions.dtype)
    for kind, span in zip(KINDS, spans(world.counts), strict=True):
        best = nearest(best, kind, span)
    return best


@checks(pose=pose_input)
@kept
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
