# SPDX-License-Identifier: MIT
"""Questions to a built map: feasibility at any pose, a seed for IK, the nearest feasible pose."""

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from hybrid_jax.feasibility.building import FeasibilityMap
from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels.inputs import checks
from hybrid_jax.kernels.inputs import pose as pose_input

TURN_LENGTH = 0.3
"""Length that counts as one radian where positions and rotations are compared [m]."""


@checks(pose=pose_input)
@jax.jit
def query(fmap: FeasibilityMap, pose: Float[Array, "8"]) -> tuple[Array, Array]:
    """Feasibility at a pose: trilinear in position, nearest orientation; and its best seed.

    Outside the grid the nearest voxel answers.

    Args:
        fmap: a built map.
        pose: `[8]` tool pose in the world, unit dual quaternion.

    Returns:
        `[]` feasibility from 0 to 1, and `[joint]` the configuration of the nearest grid pose
        [rad], zeros where it has none.

    Raises:
        InputError: `pose` is no rigid pose.
    """
    shape = fmap.feasibility.shape
    turn = jnp.argmax(jnp.abs(fmap.orientations @ pose[:4]))
    last = jnp.array(shape[:3]) - 1
    place = jnp.clip((dq.position(pose) - fmap.lower) / fmap.spacing, 0, last)
    corner = jnp.minimum(jnp.floor(place).astype(int), jnp.maximum(last - 1, 0))
    share = place - corner
    value = 0.0
    for bits in range(8):
        step = jnp.array([bits & 1, bits >> 1 & 1, bits >> 2])
        weight = jnp.prod(jnp.where(step == 1, share, 1 - share))
        i, j, k = jnp.minimum(corner + step, last)
        value += weight * fmap.feasibility[i, j, k, turn]
    i, j, k = jnp.round(place).astype(int)
    return value, fmap.configuration[i, j, k, turn]


@checks(pose=pose_input)
@jax.jit
def nearest_feasible(fmap: FeasibilityMap, pose: Float[Array, "8"]) -> Float[Array, "8"]:
    """Grid pose with positive feasibility that is nearest to a pose.

    Args:
        fmap: a built map.
        pose: `[8]` tool pose in the world, unit dual quaternion.

    Returns:
        `[8]` unit dual quaternion; positions and rotations are compared by `TURN_LENGTH` [m].

    Raises:
        InputError: `pose` is no rigid pose.
    """
    shape = fmap.feasibility.shape
    axes = [fmap.lower[i] + fmap.spacing * jnp.arange(shape[i]) for i in range(3)]
    points = jnp.stack(jnp.meshgrid(*axes, indexing="ij"), -1)
    away = jnp.linalg.norm(points - dq.position(pose), axis=-1)[..., None]
    angle = 2 * jnp.arccos(jnp.clip(jnp.abs(fmap.orientations @ pose[:4]), 0, 1))
    cost = jnp.where(fmap.feasibility > 0, away + TURN_LENGTH * angle, jnp.inf)
    i, j, k, r = jnp.unravel_index(jnp.argmin(cost), shape)
    return dq.from_parts(points[i, j, k], fmap.orientations[r])
