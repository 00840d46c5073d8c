# SPDX-License-Identifier: MIT
"""Inverse kinematics: every branch that many seeds of damped least squares find for a pose."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, PRNGKeyArray

from hybrid_jax.kernels.argument_checks import checks, configuration
from hybrid_jax.kernels.argument_checks import pose as pose_input
from hybrid_jax.kernels.batching import in_calls
from hybrid_jax.kernels.collision.clearance import clearance
from hybrid_jax.kernels.damped_least_squares import descend
from hybrid_jax.kernels.kinematics import chain_manipulability, jacobian
from hybrid_jax.runtime.kept_programs import kept
from hybrid_jax.types import KinematicChain, Record, Workcell, pytree

LANES = 16, 128, 512
"""Sizes of calls that solve for many poses: the smallest that suffices is used."""


@dataclass(frozen=True)
class IkConfig:
    """Settings of the solver."""

    seeds: int = 16
    """Starting configurations; the first is the caller's reference."""
    iterations: int = 40
    """Steps of damped least squares from each seed."""
    max_step: float = 0.4
    """Largest change of a joint in one step [rad or m]."""
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
class IkResult(Record):
    """The best solution, and what every seed ended in."""

    q: Array
    """`[joint]` the chosen solution, or the closest approach where none was found [rad or m]."""
    found: Array
    """`[]` True where `q` meets both tolerances."""
    position_error: Array
    """`[]` position error of `q` [m]."""
    rotation_error: Array
    """`[]` rotation error of `q` [rad]."""
    branches: Array
    """`[seed, joint]` configuration that every seed ended in [rad or m]."""
    branch_found: Array
    """`[seed]` True where that end is a solution."""
    branch_distinct: Array
    """`[seed]` True for the first solution of each branch."""


def random_configurations(
    chain: KinematicChain, count: int, key: PRNGKeyArray
) -> Float[Array, "count n"]:
    """Uniform configurations `[count, joint]` within the limits [rad or m]; consumes the key."""
    low, high = chain.limits.T
    return jax.random.uniform(key, (count, low.size), low.dtype, low, high)


def _unwind(chain: KinematicChain, q: Array, reference: Array) -> Array:
    """Add whole turns to hinges so that `q` `[joint]` comes nearest to the reference in limits."""
    unwound = q + chain.hinge * 2 * jnp.pi * jnp.round((reference - q) / (2 * jnp.pi))
    inside = (unwound >= chain.limits[:, 0]) & (unwound <= chain.limits[:, 1])
    return jnp.where(inside, unwound, q)


def _meets(error: Float[Array, "*b 6"], config: IkConfig) -> tuple[Array, Array, Array]:
    """Whether errors meet the tolerances, and their norms: position [m], rotation [rad]; `[*b]`."""
    position = jnp.linalg.norm(error[..., :3], axis=-1)
    rotation = jnp.linalg.norm(error[..., 3:], axis=-1)
    solved = (position <= config.position_tolerance) & (rotation <= config.rotation_tolerance)
    return solved, position, rotation


def distinct_solutions(q, found, apart: float):
    """True `[..., seed]` for solutions that no earlier solution of their pose resembles.

    Args:
        q: `[..., seed, joint]` configurations [rad or m], of JAX or NumPy.
        found: `[..., seed]` which of them are solutions.
        apart: those are the same of which no joint differs by more [rad or m].
    """
    similar = abs(q[..., :, None, :] - q[..., None, :, :]).max(axis=-1) <= apart
    earlier = np.tril(np.ones(similar.shape[-2:], bool), -1)
    return found & ~(similar & earlier & found[..., None, :]).any(axis=-1)


def _push_away(cell: Workcell, pose: Array, q: Array, config: IkConfig) -> tuple[Array, Array]:
    """Configuration and pose error after self-motion of the arm, up the slope of the clearance.

    Each step aims at the clearance that is asked for, less what would move the tool, and lands on
    the pose again with two steps of damped least squares.
    """

    def step(_, q):
        gap, slope = jax.value_and_grad(clearance, argnums=1)(cell, q)
        missing = jnp.clip(config.clearance - gap, 0.0, 0.05)
        move = slope * missing / jnp.maximum(jnp.sum(slope * slope), 1e-6)
        # the part of the step that would move the tool is taken out
        jac = jacobian(cell, q)
        multipliers = jnp.linalg.solve(jac @ jac.T + 1e-4 * jnp.eye(6), jac @ move)
        move = jnp.clip(move - jac.T @ multipliers, -config.max_step, config.max_step)
        return descend(cell.chain, pose, q + move, 2, config.max_step, config.damping)[0]

    q = jax.lax.fori_loop(0, config.push_steps, step, q)
    return descend(cell.chain, pose, q, 3, config.max_step, config.damping)


@checks(pose=pose_input, reference=configuration)
@kept(static=("config",))
def solve_ik(
    cell: Workcell,
    pose: Float[Array, "8"],
    reference: Float[Array, " n"] | None = None,
    config: IkConfig = IkConfig(),
    *,
    key: PRNGKeyArray,
) -> IkResult:
    """Configurations that bring the tool to a pose, from many seeds.

    Args:
        cell: the robot; its collisions count if `config.clearance` is given.
        pose: `[8]` target pose of the tool in the world, unit dual quaternion.
        reference: `[joint]` first seed (a warm start), and what the chosen solution is nearest to
            [rad or m]; the cell's home if None.
        config: static settings.
        key: draws the other seeds; consumed.

    Returns:
        What every seed ended in, `[seed, joint]` [rad or m], which of these are solutions, and the
        one to use `[joint]` with its errors [m, rad].

    Raises:
        InputError: `pose` is no rigid pose, or `reference` no configuration of the arm.
    """
    chain = cell.chain
    reference = cell.home if reference is None else reference
    random = random_configurations(chain, config.seeds - 1, key)
    seeds = jnp.concatenate([reference[None], random])
    settings = (config.iterations, config.max_step, config.damping)
    q, error = jax.vmap(lambda seed: descend(chain, pose, seed, *settings))(seeds)
    margin = jnp.zeros(config.seeds)
    if config.clearance is not None:
        pushed, pushed_error = jax.vmap(lambda end: _push_away(cell, pose, end, config))(q)
        gaps = jax.vmap(jax.vmap(clearance, (None, 0)), (None, 0))(cell, jnp.stack([q, pushed]))
        better = _meets(pushed_error, config)[0] & (gaps[1] > gaps[0])
        q, error = (
            jnp.where(better[:, None], new, old)
            for new, old in ((pushed, q), (pushed_error, error))
        )
        margin = jnp.minimum(jnp.where(better, gaps[1], gaps[0]) - config.clearance, 0.0)
    q = jax.vmap(_unwind, (None, 0, None))(chain, q, reference)
    solved, position, rotation = _meets(error, config)
    deviation = jnp.max(jnp.abs(q - reference), axis=-1)
    # of the solutions the one with the most of its clearance, then the one nearest to the reference
    chosen = jnp.argmin(jnp.where(solved, deviation - 1e3 * margin, jnp.inf))
    closest = jnp.argmin(position + 0.3 * rotation)
    best = jnp.where(jnp.any(solved), chosen, closest)
    return IkResult(
        q=q[best],
        found=solved[best],
        position_error=position[best],
        rotation_error=rotation[best],
        branches=q,
        branch_found=solved,
        branch_distinct=distinct_solutions(q, solved, config.distinct),
    )


@kept(static=("config",))
def track_poses(
    cell: Workcell,
    poses: Float[Array, "point 8"],
    start: Float[Array, " n"],
    config: IkConfig = IkConfig(iterations=12),
) -> tuple[Array, Array]:
    """Follow a path of poses on one branch: every point starts from the solution before it.

    Args:
        cell: the robot; collisions do not count.
        poses: `[point, 8]` target poses of the tool in the world, unit dual quaternions.
        start: `[joint]` configuration before the first point [rad or m].
        config: static settings; one seed is used.

    Returns:
        Configurations `[point, joint]` [rad or m], and whether each meets the tolerances
        `[point]`. After a point that is out of reach the motion goes on from the closest approach.
    """

    def step(q, pose):
        q, error = descend(cell.chain, pose, q, config.iterations, config.max_step, config.damping)
        return q, (q, _meets(error, config)[0])

    return jax.lax.scan(step, start, poses)[1]


def solve_from_seeds(
    chain: KinematicChain,
    poses: np.ndarray,
    seeds: np.ndarray,
    reference: np.ndarray,
    config: IkConfig,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Descend to many poses, each from a seed of its own; on the host.

    Calls of all numbers of poses, seeds and iterations share few programs.

    Args:
        chain: the arm; collisions do not count.
        poses: `[n, 8]` target poses of the tool in the world, unit dual quaternions.
        seeds: `[n, joint]` configurations to start from [rad or m].
        reference: `[joint]` hinges take the whole turns that bring them nearest to it [rad or m].
        config: iterations, steps and tolerances.

    Returns:
        Configurations `[n, joint]` [rad or m], whether each meets the tolerances `[n]`, and its
        manipulability `[n]`.
    """

    def run(rows, _):
        settings = config.iterations, config.max_step, config.damping
        return _from_seeds(chain, poses[rows], seeds[rows], reference, *settings)

    q, error, manipulabilities = in_calls(run, len(poses), LANES)
    return q, _within(error, config), manipulabilities


@kept(static=("max_step", "damping"))
def _from_seeds(chain: KinematicChain, poses, seeds, reference, iterations, max_step, damping):
    one = lambda pose, seed: descend(chain, pose, seed, iterations, max_step, damping)  # noqa: E731
    q, error = jax.vmap(one)(poses, seeds)
    q = jax.vmap(_unwind, (None, 0, None))(chain, q, reference)
    return q, error, jax.vmap(chain_manipulability, (None, 0))(chain, q)


def track_paths(
    chain: KinematicChain, poses: np.ndarray, starts: np.ndarray, config: IkConfig
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`track_poses` of many paths with equally many points; on the host.

    Args:
        chain: the arm; collisions do not count.
        poses: `[n, point, 8]` target poses of the tool in the world, unit dual quaternions.
        starts: `[n, joint]` configurations before the first points [rad or m].
        config: iterations, steps and tolerances.

    Returns:
        Configurations `[n, point, joint]` [rad or m], whether each meets the tolerances
        `[n, point]`, and its manipulability `[n, point]`.
    """

    def run(rows, _):
        settings = config.iterations, config.max_step, config.damping
        return _track(chain, poses[rows], starts[rows], *settings)

    q, error, manipulabilities = in_calls(run, len(poses), LANES)
    return q, _within(error, config), manipulabilities


@kept(static=("max_step", "damping"))
def _track(chain: KinematicChain, poses, starts, iterations, max_step, damping):
    def follow(path, start):
        def step(q, pose):
            q, error = descend(chain, pose, q, iterations, max_step, damping)
            return q, (q, error)

        q, error = jax.lax.scan(step, start, path)[1]
        return q, error, jax.vmap(chain_manipulability, (None, 0))(chain, q)

    return jax.vmap(follow)(poses, starts)


def _within(error: np.ndarray, config: IkConfig) -> np.ndarray:
    """Whether errors `[..., 6]` [m, rad] meet the tolerances, on the host."""
    position, rotation = (np.linalg.norm(part, axis=-1) for part in np.split(error, 2, axis=-1))
    return (position <= config.position_tolerance) & (rotation <= config.rotation_tolerance)
