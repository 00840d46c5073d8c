# SPDX-License-Identifier: MIT
"""Judge attempts at poses, in batches over all devices.

An attempt is damped least squares from a seed towards a pose, and what the end of it is worth.
"""

import enum
import functools

import jax
import jax.numpy as jnp
import numpy as np

from hybrid_jax.feasibility.grid import MapConfig
from hybrid_jax.ik import IkConfig
from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels.damped_least_squares import descend
from hybrid_jax.kernels.kinematics import manipulability, tool_pose
from hybrid_jax.mjx.collision import CLOSEST, Backend, compiler_options, find_backend
from hybrid_jax.runtime.devices import Spread
from hybrid_jax.types import Workcell


class Reason(enum.IntEnum):
    """Why a pose is or is not feasible."""

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
    """Within the limits, but in collision or nearer to something than the margin."""
    FREE = 3
    """Free of collision, but near a singularity."""
    FEASIBLE = 4


def _solve(chain, position, quat, seed, iterations, ik: IkConfig):
    """Configuration `[joint]` after some steps from a seed, and whether it meets the tolerances."""
    pose = dq.from_parts(position, quat)
    q, error = descend(chain, pose, seed, iterations, ik.max_step, ik.damping)
    solved = (jnp.linalg.norm(error[:3]) <= ik.position_tolerance) & (
        jnp.linalg.norm(error[3:]) <= ik.rotation_tolerance
    )
    return q, solved


def _attempt(cell, position, quat, seed, floor, iterations, *, ik: IkConfig, margin: float, check):
    """Attempt one pose from one seed; see `Judge.attempt`."""
    q, solved = _solve(cell.chain, position, quat, seed, iterations, ik)
    (gap, nearest_is_own), man = check(cell, q), manipulability(cell, q)
    free_level = jnp.where(man >= floor, Level.FEASIBLE, Level.FREE)
    level = jnp.where(solved, jnp.where(gap >= margin, free_level, Level.REACHED), Level.NOTHING)
    return level.astype(jnp.uint8), q, gap, man, nearest_is_own


def _stretch(cell: Workcell, position, quat, seed, floor, iterations, *, ik: IkConfig):
    """Attempt one pose for an arm without joint limits: at best `BEYOND_LIMITS`."""
    # finite, and so wide that the steps of an attempt do not meet them
    limits = jnp.array([-1e3, 1e3]) * jnp.ones_like(cell.chain.limits)
    chain = cell.chain.replace(limits=limits)
    q, solved = _solve(chain, position, quat, seed, iterations, ik)
    level = jnp.where(solved, Level.BEYOND_LIMITS, Level.NOTHING).astype(jnp.uint8)
    return level, q, jnp.zeros(()), jnp.zeros(()), jnp.zeros((), bool)


def _sample(cell: Workcell, q):
    """Tool position `[3]` [m] and quaternion `[4]` of a configuration `[joint]`."""
    pose = tool_pose(cell, q)
    return dq.position(pose), pose[:4]


@functools.cache
def _programs(ik: IkConfig, margin: float, backend: Backend, devices: tuple):
    """Compiled programs, shared by all builds that differ in their grids only."""
    spread, options = Spread(devices), compiler_options(backend)
    attempt = functools.partial(_attempt, ik=ik, margin=margin, check=CLOSEST[backend])
    stretch = functools.partial(_stretch, ik=ik)
    return (
        spread.over(attempt, 3, 2, options),
        spread.over(stretch, 3, 2),
        spread.over(_sample, 1),
    )


class Judge:
    """The compiled programs of one cell, fed with batches of one size over some devices."""

    def __init__(self, cell: Workcell, config: MapConfig, devices=None):
        """Put the cell on the devices; programs are compiled at their first call.

        Args:
            cell: robot and scene.
            config: tolerances, margin, collision backend and size of the batches.
            devices: JAX devices to share the work; all local ones by default.
        """
        self.config, self._spread = config, Spread(devices)
        count = len(self._spread.devices)
        self.batch = -(-config.batch // count) * count
        self._cell = self._spread.share(cell)
        programs = _programs(
            config.ik, config.margin, find_backend(config.backend), tuple(self._spread.devices)
        )
        self._attempt, self._stretch, self._sample = programs
        self.floor = np.float32(0.0)
        """Least manipulability of a feasible pose."""

    def _run(self, program, columns: list[np.ndarray], shared: tuple = ()) -> list[np.ndarray]:
        """Apply a program to columns `[n, ...]` of one length, batch by batch.

        One batch at a time: executions of several CPU devices share one pool of threads, and
        with more of them than threads in flight they wait for each other for ever.
        """
        count, results = len(columns[0]), []
        for start in range(0, count, self.batch):
            # the last batch repeats its last row: one size of batch needs one program
            index = np.minimum(np.arange(start, start + self.batch), count - 1)
            batch = [self._spread.split(c[index]) for c in columns]
            results.append(jax.device_get(program(self._cell, *batch, *shared)))
        return [np.concatenate(c)[:count] for c in zip(*map(jax.tree.leaves, results), strict=True)]

    def attempt(self, position, quat, seed, iterations: int) -> list[np.ndarray]:
        """Attempt poses, each from its seed.

        Args:
            position: `[n, 3]` of the tool [m].
            quat: `[n, 4]` of the tool.
            seed: `[n, joint]` configurations to start from [rad or m].
            iterations: steps of damped least squares from each seed.

        Returns:
            Of each attempt: level `[n]`, configuration `[n, joint]`, clearance `[n]` [m],
            manipulability `[n]`, and whether the robot itself is nearest `[n]`.
        """
        shared = (self.floor, np.int32(iterations))
        return self._run(self._attempt, [position, quat, seed], shared)

    def stretch(self, position, quat, seed, iterations: int) -> list[np.ndarray]:
        """Attempt poses `[n, 3]`, `[n, 4]` without joint limits; all shapes are those of `attempt`.

        The level is at most `BEYOND_LIMITS`; clearance and manipulability are not looked at: 0.
        """
        shared = (self.floor, np.int32(iterations))
        return self._run(self._stretch, [position, quat, seed], shared)

    def sample(self, q: np.ndarray) -> list[np.ndarray]:
        """Tool positions `[n, 3]` [m] and quaternions `[n, 4]` of configurations `[n, joint]`."""
        return self._run(self._sample, [q])
