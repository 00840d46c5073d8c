# SPDX-License-Identifier: MIT
"""From a path of tool poses to joint paths, and which of their points are feasible.

The paper's FJ and not-FJ (section "Hybrid Motion Planning with RL based Switching Agent"). One
joint path follows the poses from where the robot is; others follow them backwards from solutions
of the last pose. The longest feasible beginning and the longest feasible end bound the part that
the joint agent has to bridge.
"""

import functools
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from hybrid_jax.ik import IkConfig, solve_ik, track_poses
from hybrid_jax.kernels.collision import clearance
from hybrid_jax.kernels.kinematics import manipulability
from hybrid_jax.types import Workcell, pytree

MAX_POINTS = 160
"""Poses that a phase is padded to: one trace for all phases."""


@dataclass(frozen=True)
class LabelConfig:
    """What makes a way point feasible."""

    margin: float = 0.004
    """Clearance to keep [m]."""
    least_manipulability: float = 0.1
    """Smallest `man'`, as a share of the map's scale."""
    max_jump: float = 0.3
    """Largest change of a joint between neighbours on one branch [rad]."""
    branches: IkConfig = IkConfig(seeds=24, iterations=50)
    """Search for end configurations."""
    tracking: IkConfig = IkConfig(iterations=8)
    """Following a path."""


@pytree
class LabelledPath:
    """One joint path along a phase's poses."""

    q: Array
    """`[point, joint]`."""
    feasible: Array
    """`[point]`."""


@dataclass(frozen=True)
class Bridge:
    """A phase's joint path and the part of it that is infeasible."""

    q: np.ndarray
    """`[point, joint]` the skill's joint path: branch of the start, then branch of the end."""
    feasible: np.ndarray
    """`[point]`."""
    first: int
    """Last point of the feasible beginning: the joint agent starts here."""
    last: int
    """First point of the feasible end: the joint agent's goal; `first` if there is no gap."""


def _judge(cell: Workcell, q: Array, found: Array, scale: Array, config: LabelConfig) -> Array:
    gap = jax.vmap(clearance, (None, 0))(cell, q)
    man = jax.vmap(manipulability, (None, 0))(cell, q)
    jump = jnp.max(jnp.abs(jnp.diff(q, axis=0, prepend=q[:1])), axis=-1)
    return (
        found
        & (gap >= config.margin)
        & (man >= config.least_manipulability * scale)
        & (jump <= config.max_jump)
    )


@functools.partial(jax.jit, static_argnames="config")
def follow(
    cell: Workcell,
    poses: Float[Array, "point 8"],
    start: Float[Array, "n"],
    scale: Array,
    config: LabelConfig,
) -> LabelledPath:
    """Joint path along the poses from a configuration, each point judged."""
    q, found = track_poses(cell, poses, start, config.tracking)
    return LabelledPath(q, _judge(cell, q, found, scale, config))


@functools.partial(jax.jit, static_argnames="config")
def end_branches(
    cell: Workcell,
    pose: Float[Array, "8"],
    reference: Float[Array, "n"],
    *,
    key,
    config: LabelConfig,
) -> tuple[Array, Array]:
    """Solutions `[seed, joint]` of a pose and whether each is free of collision `[seed]`."""
    solved = solve_ik(cell, pose, reference, config.branches, key=key)
    gap = jax.vmap(clearance, (None, 0))(cell, solved.branches)
    return solved.branches, solved.branch_found & (gap >= config.margin)


@functools.partial(jax.jit, static_argnames="config")
def _follow_backwards(cell, poses, ends, scale, config):
    back = jax.vmap(lambda q: follow(cell, poses[::-1], q, scale, config))(ends)
    return jax.tree.map(lambda a: a[:, ::-1], back)


def pad_poses(poses: np.ndarray) -> np.ndarray:
    """Repeat the last pose up to `MAX_POINTS`."""
    if len(poses) > MAX_POINTS:
        raise ValueError(f"a phase has at most {MAX_POINTS} poses, got {len(poses)}")
    return np.concatenate([poses, poses[-1:].repeat(MAX_POINTS - len(poses), 0)])


def _beginning(feasible: np.ndarray) -> int:
    """Number of leading feasible points."""
    return int(np.argmin(np.append(feasible, False)))


def _join(
    ahead: np.ndarray, back: np.ndarray, prefix: int, last: int, good: np.ndarray, max_jump: float
) -> Bridge:
    """Beginning of one joint path and end of another as one, with the part between them marked.

    Args:
        ahead: `[n, joint]` feasible up to point `prefix - 1`.
        back: `[n, joint]` feasible from point `last` on.
        good: `[n]` feasibility of `back`.
    """
    n = len(ahead)
    first = prefix - 1
    if last <= first:  # both are feasible in between: change over where they are nearest
        jumps = np.abs(ahead[last - 1 : first + 1][: n - last] - back[last : first + 2]).max(axis=1)
        change = last - 1 + int(np.argmin(jumps)) if last else 0
        first, last = change, change + 1
        if jumps.min() <= max_jump:
            return Bridge(
                np.concatenate([ahead[:last], back[last:]]), np.ones(n, bool), first, first
            )
    q = np.concatenate([ahead[:last], back[last:]])
    feasible = np.arange(n) <= first
    return Bridge(q, np.where(np.arange(n) >= last, good, feasible), first, last)


def bridges(
    cell: Workcell,
    poses: np.ndarray,
    start: np.ndarray,
    ends: np.ndarray,
    scale: float,
    config: LabelConfig,
    *,
    exact_end: bool = False,
) -> list[Bridge]:
    """Ways to run through a phase, the least infeasible first; empty where none has both ends.

    Args:
        cell: in the scene of the phase.
        poses: `[n, 8]` tool path, n at most `MAX_POINTS`.
        start: `[joint]` configuration at the first pose.
        ends: `[branch, joint]` configurations at the last pose.
        scale: manipulability that counts as 1.
        config: thresholds.
        exact_end: the phase must end in one of `ends`; else any branch of the last pose will do.
    """
    n = len(poses)
    padded = jnp.asarray(pad_poses(poses))
    ahead = jax.device_get(follow(cell, padded, jnp.asarray(start), scale, config))
    prefix = _beginning(ahead.feasible[:n])
    if prefix == 0:
        return []
    arrived = np.abs(ahead.q[n - 1] - ends).max(axis=1).min() < 0.5 * config.max_jump
    if prefix == n and (arrived or not exact_end):
        return [Bridge(ahead.q[:n], ahead.feasible[:n], n - 1, n - 1)]
    back = jax.device_get(_follow_backwards(cell, padded, jnp.asarray(ends), scale, config))
    found = []
    for q, feasible in zip(back.q[:, :n], back.feasible[:, :n], strict=True):
        last = n - _beginning(feasible[::-1])
        if last == n:
            continue
        bridge = _join(ahead.q[:n], q, prefix, max(last, 1), feasible, config.max_jump)
        away = float(np.max(np.abs(bridge.q[bridge.last] - bridge.q[bridge.first])))
        found.append(((bridge.last - bridge.first) // 8, away, bridge))
    found.sort(key=lambda item: item[:2])
    return [bridge for _, _, bridge in found]
