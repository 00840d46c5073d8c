# SPDX-License-Identifier: MIT
"""Candidate configurations of key poses: the feasible branches of inverse kinematics."""

from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Float, PRNGKeyArray

from hybrid_jax.ik import IkConfig, distinct_solutions, solve_from_seeds
from hybrid_jax.kernels.collision.motion_validation import clearances_in_scenes
from hybrid_jax.types import Scene, Workcell


@dataclass(frozen=True)
class PathIkConfig:
    """Conditions on a feasible way point, and settings of inverse kinematics."""

    margin: float = 0.004
    """Clearance of a way point [m]."""
    key_margin: float = 0.001
    """Clearance of a key pose, and of `near_key` points beside it [m]: the task asks for these
    poses, and where a gripper works it works close to things."""
    near_key: int = 9
    """Number of way points on each side of a key pose for which `key_margin` holds."""
    least_manipulability: float = 0.1
    """Smallest `man'`, as a share of the map's scale."""
    max_jump: float = 0.3
    """Largest change of a joint between neighbouring points of one branch [rad]."""
    candidates: int = 4
    """Number of configurations of a key pose that are followed: those nearest to home."""
    search: IkConfig = IkConfig(seeds=24, iterations=50)
    """Inverse kinematics of key poses."""
    tracking: IkConfig = IkConfig(iterations=4)
    """Inverse kinematics along a path, each point from the one before."""
    arrived: float = 1e-3
    """Largest distance at which a path counts as ending in a given configuration [rad]."""


@dataclass(frozen=True)
class Judge:
    """What configurations are judged by, in the scenes of several unit segments."""

    cell: Workcell
    """Robot and fixtures."""
    scenes: Scene
    """Scenes on the host, leaves `[scene, ...]`."""
    scale: float
    """Manipulability that counts as 1."""
    config: PathIkConfig
    """Thresholds."""

    def is_dexterous(self, manipulability: np.ndarray) -> np.ndarray:
        """Which manipulabilities are large enough."""
        return manipulability >= self.config.least_manipulability * self.scale

    def keep(self, scene: np.ndarray, q: np.ndarray, margin: np.ndarray | float) -> np.ndarray:
        """Which configurations `[point, joint]` keep a margin [m], each in the scene of a number.

        Both `scene` and `margin` are `[point]`.
        """
        # clearances end at the margin as float32: it may be less than the margin itself
        return self.clearances(scene, q) >= np.asarray(margin, np.float32)

    def clearances(self, scene: np.ndarray, q: np.ndarray) -> np.ndarray:
        """Clearances `[point]` [m] of configurations, up to the largest margin; see `keep`."""
        # no margin exceeds `config.margin`: larger clearances need not be told apart
        return clearances_in_scenes(self.cell, self.scenes, scene, q, self.config.margin)


def draw_seeds(judge: Judge, poses: int, key: PRNGKeyArray, number: int) -> np.ndarray:
    """Seeds of the search for the key poses of one task `[pose, seed, joint]` [rad or m].

    They are drawn on the host, where another count needs no other program.
    """
    rng = np.random.default_rng([*np.asarray(jax.random.key_data(key)), number])
    low, high = np.asarray(judge.cell.chain.limits).T
    seeds = rng.uniform(low, high, (poses, judge.config.search.seeds, low.size))
    seeds[:, 0] = judge.cell.home
    return seeds.astype(np.float32)


def find_candidates(
    judge: Judge,
    around: np.ndarray,
    poses: Float[np.ndarray, "pose 8"],
    seeds: Float[np.ndarray, "pose seed n"],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Candidate configurations of key poses, those nearest to home first.

    Args:
        judge: what configurations are judged by.
        around: `[pose, 2]` numbers of the scenes before and after each key pose.
        poses: `[pose, 8]` tool poses, unit dual quaternions.
        seeds: `[pose, seed, joint]` configurations that the search begins at [rad or m].

    Returns:
        Candidates `[pose, candidate, joint]` [rad or m], which of them are feasible in both scenes
        `[pose, candidate]`, and which poses are within reach at all `[pose]`.
    """
    config, search, shape = judge.config, judge.config.search, seeds.shape
    home = np.asarray(judge.cell.home)
    rows = np.repeat(np.arange(len(poses)), search.seeds)
    q, solved, manipulabilities = solve_from_seeds(
        judge.cell.chain, poses[rows], seeds.reshape(-1, home.size), home, search
    )
    q, solved = q.reshape(shape), solved.reshape(shape[:2])
    usable = distinct_solutions(q, solved, search.distinct)
    usable &= judge.is_dexterous(manipulabilities.reshape(shape[:2]))
    for side in (0, 1):
        pose, seed = np.nonzero(usable)
        usable[pose, seed] = judge.keep(around[pose, side], q[pose, seed], config.key_margin)
    distance = np.abs(q - home).max(axis=-1)
    order = np.argsort(np.where(usable, distance, np.inf), axis=1, kind="stable")
    best = np.arange(len(poses))[:, None], order[:, : config.candidates]
    return q[best], usable[best], np.any(solved, axis=1)
