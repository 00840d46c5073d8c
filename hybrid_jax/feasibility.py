# SPDX-License-Identifier: MIT
"""The SE(3) feasibility map of a work cell (paper, section "Integrated Feasibility Map").

A grid of positions times a set of tool orientations; for each pose IK from several seeds, limits,
collision and manipulability, and the reason where it fails.
"""

import enum
import functools
import itertools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from hybrid_jax import artifacts
from hybrid_jax.ik import IkConfig, descend, solve_ik
from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels.collision import clearances
from hybrid_jax.kernels.kinematics import manipulability
from hybrid_jax.types import Workcell, pytree


class Reason(enum.IntEnum):
    """Why a pose is (not) feasible, from best to worst explained."""

    FEASIBLE = 0
    NEAR_SINGULAR = 1
    CELL_COLLISION = 2
    SELF_COLLISION = 3
    JOINT_LIMIT = 4
    UNREACHABLE = 5


@dataclass(frozen=True)
class MapConfig:
    """Grid and thresholds of the map."""

    lower: tuple[float, float, float] = (-0.1, -0.75, 0.05)
    """Centre of the first voxel [m]."""
    upper: tuple[float, float, float] = (0.75, 0.75, 0.75)
    """No centre beyond this [m]."""
    spacing: float = 0.1
    """Edge of a voxel [m]."""
    tilts: tuple[float, ...] = (-0.6, 0.0, 0.6)
    """Euler angles about the tool's x and y axes, from pointing down [rad]."""
    yaws: tuple[float, ...] = (-1.5, -0.75, 0.0, 0.75)
    """Euler angles about the vertical [rad]."""
    ik: IkConfig = IkConfig(seeds=4, iterations=30)
    margin: float = 0.0
    """Clearance that a feasible configuration keeps [m]."""
    least_manipulability: float = 0.1
    """Smallest `man'` of a feasible pose, as a share of the map's 95th percentile."""
    chunk: int = 1024
    """Poses per call of the compiled program."""

    def __post_init__(self):
        if self.spacing <= 0 or any(u < v for u, v in zip(self.upper, self.lower, strict=True)):
            raise ValueError(
                f"the grid is empty: lower {self.lower}, upper {self.upper}, spacing {self.spacing}"
            )

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Voxels along x, y, z and orientations."""
        counts = [
            int((u - v) / self.spacing + 1e-6) + 1
            for u, v in zip(self.upper, self.lower, strict=True)
        ]
        return counts[0], counts[1], counts[2], len(self.tilts) ** 2 * len(self.yaws)


@pytree
class FeasibilityMap:
    """A built map; the grid axes come first: `[x, y, z, orientation]`."""

    lower: Array
    """`[3]` centre of the first voxel [m]."""
    spacing: Array
    """Edge of a voxel [m]."""
    orientations: Array
    """`[orientation, 4]` quaternions."""
    feasibility: Array
    """`fea` in [0, 1]: reachable * man' * collision-free; 0 where infeasible."""
    reason: Array
    """`Reason` of each pose, uint8."""
    configuration: Array
    """`[..., joint]` best configuration, a seed for IK."""
    manipulability_scale: Array
    """95th percentile of the manipulability of collision-free poses: `man' = man / scale`."""


def down_orientations(config: MapConfig) -> np.ndarray:
    """`[orientation, 4]` tool-down orientations turned over the Euler box of the configuration."""
    down = jnp.array([0.0, 1.0, 0.0, 0.0])
    turns = []
    for yaw, about_x, about_y in itertools.product(config.yaws, config.tilts, config.tilts):
        axes = [
            dq.quat_exp(jnp.array(v))
            for v in ((0.0, 0.0, yaw), (about_x, 0.0, 0.0), (0.0, about_y, 0.0))
        ]
        turns.append(dq.quat_mul(dq.quat_mul(dq.quat_mul(axes[0], axes[1]), axes[2]), down))
    return np.asarray(jnp.stack(turns))


def grid_poses(config: MapConfig) -> np.ndarray:
    """`[pose, 8]` every pose of the map, orientation fastest."""
    axes = [config.lower[i] + config.spacing * np.arange(config.shape[i]) for i in range(3)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    quats = down_orientations(config)
    return np.asarray(
        dq.from_parts(
            jnp.asarray(np.repeat(points, len(quats), axis=0), jnp.float32),
            jnp.asarray(np.tile(quats, (len(points), 1)), jnp.float32),
        )
    )


@functools.partial(jax.jit, static_argnames="config")
def assess_pose(cell: Workcell, pose: Float[Array, "8"], key, config: MapConfig):
    """Judge one pose: reason (singularity aside), manipulability, clearance, configuration."""
    solved = solve_ik(cell, pose, config=config.ik, key=key)
    gaps = jax.vmap(clearances, (None, 0))(cell, solved.branches)
    man = jax.vmap(manipulability, (None, 0))(cell, solved.branches)
    gap = jnp.min(gaps, axis=-1)
    free = solved.branch_found & (gap >= config.margin)
    best = jnp.argmax(jnp.where(free, 1e3 + man, jnp.where(solved.branch_found, gap, -1e3)))
    boundless = cell.chain.replace(limits=jnp.array([-1e3, 1e3]) * jnp.ones_like(cell.chain.limits))
    _, error = descend(
        boundless, pose, cell.home, config.ik.iterations, config.ik.max_step, config.ik.damping
    )
    beyond = jnp.linalg.norm(error[:3]) <= config.ik.position_tolerance
    colliding = jnp.where(
        gaps[best, 0] <= gaps[best, 1], Reason.CELL_COLLISION, Reason.SELF_COLLISION
    )
    missing = jnp.where(beyond, Reason.JOINT_LIMIT, Reason.UNREACHABLE)
    reason = jnp.where(
        jnp.any(free), Reason.FEASIBLE, jnp.where(jnp.any(solved.branch_found), colliding, missing)
    )
    return reason.astype(jnp.uint8), man[best], gap[best], solved.branches[best]


@functools.partial(jax.jit, static_argnames="config")
def _assess_chunk(cell: Workcell, poses: Array, keys: Array, config: MapConfig):
    return jax.vmap(lambda pose, key: assess_pose(cell, pose, key, config))(poses, keys)


def build_feasibility_map(
    cell: Workcell,
    config: MapConfig = MapConfig(),
    *,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> FeasibilityMap:
    """Judge every pose of the grid, chunk by chunk.

    Args:
        cell: robot, fixtures and the objects of its scene.
        config: grid and thresholds.
        seed: draws the IK seeds.
        progress: called with (poses done, poses in all) after each chunk.
    """
    poses = grid_poses(config)
    keys = jax.random.split(jax.random.key(seed), len(poses))
    parts = []
    for start in range(0, len(poses), config.chunk):
        index = np.minimum(np.arange(start, start + config.chunk), len(poses) - 1)
        out = jax.device_get(_assess_chunk(cell, poses[index], keys[index], config))
        parts.append([a[: len(poses) - start] for a in out])
        if progress:
            progress(min(start + config.chunk, len(poses)), len(poses))
    reason, man, _, q = (np.concatenate(column) for column in zip(*parts, strict=True))
    free = reason == Reason.FEASIBLE
    scale = float(np.percentile(man[free], 95)) if free.any() else 1.0
    share = np.clip(man / scale, 0.0, 1.0)
    reason = np.where(free & (share < config.least_manipulability), Reason.NEAR_SINGULAR, reason)
    fea = np.where(reason == Reason.FEASIBLE, share, 0.0)
    shape = config.shape
    return FeasibilityMap(
        lower=jnp.array(config.lower),
        spacing=jnp.float32(config.spacing),
        orientations=jnp.asarray(down_orientations(config)),
        feasibility=jnp.asarray(fea.reshape(shape), jnp.float32),
        reason=jnp.asarray(reason.reshape(shape), jnp.uint8),
        configuration=jnp.asarray(q.reshape(*shape, -1), jnp.float32),
        manipulability_scale=jnp.float32(scale),
    )


@jax.jit
def query(fmap: FeasibilityMap, pose: Float[Array, "8"]) -> tuple[Array, Array]:
    """Feasibility at a pose: trilinear in position, nearest orientation; and its best seed.

    Outside the grid the nearest voxel answers.
    """
    nearest = jnp.argmax(jnp.abs(fmap.orientations @ pose[:4]))
    field = fmap.feasibility[..., nearest]
    place = (dq.position(pose) - fmap.lower) / fmap.spacing
    value = jax.scipy.ndimage.map_coordinates(field, place[:, None], order=1, mode="nearest")[0]
    shape = jnp.array(field.shape)
    i, j, k = jnp.clip(jnp.round(place).astype(int), 0, shape - 1)
    return value, fmap.configuration[i, j, k, nearest]


@jax.jit
def nearest_feasible(fmap: FeasibilityMap, pose: Float[Array, "8"]) -> Float[Array, "8"]:
    """Grid pose with positive feasibility that is nearest to a pose (0.3 m counts as 1 rad)."""
    shape = fmap.feasibility.shape
    axes = [fmap.lower[i] + fmap.spacing * jnp.arange(shape[i]) for i in range(3)]
    points = jnp.stack(jnp.meshgrid(*axes, indexing="ij"), -1)
    away = jnp.linalg.norm(points - dq.position(pose), axis=-1)[..., None]
    angle = 2 * jnp.arccos(jnp.clip(jnp.abs(fmap.orientations @ pose[:4]), 0, 1))
    cost = jnp.where(fmap.feasibility > 0, away + 0.3 * angle, jnp.inf)
    i, j, k, r = jnp.unravel_index(jnp.argmin(cost), shape)
    return dq.from_parts(points[i, j, k], fmap.orientations[r])


def save_map(path: Path, cell: Workcell, fmap: FeasibilityMap) -> None:
    """Write a map with its cell's hash."""
    artifacts.save(path, "feasibility map", cell.source.digest, fmap)


def load_map(path: Path, cell: Workcell) -> FeasibilityMap:
    """Read a map; one of another cell is refused (RunFolderError)."""
    _, state = artifacts.load(path, "feasibility map", cell.source.digest)
    return FeasibilityMap(**{k: jnp.asarray(v) for k, v in state.items()})
