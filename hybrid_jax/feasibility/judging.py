# SPDX-License-Identifier: MIT
"""Judge attempts at poses, in batches over all devices."""

import enum
import functools

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from hybrid_jax.feasibility.grid import MapConfig
from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels.collision import closest
from hybrid_jax.kernels.descent import descend
from hybrid_jax.kernels.kinematics import manipulability, tool_pose
from hybrid_jax.types import Workcell


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


def _solve(chain, position, quat, seed, iterations, config: MapConfig):
    ik = config.ik
    pose = dq.from_parts(position, quat)
    q, error = descend(chain, pose, seed, iterations, ik.max_step, ik.damping)
    found = (jnp.linalg.norm(error[:3]) <= ik.position_tolerance) & (
        jnp.linalg.norm(error[3:]) <= ik.rotation_tolerance
    )
    return q, found


def _attempt(cell: Workcell, position, quat, seed, floor, iterations, *, config: MapConfig):
    """What a seed leads to; see `Judge.attempt`."""
    q, found = _solve(cell.chain, position, quat, seed, iterations, config)
    (gap, own), man = closest(cell, q), manipulability(cell, q)
    free = jnp.where(man >= floor, Level.FEASIBLE, Level.FREE)
    level = jnp.where(found, jnp.where(gap >= config.margin, free, Level.REACHED), Level.NOTHING)
    return level.astype(jnp.uint8), q, gap, man, own


def _stretch(cell: Workcell, position, quat, seed, floor, iterations, *, config: MapConfig):
    """The same for an arm without joint limits: at best `BEYOND_LIMITS`."""
    limits = jnp.array([-1e3, 1e3]) * jnp.ones_like(cell.chain.limits)
    chain = cell.chain.replace(limits=limits)
    q, found = _solve(chain, position, quat, seed, iterations, config)
    level = jnp.where(found, Level.BEYOND_LIMITS, Level.NOTHING).astype(jnp.uint8)
    return level, q, jnp.zeros(()), jnp.zeros(()), jnp.zeros((), bool)


def _sample(cell: Workcell, q):
    """Tool position and quaternion of a configuration."""
    pose = tool_pose(cell, q)
    return dq.position(pose), pose[:4]


class Judge:
    """The compiled programs of one cell, fed with batches of one size over some devices."""

    def __init__(self, cell: Workcell, config: MapConfig, devices=None):
        self.config = config
        devices = devices or jax.local_devices()
        mesh = Mesh(np.array(devices), ("pose",))
        self.batch = -(-config.batch // len(devices)) * len(devices)
        self._split = NamedSharding(mesh, PartitionSpec("pose"))
        self._cell = jax.device_put(cell, NamedSharding(mesh, PartitionSpec()))
        self._mesh = mesh
        self._programs = {}
        self.floor = np.float32(0.0)
        """Least manipulability of a feasible pose."""

    def _program(self, function, shared: int, **static):
        """The compiled program of a function of one pose; its last arguments are shared."""
        if function in self._programs:
            return self._programs[function]
        one = functools.partial(function, **static)

        def run(cell, *columns):
            own = columns[: len(columns) - shared]
            return jax.vmap(lambda *row: one(cell, *row, *columns[len(own) :]))(*own)

        def specs(count):
            return (PartitionSpec(), *[PartitionSpec("pose")] * count,
                    *[PartitionSpec()] * shared)  # fmt: skip

        def program(cell, *columns):
            mapped = jax.shard_map(
                run, mesh=self._mesh, in_specs=specs(len(columns) - shared),
                out_specs=PartitionSpec("pose"), check_vma=False,
            )  # fmt: skip
            return mapped(cell, *columns)

        self._programs[function] = jax.jit(program)
        return self._programs[function]

    def _run(self, program, columns: list[np.ndarray], shared: tuple = ()) -> list[np.ndarray]:
        """Apply a program to columns of any length, batch by batch.

        One batch at a time: executions of several CPU devices share one pool of threads, and
        with more of them than threads in flight they wait for each other for ever.
        """
        count, done = len(columns[0]), []
        for start in range(0, count, self.batch):
            index = np.minimum(np.arange(start, start + self.batch), count - 1)
            placed = [jax.device_put(c[index], self._split) for c in columns]
            done.append(jax.device_get(program(self._cell, *placed, *shared)))
        return [np.concatenate(c)[:count] for c in zip(*map(jax.tree.leaves, done), strict=True)]

    def attempt(self, position, quat, seed, iterations: int) -> list[np.ndarray]:
        """Level, configuration, clearance, manipulability of each attempt, and whether what is
        nearest is the robot itself."""
        program = self._program(_attempt, 2, config=self.config)
        return self._run(program, [position, quat, seed], (self.floor, np.int32(iterations)))

    def stretch(self, position, quat, seed, iterations: int) -> list[np.ndarray]:
        """The same without joint limits, and without a look at collisions."""
        program = self._program(_stretch, 2, config=self.config)
        return self._run(program, [position, quat, seed], (self.floor, np.int32(iterations)))

    def sample(self, q: np.ndarray) -> list[np.ndarray]:
        """Tool positions and quaternions."""
        return self._run(self._program(_sample, 0), [q])
