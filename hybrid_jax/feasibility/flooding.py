# SPDX-License-Identifier: MIT
"""Spread solutions over a block of the grid, from each pose to its neighbours.

A neighbour's solution is a few steps away, where a random seed is dozens away and fails one time
in four. Random configurations give the first solutions: each seeds the grid pose that its tool is
nearest to. Then every pose tries the solution of each neighbour that has come further than it,
until none is left to try: work is spent along the borders of the feasible set, where it decides.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hybrid_jax.feasibility.evaluation import Judge, Level
from hybrid_jax.feasibility.grid import MapConfig, near_orientations, orientations, poses_at

GAIN = 0.1
"""Share by which a neighbour's configuration is more manipulable to be tried for that."""


@dataclass(frozen=True)
class Block:
    """A box of voxels with all orientations."""

    first: tuple[int, int, int]
    """Number of its first voxel in the grid, along x, y and z."""
    count: tuple[int, int, int]
    """Voxels along x, y and z."""
    turns: int
    """Orientations."""

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Voxels along x, y and z, and orientations."""
        return (*self.count, self.turns)

    @property
    def size(self) -> int:
        """Number of poses in it."""
        return int(np.prod(self.shape))

    def grid_index(self, config: MapConfig, index: np.ndarray) -> np.ndarray:
        """Flat indices in the grid `[n]` from flat indices in the block `[n]`."""
        *voxel, turn = np.unravel_index(index, self.shape)
        voxel = [v + f for v, f in zip(voxel, self.first, strict=True)]
        return np.ravel_multi_index((*voxel, turn), config.shape)

    def block_index(self, config: MapConfig, index: np.ndarray) -> np.ndarray:
        """Flat indices in the block `[n]` from flat indices in the grid `[n]`; -1 outside."""
        *voxel, turn = np.unravel_index(np.maximum(index, 0), config.shape)
        voxel = np.stack(voxel, axis=1) - np.array(self.first)
        inside = (index >= 0) & np.all((voxel >= 0) & (voxel < self.count), axis=1)
        flat = np.ravel_multi_index((*np.where(inside[:, None], voxel, 0).T, turn), self.shape)
        return np.where(inside, flat, -1)


class Field:
    """The best attempt at each pose of a block, by flat index.

    `level`, clearance `gap` [m], manipulability `man` and `own` (is the robot itself nearest?) are
    `[pose]`, configurations `q` `[pose, joint]` [rad or m].
    """

    def __init__(self, block: Block, joints: int):
        self.block = block
        self.level = np.zeros(block.size, np.uint8)
        self.q = np.zeros((block.size, joints), np.float32)
        self.gap = np.full(block.size, -np.inf, np.float32)
        self.man = np.zeros(block.size, np.float32)
        self.own = np.zeros(block.size, bool)

    def improve(self, index: np.ndarray, level, q, gap, man, own) -> None:
        """Keep attempts that are better than before.

        Of equals in collision the less deep one counts, of equals that are free the one with more
        manipulability: so `fea` is the best that was found.

        Args:
            index: `[n]` poses; none twice.
            level, gap, man, own: `[n]` see the class.
            q: `[n, joint]` [rad or m].
        """
        old = self.level[index]
        better = (level > old) | (
            (level == old) & (level == Level.REACHED) & (gap > self.gap[index])
        )
        better |= (level == old) & (level >= Level.FREE) & (man > self.man[index])
        improved = index[better]
        self.level[improved], self.q[improved] = level[better], q[better]
        self.gap[improved], self.man[improved], self.own[improved] = (
            gap[better],
            man[better],
            own[better],
        )


class Flood:
    """Fills one block.

    Directions to neighbours are numbered: forwards and backwards along x, y and z, then the nearest
    orientations of the same voxel.
    """

    def __init__(self, judge: Judge, block: Block, joints: int):
        self.judge, self.config, self.block = judge, judge.config, block
        self.field = Field(block, joints)
        turns = orientations(self.config)
        self._near = near_orientations(turns, self.config.turns)
        self._tried = np.zeros((6 + self._near.shape[1], *block.shape), np.uint8)
        self.attempts = 0
        """Attempts made so far."""

    def _of_neighbours(self, values: np.ndarray, way: int) -> np.ndarray:
        """Values `[x, y, z, turn]` of the neighbours in one direction; 0 outside the block."""
        if way >= 6:
            return values[..., self._near[:, way - 6]]
        axis, forward = way // 2, way % 2 == 0
        theirs = np.zeros_like(values)
        inner, outer = slice(None, -1), slice(1, None)
        target, source = (inner, outer) if forward else (outer, inner)
        lead = (slice(None),) * axis
        theirs[(*lead, target)] = values[(*lead, source)]
        return theirs

    def _neighbour(self, index: np.ndarray, way: np.ndarray) -> np.ndarray:
        """Flat indices `[n]` of the neighbours of poses `[n]`, each in its own direction."""
        *voxel, turn = np.unravel_index(index, self.block.shape)
        for axis in range(3):
            voxel[axis] = voxel[axis] + (way == 2 * axis) - (way == 2 * axis + 1)
        near_turn = self._near[turn, np.maximum(way - 6, 0)] if self._near.shape[1] else turn
        return np.ravel_multi_index((*voxel, np.where(way >= 6, near_turn, turn)), self.block.shape)

    def _choose(self) -> tuple[np.ndarray, np.ndarray]:
        """Poses that have a neighbour to try, and that neighbour: flat indices `[n]`."""
        level = self.field.level.reshape(self.block.shape)
        direction = np.full(self.block.shape, -1, np.int8)
        for k, tried in enumerate(self._tried):
            neighbour_level = self._of_neighbours(level, k)
            # tried again only when the neighbour has come further than at the last try
            useful = (neighbour_level > level) & (neighbour_level > tried) & (direction < 0)
            direction[useful], tried[useful] = k, neighbour_level[useful]
        index = np.flatnonzero(direction >= 0)
        return index, self._neighbour(index, direction.ravel()[index])

    def _poses(self, index: np.ndarray):
        return poses_at(self.config, self.block.grid_index(self.config, index))

    def _try(self, index: np.ndarray, seed: np.ndarray, iterations: int) -> None:
        self.attempts += len(index)
        self.field.improve(index, *self.judge.attempt(*self._poses(index), seed, iterations))

    def _stretch(self, index: np.ndarray, seed: np.ndarray, iterations: int) -> None:
        self.attempts += len(index)
        self.field.improve(index, *self.judge.stretch(*self._poses(index), seed, iterations))

    def seed(self, index: np.ndarray, q: np.ndarray) -> None:
        """Try configurations `[n, joint]` at poses that they are near to, by flat index `[n]`."""
        self._try(index, q, self.config.near_iterations)

    def restart(self, rng: np.random.Generator, limits: np.ndarray) -> int:
        """Try a random seed at every pose that is reached: to be feasible, or more manipulable.

        Args:
            rng: draws the seeds.
            limits: `[joint, 2]` to draw between [rad or m].

        Returns:
            How many such poses there are.
        """
        index = np.flatnonzero(self.field.level >= Level.REACHED)
        if len(index):
            low, high = limits.T
            seed = rng.uniform(low, high, (len(index), len(limits))).astype(np.float32)
            self._try(index, seed, self.config.ik.iterations)
        return len(index)

    def _cycle(self) -> int:
        """Let every pose that has a neighbour to try, try one; return how many did."""
        field, iterations = self.field, self.config.near_iterations
        index, neighbour = self._choose()
        seed, seeded = field.q[neighbour], field.level[neighbour] >= Level.REACHED
        if seeded.any():
            self._try(index[seeded], seed[seeded], iterations)
        unreached = field.level[index] == Level.NOTHING
        if unreached.any():
            self._stretch(index[unreached], seed[unreached], iterations)
        return len(index)

    def climb(self) -> None:
        """Let feasible poses try neighbours whose configurations are clearly more manipulable.

        Neighbours on one branch of inverse kinematics hardly differ: what they have is not tried.
        """
        feasible, tried = self.field.level == Level.FEASIBLE, {}
        for _ in range(self.config.climbs):
            man = np.where(feasible, self.field.man, 0.0).reshape(self.block.shape)
            best, direction = man * (1 + GAIN), np.full(self.block.shape, -1, np.int8)
            for way in range(len(self._tried)):
                theirs = self._of_neighbours(man, way)
                useful = (man > 0) & (theirs > np.maximum(best, tried.get(way, 0.0)))
                best, direction = np.where(useful, theirs, best), np.where(useful, way, direction)
            index = np.flatnonzero(direction >= 0)
            if not len(index):
                return
            ways = direction.ravel()[index]
            for way in np.unique(ways):
                row = tried.setdefault(int(way), np.zeros(self.block.shape, np.float32)).reshape(-1)
                row[index[ways == way]] = best.ravel()[index[ways == way]]
            neighbours = self._neighbour(index, ways)
            self._try(index, self.field.q[neighbours], self.config.near_iterations)

    def spread(self, progress: Callable[[float], None]) -> None:
        """Let poses try their neighbours until none is left; `progress` gets a share up to 1."""
        cycle = 0
        while self._cycle():
            cycle += 1
            # how many cycles there will be is unknown: the share only ever grows
            progress(1 - 0.9**cycle)
