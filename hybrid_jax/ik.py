# SPDX-License-Identifier: MIT
"""Inverse kinematics by damped least squares, for one pose and many seeds at once."""

import functools
from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, PRNGKeyArray

from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels.kinematics import frame_jacobian, joint_frames, tool_frame
from hybrid_jax.types import KinematicChain, Workcell, pytree


@dataclass(frozen=True)
class IkConfig:
    """Settings of the solver."""

    seeds: int = 16
    """Starting configurations; the first is the caller's reference."""
    iterations: int = 40
    """Steps of damped least squares from each seed."""
    max_step: float = 0.4
    """Largest change of a joint in one step [rad]."""
    damping: float = 1e-4
    """Damping at a solution; it grows with the error."""
    position_tolerance: float = 1e-3
    """Largest position error of a solution [m]."""
    rotation_tolerance: float = 0.0087
    """Largest rotation error of a solution [rad] (0.5 deg)."""

    def __post_init__(self):
        if self.seeds < 1 or self.iterations < 1:
            raise ValueError(f"seeds and iterations must be at least 1, got {self}")


@pytree
class IkResult:
    """The best solution, and what every seed ended in."""

    q: Array
    """`[joint]` solution nearest to the reference; the closest approach where none was found."""
    found: Array
    """True where `q` meets both tolerances."""
    position_error: Array
    """Of `q` [m]."""
    rotation_error: Array
    """Of `q` [rad]."""
    branches: Array
    """`[seed, joint]` end of every seed."""
    branch_found: Array
    """`[seed]` True where that end is a solution."""


def pose_error(chain: KinematicChain, frames: Array, pose: Float[Array, "8"]) -> Float[Array, "6"]:
    """Position error [m] and rotation vector [rad] from the tool to a pose, world axes."""
    tool = tool_frame(chain, frames)
    turn = dq.quat_mul(pose[:4], dq.quat_conj(tool[3:]))
    return jnp.concatenate([dq.position(pose) - tool[:3], dq.quat_log(turn)])


def _solve_damped(j: Float[Array, "6 n"], error: Float[Array, "6"], damping: Array) -> Array:
    """`J^T (J J^T + damping)^-1 error`."""
    gram = j @ j.T + damping * jnp.eye(6, dtype=j.dtype)
    return j.T @ jax.scipy.linalg.cho_solve((jnp.linalg.cholesky(gram), True), error)


def descend(
    chain: KinematicChain,
    pose: Float[Array, "8"],
    seed: Float[Array, "n"],
    iterations: int,
    max_step: float,
    damping: float,
) -> tuple[Array, Array]:
    """Follow damped least-squares steps from a seed; joints stay within their limits.

    Returns:
        The configuration `[joint]` and its pose error `[6]`.
    """

    def step(_, q):
        frames = joint_frames(chain, q)
        error = pose_error(chain, frames, pose)
        j = frame_jacobian(chain, frames, tool_frame(chain, frames)[:3])
        move = _solve_damped(j, error, damping + 0.1 * jnp.sum(error * error))
        scale = jnp.minimum(1.0, max_step / jnp.maximum(jnp.max(jnp.abs(move)), 1e-9))
        return jnp.clip(q + scale * move, chain.limits[:, 0], chain.limits[:, 1])

    q = jax.lax.fori_loop(0, iterations, step, seed)
    return q, pose_error(chain, joint_frames(chain, q), pose)


def random_configurations(
    chain: KinematicChain, count: int, key: PRNGKeyArray
) -> Float[Array, "count n"]:
    """Uniform configurations within the limits; the key is consumed."""
    low, high = chain.limits.T
    return jax.random.uniform(key, (count, low.size), low.dtype, low, high)


def _unwind(chain: KinematicChain, q: Array, reference: Array) -> Array:
    """Add whole turns to hinges so that they come nearest to the reference, within limits."""
    turned = q + chain.hinge * 2 * jnp.pi * jnp.round((reference - q) / (2 * jnp.pi))
    inside = (turned >= chain.limits[:, 0]) & (turned <= chain.limits[:, 1])
    return jnp.where(inside, turned, q)


@functools.partial(jax.jit, static_argnames="config")
def solve_ik(
    cell: Workcell,
    pose: Float[Array, "8"],
    reference: Float[Array, "n"] | None = None,
    config: IkConfig = IkConfig(),
    *,
    key: PRNGKeyArray,
) -> IkResult:
    """Configurations that bring the tool to a pose, from many seeds.

    Args:
        cell: the robot; its collisions play no part here.
        pose: wanted tool pose in the world, unit dual quaternion.
        reference: first seed, and what the chosen solution is nearest to; the cell's home if None.
        config: static settings.
        key: draws the other seeds; consumed.
    """
    chain = cell.chain
    reference = cell.home if reference is None else reference
    random = random_configurations(chain, config.seeds - 1, key)
    seeds = jnp.concatenate([reference[None], random])
    q, error = jax.vmap(
        lambda seed: descend(chain, pose, seed, config.iterations, config.max_step, config.damping)
    )(seeds)
    q = jax.vmap(_unwind, (None, 0, None))(chain, q, reference)
    position = jnp.linalg.norm(error[:, :3], axis=-1)
    rotation = jnp.linalg.norm(error[:, 3:], axis=-1)
    found = (position <= config.position_tolerance) & (rotation <= config.rotation_tolerance)
    away = jnp.max(jnp.abs(q - reference), axis=-1)
    best = jnp.argmin(jnp.where(found, away, 1e3 + position + 0.3 * rotation))
    return IkResult(
        q=q[best],
        found=found[best],
        position_error=position[best],
        rotation_error=rotation[best],
        branches=q,
        branch_found=found,
    )


@functools.partial(jax.jit, static_argnames="config")
def track_poses(
    cell: Workcell,
    poses: Float[Array, "point 8"],
    start: Float[Array, "n"],
    config: IkConfig = IkConfig(iterations=12),
) -> tuple[Array, Array]:
    """Follow a path of poses from a configuration on one branch, each point warm-started.

    Returns:
        Configurations `[point, joint]` and whether each meets the tolerances `[point]`. After a
        point that is out of reach the motion goes on from the closest approach.
    """

    def step(q, pose):
        q, error = descend(cell.chain, pose, q, config.iterations, config.max_step, config.damping)
        found = (jnp.linalg.norm(error[:3]) <= config.position_tolerance) & (
            jnp.linalg.norm(error[3:]) <= config.rotation_tolerance
        )
        return q, (q, found)

    return jax.lax.scan(step, start, poses)[1]
