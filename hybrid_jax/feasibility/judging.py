# SPDX-License-Identifier: MIT
"""Judge attempts at poses, in batches over all devices."""

import enum
import functools

import jax
import jax.numpy as jnp
import numpy as np

from hybrid_jax.devices import Spread
from hybrid_jax.feasibility.grid import MapConfig
from hybrid_jax.ik import IkConfig
from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels.descent import descend
from hybrid_jax.kernels.kinematics import manipulability, tool_pose
from hybrid_jax.types import Workcell
from hybrid_jax.workcell.mjxcollision import backend


class Reason(enum.IntEnum):
    """Why a pose is (not) feasible, from best to worst explained."""

    FEASIBLE = 0
    NEAR_SINGULAR = 1
    CELL_COLLISION = 2
    SELF_COLLISION = 3
    JOINT_LIMIT = 4
    UNREACHABLE = 5


class Level(enum.IntEnum):
    """How far the best attempt at a pose has come."""

    NOTHING = 0
    BEYOND_LIMITS = 1
    """The tool gets there only with a joint beyond its limits."""
    REACHED = 2
    """Within the limits, but in collision."""
    FREE = 3
    """Free of collision, but near a singularity."""
    FEASIBLE = 4


def _solve(chain, position, quat, seed, iterations, ik: IkConfig):
    pose = dq.from_parts(position, quat)
    q, error = descend(chain, pose, seed, iterations, ik.max_step, ik.damping)
    found = (jnp.linalg.norm(error[:3]) <= ik.position_tolerance) & (
        jnp.linalg.norm(error[3:]) <= ik.rotation_tolerance
    )
    return q, found


def _attempt(cell, position, quat, seed, floor, iterations, *, ik: IkConfig, margin: float, check):
    """What a seed leads to; see `Judge.attempt`."""
    q, found = _solve(cell.chain, position, quat, seed, iterations, ik)
    (gap, own), man = check(cell, q), manipulability(cell, q)
    free = jnp.where(man >= floor, Level.FEASIBLE, Level.FREE)
    level = jnp.where(found, jnp.where(gap >= margin, free, Level.REACHED), Level.NOTHING)
    return level.astype(jnp.uint8), q, gap, man, own


def _stretch(cell: Workcell, position, quat, seed, floor, iterations, *, ik: IkConfig):
    """The same for an arm without joint limits: at best `BEYOND_LIMITS`."""
    limits = jnp.array([-1e3, 1e3]) * jnp.ones_like(cell.chain.limits)
    chain = cell.chain.replace(limits=limits)
    q, found = _solve(chain, position, quat, seed, iterations, ik)
    level = jnp.where(found, Level.BEYOND_LIMITS, Level.NOTHING).astype(jnp.uint8)
    return level, q, jnp.zeros(()), jnp.zeros(()), jnp.zeros((), bool)


def _sample(cell: Workcell, q):
    """Tool position and quaternion of a configuration."""
    pose = tool_pose(cell, q)
    return dq.position(pose), pose[:4]


@functools.cache
def _programs(ik: IkConfig, margin: float, check, devices: tuple):
    """Compiled programs, shared by all builds that differ in their grids only."""
    spread = Spread(devices)
    attempt = functools.partial(_attempt, ik=ik, margin=margin, check=check)
    stretch = functools.partial(_stretch, ik=ik)
    return spread.over(attempt, 3, 2), spread.over(stretch, 3, 2), spread.over(_sample, 1)


class Judge:
    """The compiled programs of one cell, fed with batches of one size over some devices."""

    def __init__(self, cell: Workcell, config: MapConfig, devices=None):
        self.config, self._spread = config, Spread(devices)
        count = len(self._spread.devices)
        self.batch = -(-config.batch // count) * count
        self._cell = self._spread.share(cell)
        programs = _programs(
            config.ik, config.margin, backend(config.backend), tuple(self._spread.devices)
        )
        self._attempt, self._stretch, self._sample = programs
        self.floor = np.float32(0.0)
        """Least manipulability of a feasible pose."""

    def _run(self, program, columns: list[np.ndarray], shared: tuple = ()) -> list[np.ndarray]:
        """Apply a program to columns of any length, batch by batch.

        One batch at a time: executions of several CPU devices share one pool of threads, and
        with more of them than threads in flight they wait for each other for ever.
        """
        count, done = len(columns[0]), []
        for start in range(0, count, self.batch):
            index = np.minimum(np.arange(start, start + self.batch), count - 1)
            placed = [self._spread.split(c[index]) for c in columns]
            done.append(jax.device_get(program(self._cell, *placed, *shared)))
        return [np.concatenate(c)[:count] for c in zip(*map(jax.tree.leaves, done), strict=True)]

    def attempt(self, position, quat, seed, iterations: int) -> list[np.ndarray]:
        """Level, configuration, clearance, manipulability of each attempt, and whether what is
        nearest is the robot itself."""
        shared = (self.floor, np.int32(iterations))
        return self._run(self._attempt, [position, quat, seed], shared)

    def stretch(self, position, quat, seed, iterations: int) -> list[np.ndarray]:
        """The same without joint limits, and without a look at collisions."""
        shared = (self.floor, np.int32(iterations))
        return self._run(self._stretch, [position, quat, seed], shared)

    def sample(self, q: np.ndarray) -> list[np.ndarray]:
        """Tool positions and quaternions."""
        return self._run(self._sample, [q])
