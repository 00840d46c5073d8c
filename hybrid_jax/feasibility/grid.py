# SPDX-License-Identifier: MIT
"""Which poses a map covers: voxels along x, y, z times tool orientations.

A flat index runs through the grid `[x, y, z, orientation]` with the orientation fastest.
"""

import itertools
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from hybrid_jax.errors import InputError
from hybrid_jax.ik import IkConfig


@dataclass(frozen=True)
class MapConfig:
    """Grid, thresholds and effort of the map."""

    lower: tuple[float, float, float] = (-0.1, -0.75, 0.05)
    """Centre of the first voxel [m]."""
    upper: tuple[float, float, float] = (0.75, 0.75, 0.75)
    """No centre beyond this [m]."""
    spacing: float = 0.05
    """Edge of a voxel [m]."""
    orientations: int | None = None
    """Tool orientations, spread evenly over SO(3); None for the Euler box below."""
    tilts: tuple[float, ...] = (-0.6, 0.0, 0.6)
    """Euler angles about the tool's x and y axes, from pointing down [rad]."""
    yaws: tuple[float, ...] = (-1.5, -0.75, 0.0, 0.75, 1.5)
    """Euler angles about the vertical [rad]."""
    ik: IkConfig = IkConfig(iterations=30)
    """Tolerances and steps of the inverse kinematics; `iterations` from a random seed."""
    near_iterations: int = 6
    """Steps from the solution of a neighbouring pose."""
    samples: int = 2
    """Random configurations drawn for each pose of the grid, as first seeds."""
    restarts: int = 1
    """Attempts from random seeds at each pose that is reachable."""
    climbs: int = 8
    """Attempts at each feasible pose from the most manipulable of its neighbours."""
    turns: int = 6
    """Orientations that count as neighbours of each."""
    margin: float = 0.0
    """Clearance that a feasible configuration keeps [m]."""
    least_manipulability: float = 0.1
    """Smallest `man'` of a feasible pose, as a share of the 95th percentile."""
    backend: Literal["fused", "mjx"] = "fused"
    """What checks collisions: `fused` (our kernels) or `mjx`."""
    batch: int = 4096
    """Poses per call of the compiled programs."""
    slab: int = 5_000_000
    """At most so many poses are worked on at a time; memory is bounded by this."""

    def __post_init__(self):
        if self.spacing <= 0 or any(u < v for u, v in zip(self.upper, self.lower, strict=True)):
            raise InputError(
                f"the grid is empty: lower {self.lower}, upper {self.upper}, spacing {self.spacing}"
            )
        if self.orientations is not None and self.orientations < 1:
            raise InputError(f"orientations must be at least 1 or None, got {self.orientations}")

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Voxels along x, y, z and orientations."""
        # 1e-6: a whole number of voxels must not lose its last one to rounding
        counts = [
            int((u - v) / self.spacing + 1e-6) + 1
            for u, v in zip(self.upper, self.lower, strict=True)
        ]
        turns = self.orientations or len(self.tilts) ** 2 * len(self.yaws)
        return counts[0], counts[1], counts[2], turns

    @property
    def size(self) -> int:
        """Number of poses."""
        return int(np.prod(self.shape))


def even_orientations(count: int) -> np.ndarray:
    """Quaternions `[count, 4]` spread evenly over SO(3).

    Super-Fibonacci spirals (Alexa 2022, "Super-Fibonacci Spirals: Fast, Low-Discrepancy Sampling
    of SO(3)"): psi is the root of psi^4 = psi + 4.
    """
    phi, psi = np.sqrt(2.0), 1.533751168755204288118041
    s = np.arange(count) + 0.5
    inner, outer = np.sqrt(s / count), np.sqrt(1 - s / count)
    a, b = 2 * np.pi * s / phi, 2 * np.pi * s / psi
    return np.stack(
        [inner * np.sin(a), inner * np.cos(a), outer * np.sin(b), outer * np.cos(b)], axis=1
    )


def down_orientations(config: MapConfig) -> np.ndarray:
    """Quaternions `[orientation, 4]` of a tool that points down, turned over the Euler box."""
    angles = list(itertools.product(config.yaws, config.tilts, config.tilts))
    turns = Rotation.from_euler("ZXY", angles) * Rotation.from_euler("x", np.pi)
    return turns.as_quat(scalar_first=True)


def orientations(config: MapConfig) -> np.ndarray:
    """Quaternions `[orientation, 4]` of the grid."""
    if config.orientations is None:
        return down_orientations(config)
    return even_orientations(config.orientations)


def axes(config: MapConfig) -> list[np.ndarray]:
    """Centres of the voxels along x, y and z: `[voxel]` each [m]."""
    return [config.lower[i] + config.spacing * np.arange(config.shape[i]) for i in range(3)]


def poses_at(config: MapConfig, index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions `[n, 3]` [m] and quaternions `[n, 4]` of poses by flat index `[n]`, in float32."""
    *voxel, turn = np.unravel_index(index, config.shape)
    centres = axes(config)
    position = np.stack([centres[i][voxel[i]] for i in range(3)], axis=1)
    return position.astype(np.float32), orientations(config)[turn].astype(np.float32)


def near_orientations(quats: np.ndarray, count: int) -> np.ndarray:
    """Numbers `[orientation, count]` of the nearest other orientations of each, nearest first.

    Args:
        quats: `[orientation, 4]` unit quaternions.
        count: neighbours of each; fewer where there are not so many.
    """
    # |q . p| is the cosine of half the angle between them, whatever their signs
    similarity = np.abs(quats @ quats.T)
    np.fill_diagonal(similarity, -1.0)
    return np.argsort(-similarity, axis=1)[:, : min(count, len(quats) - 1)]


def nearest_cell(config: MapConfig, position: np.ndarray, quat: np.ndarray) -> np.ndarray:
    """Flat index `[n]` of the grid pose nearest to each pose; -1 outside the volume.

    Args:
        config: the grid.
        position: `[n, 3]` [m].
        quat: `[n, 4]` unit quaternions.
    """
    voxel = np.round((position - np.array(config.lower)) / config.spacing).astype(int)
    inside = np.all((voxel >= 0) & (voxel < config.shape[:3]), axis=1)
    turns = orientations(config).astype(np.float32).T
    turn = np.argmax(np.abs(quat[inside].astype(np.float32) @ turns), axis=1)
    flat = np.full(len(position), -1)
    flat[inside] = np.ravel_multi_index((*voxel[inside].T, turn), config.shape)
    return flat
