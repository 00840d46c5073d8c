# SPDX-License-Identifier: MIT
"""Questions to a built map: feasibility at any pose, a seed for IK, the nearest feasible pose."""

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from hybrid_jax.feasibility.building import FeasibilityMap
from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels.argument_checks import checks
from hybrid_jax.kernels.argument_checks import pose as pose_input
from hybrid_jax.runtime.kept_programs import kept

TURN_LENGTH = 0.3
"""Length that counts as one radian where positions and rotations are compared [m]."""


@checks(pose=pose_input)
@kept
def query(fmap: FeasibilityMap, pose: Float[Array, "8"]) -> tuple[Array, Array]:
    """Feasibility at a pose, and a configuration as seed for IK.

    Feasibility is trilinear in the position and that of the nearest orientation.

    Outside the grid the nearest voxel answers.

    Args:
        fmap: a built map.
        pose: `[8]` tool pose in the world, unit dual quaternion.

    Returns:
        `[]` feasibility from 0 to 1, and `[joint]` the configuration of the nearest grid pose
        [rad or m], zeros where it has none.

    Raises:
        InputError: `pose` is no rigid pose.
    """
    shape = fmap.feasibility.shape
    turn = jnp.argmax(jnp.abs(fmap.orientations @ pose[:4]))
    last = jnp.array(shape[:3]) - 1
    voxel = jnp.clip((dq.position(pose) - fmap.lower) / fmap.spacing, 0, last)
    # an axis of one voxel has no second corner: its only one counts twice, with weights 1 and 0
    corner = jnp.minimum(jnp.floor(voxel).astype(int), jnp.maximum(last - 1, 0))
    share = voxel - corner
    value = 0.0
    for bits in range(8):
        step = jnp.array([bits & 1, bits >> 1 & 1, bits >> 2])
        weight = jnp.prod(jnp.where(step == 1, share, 1 - share))
        i, j, k = jnp.minimum(corner + step, last)
        value += weight * fmap.feasibility[i, j, k, turn]
    i, j, k = jnp.round(voxel).astype(int)
    return value, fmap.configuration[i, j, k, turn]


@checks(pose=pose_input)
@kept
def nearest_feasible(fmap: FeasibilityMap, pose: Float[Array, "8"]) -> Float[Array, "8"]:
    """Nearest grid pose that is feasible.

    Args:
        fmap: a built map.
        pose: `[8]` tool pose in the world, unit dual quaternion.

    Returns:
        `[8]` unit dual quaternion; not a number where the map has no feasible pose. Positions [m]
        and angles [rad] are compared by `TURN_LENGTH`.

    Raises:
        InputError: `pose` is no rigid pose.
    """
    shape = fmap.feasibility.shape
    axes = [fmap.lower[i] + fmap.spacing * jnp.arange(shape[i]) for i in range(3)]
    points = jnp.stack(jnp.meshgrid(*axes, indexing="ij"), -1)
    distance = jnp.linalg.norm(points - dq.position(pose), axis=-1)[..., None]
    angle = 2 * jnp.arccos(jnp.clip(jnp.abs(fmap.orientations @ pose[:4]), 0, 1))
    cost = jnp.where(fmap.feasibility > 0, distance + TURN_LENGTH * angle, jnp.inf)
    i, j, k, r = jnp.unravel_index(jnp.argmin(cost), shape)
    nearest = dq.from_parts(points[i, j, k], fmap.orientations[r])
    return jnp.where(jnp.isfinite(cost[i, j, k, r]), nearest, jnp.nan)
