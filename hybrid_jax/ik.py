# SPDX-License-Identifier: MIT
"""Inverse kinematics: every branch that many seeds of damped least squares find for a pose."""

import functools
from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, PRNGKeyArray

from hybrid_jax.kernels.collision import clearance
from hybrid_jax.kernels.descent import descend
from hybrid_jax.kernels.inputs import checks, configuration
from hybrid_jax.kernels.inputs import pose as pose_input
from hybrid_jax.kernels.kinematics import jacobian
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
    clearance: float | None = None
    """Clearance that solutions are pushed towards by self-motion, and that the chosen one keeps
    if any does [m]; None leaves collisions out."""
    push_steps: int = 12
    """Steps of that self-motion."""
    distinct: float = 0.1
    """Solutions are the same branch if no joint differs by more [rad or m]."""

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
    branch_distinct: Array
    """`[seed]` True for the first solution of each branch."""


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


def _meets(error: Float[Array, "*b 6"], config: IkConfig) -> tuple[Array, Array, Array]:
    """Is it a solution, and its position and rotation error."""
    position = jnp.linalg.norm(error[..., :3], axis=-1)
    rotation = jnp.linalg.norm(error[..., 3:], axis=-1)
    found = (position <= config.position_tolerance) & (rotation <= config.rotation_tolerance)
    return found, position, rotation


def _distinct(q: Float[Array, "seed n"], found: Array, apart: float) -> Array:
    """True for solutions that no earlier solution resembles."""
    near = jnp.max(jnp.abs(q[:, None] - q[None]), axis=-1) <= apart
    return found & ~jnp.any(jnp.tril(near, -1) & found[None], axis=1)


def _push_away(cell: Workcell, pose: Array, q: Array, config: IkConfig) -> tuple[Array, Array]:
    """Move along the self-motion of the arm, up the slope of the clearance; and the pose error.

    Each step aims at the wanted clearance, less what would move the tool, and lands on the pose
    again with two steps of damped least squares.
    """

    def step(_, q):
        gap, slope = jax.value_and_grad(clearance, argnums=1)(cell, q)
        short = jnp.clip(config.clearance - gap, 0.0, 0.05)
        move = slope * short / jnp.maximum(jnp.sum(slope * slope), 1e-6)
        j = jacobian(cell, q)
        tool = jnp.linalg.solve(j @ j.T + 1e-4 * jnp.eye(6), j @ move)
        move = jnp.clip(move - j.T @ tool, -config.max_step, config.max_step)
        return descend(cell.chain, pose, q + move, 2, config.max_step, config.damping)[0]

    q = jax.lax.fori_loop(0, config.push_steps, step, q)
    return descend(cell.chain, pose, q, 3, config.max_step, config.damping)


@checks(pose=pose_input, reference=configuration)
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
        cell: the robot; its collisions count if `config.clearance` is given.
        pose: `[8]` wanted tool pose in the world, unit dual quaternion.
        reference: `[joint]` first seed (a warm start), and what the chosen solution is nearest to;
            the cell's home if None.
        config: static settings.
        key: draws the other seeds; consumed.

    Returns:
        Solutions `[seed, joint]` [rad] with errors [m, rad] and clearances [m], and the one to use.

    Raises:
        InputError: `pose` is no rigid pose, or `reference` no configuration of the arm.
    """
    chain = cell.chain
    reference = cell.home if reference is None else reference
    random = random_configurations(chain, config.seeds - 1, key)
    seeds = jnp.concatenate([reference[None], random])
    settings = (config.iterations, config.max_step, config.damping)
    q, error = jax.vmap(lambda seed: descend(chain, pose, seed, *settings))(seeds)
    gap = jnp.zeros(config.seeds)
    if config.clearance is not None:
        moved, moved_error = jax.vmap(lambda one: _push_away(cell, pose, one, config))(q)
        gaps = jax.vmap(jax.vmap(clearance, (None, 0)), (None, 0))(cell, jnp.stack([q, moved]))
        better = _meets(moved_error, config)[0] & (gaps[1] > gaps[0])
        q, error = (
            jnp.where(better[:, None], new, old) for new, old in ((moved, q), (moved_error, error))
        )
        gap = jnp.minimum(jnp.where(better, gaps[1], gaps[0]) - config.clearance, 0.0)
    q = jax.vmap(_unwind, (None, 0, None))(chain, q, reference)
    found, position, rotation = _meets(error, config)
    away = jnp.max(jnp.abs(q - reference), axis=-1)
    # first the pose, then the clearance that is missing, then the distance from the reference
    score = jnp.where(found, away - 1e3 * gap, 1e6 + position + 0.3 * rotation)
    best = jnp.argmin(score)
    return IkResult(
        q=q[best],
        found=found[best],
        position_error=position[best],
        rotation_error=rotation[best],
        branches=q,
        branch_found=found,
        branch_distinct=_distinct(q, found, config.distinct),
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
        return q, (q, _meets(error, config)[0])

    return jax.lax.scan(step, start, poses)[1]
