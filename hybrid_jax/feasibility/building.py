# SPDX-License-Identifier: MIT
"""Build the map of a cell block by block: memory is bounded, and a build that stops can go on."""

import hashlib
import itertools
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from hybrid_jax.errors import MapError
from hybrid_jax.feasibility.evaluation import Judge, Level, Reason
from hybrid_jax.feasibility.flooding import Block, Field, Flood
from hybrid_jax.feasibility.grid import MapConfig, nearest_cell, orientations
from hybrid_jax.kernels.argument_checks import single_precision
from hybrid_jax.runtime import artifacts
from hybrid_jax.types import Record, Workcell, pytree

_SCALE_SAMPLES = 65536
_PIECE = 262_144
"""Random configurations drawn at a time as first seeds."""
_TINY = 1e-12
_BLOCK = "block_{:05d}.npz"


@pytree
class FeasibilityMap(Record):
    """A built map; the grid axes come first: `[x, y, z, orientation]`."""

    lower: Array
    """`[3]` centre of the first voxel [m]."""
    spacing: Array
    """Edge of a voxel [m]."""
    orientations: Array
    """`[orientation, 4]` quaternions of the tool."""
    feasibility: Array
    """`fea` in [0, 1]: reachable * man' * collision-free; 0 where infeasible."""
    reason: Array
    """`Reason` of each pose, uint8."""
    configuration: Array
    """`[x, y, z, orientation, joint]` [rad or m], a seed for IK: feasible where the pose is, else
    the best attempt within the limits; zeros where there is none."""
    manipulability: Array
    """Manipulability of that configuration; 0 where there is none."""
    clearance: Array
    """Clearance of that configuration [m]; NaN where there is none."""
    manipulability_scale: Array
    """`man' = man / scale`: the 95th percentile over collision-free random configurations."""


def blocks(config: MapConfig) -> Iterator[Block]:
    """The grid cut into boxes of at most `config.slab` poses, along the longest axis first."""
    *voxels, turns = config.shape
    pieces = [1, 1, 1]

    def longest():
        return [-(-n // p) for n, p in zip(voxels, pieces, strict=True)]

    while np.prod(longest()) * turns > config.slab and max(longest()) > 1:
        pieces[int(np.argmax(longest()))] += 1
    cuts = [np.linspace(0, n, p + 1).astype(int) for n, p in zip(voxels, pieces, strict=True)]
    spans = [list(itertools.pairwise(c)) for c in cuts]
    for box in itertools.product(*spans):
        first = tuple(int(a) for a, _ in box)
        yield Block(first, tuple(int(b - a) for a, b in box), turns)


def map_bytes(config: MapConfig, joints: int) -> int:
    """Size of a built map in memory [byte]."""
    return config.size * (4 * joints + 4 + 4 + 4 + 1)


def _refuse_too_large(config: MapConfig, joints: int) -> None:
    required = map_bytes(config, joints)
    ram = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    if required > 0.5 * ram:
        raise MapError(
            f"a map of {config.size:,} poses ({' x '.join(map(str, config.shape))}) takes "
            f"{required / 2**30:.1f} GiB, more than half of this machine's {ram / 2**30:.1f} GiB: "
            "take a coarser spacing, fewer orientations or a smaller volume"
        )


def _first_seeds(judge: Judge, block: Block, limits: np.ndarray, rng):
    """Draw random configurations; of those whose tools are nearest to one pose the first is kept.

    Yields flat indices in the block `[n]`, and configurations `[n, joint]`, piece by piece.
    """
    config, remaining = judge.config, judge.config.samples * block.size
    seen = np.zeros(block.size, bool)
    while remaining > 0:
        count = min(remaining, _PIECE)
        q = rng.uniform(*limits.T, (count, len(limits))).astype(np.float32)
        index = block.block_index(config, nearest_cell(config, *judge.sample(q)))
        index, drawn = np.unique(index, return_index=True)
        new = (index >= 0) & ~seen[index]
        seen[index[new]] = True
        yield index[new], q[drawn[new]]
        remaining -= count


def _fill(judge: Judge, block: Block, limits: np.ndarray, rng, progress) -> Field:
    """Solve one block; `progress` gets the share that is done, by fixed weights of its steps."""
    config, flood = judge.config, Flood(judge, block, len(limits))
    for index, q in _first_seeds(judge, block, limits, rng):
        flood.seed(index, q)
    progress(0.15)
    flood.spread(lambda share: progress(0.15 + 0.6 * share))
    for k in range(config.restarts):
        if not flood.restart(rng, limits):
            break
        flood.spread(lambda share, k=k: progress(0.75 + 0.25 * (k + share) / config.restarts))
    flood.climb()
    return flood.field


def _reasons(field: Field) -> np.ndarray:
    """Levels to reasons; a collision is with what the best attempt is deepest in."""
    reason = np.array(
        [
            Reason.UNREACHABLE,
            Reason.JOINT_LIMIT,
            Reason.CELL_COLLISION,
            Reason.NEAR_SINGULAR,
            Reason.FEASIBLE,
        ],
        np.uint8,
    )[field.level]
    reason[(field.level == Level.REACHED) & field.own] = Reason.SELF_COLLISION
    return reason


def _scale(judge: Judge, limits: np.ndarray, rng) -> float:
    """95th percentile of the manipulability of collision-free configurations; 1 without any."""
    # a configuration attempts its own tool pose, with no step of IK: it is judged as it is
    low, high = limits.T
    q = rng.uniform(low, high, (_SCALE_SAMPLES, len(limits))).astype(np.float32)
    position, quat = judge.sample(q)
    level, _, _, man, _ = judge.attempt(position, quat, q, 0)
    free_manipulability = man[level >= Level.FREE]
    return float(np.percentile(free_manipulability, 95)) if len(free_manipulability) else 1.0


def _fingerprint(cell: Workcell, config: MapConfig, seed: int) -> str:
    return hashlib.sha256(repr((cell.source.digest, config, seed)).encode()).hexdigest()


class _Partial:
    """Finished blocks on disk, so that an interrupted build goes on where it stopped."""

    def __init__(self, folder: Path | str | None, fingerprint: str):
        self.folder = Path(folder) if folder else None
        self.fingerprint = fingerprint

    def read(self, number: int) -> dict | None:
        if not self.folder or not (path := self.folder / _BLOCK.format(number)).is_file():
            return None
        header, state = artifacts.load(path, "block of a map", None)
        return state if header["workcell"] == self.fingerprint else None

    def write(self, number: int, arrays: dict) -> None:
        if self.folder:
            path = self.folder / _BLOCK.format(number)
            artifacts.save(path, "block of a map", self.fingerprint, arrays)

    def discard(self) -> None:
        if self.folder and self.folder.is_dir():
            for path in self.folder.glob("block_*.npz"):
                path.unlink()
            self.folder.rmdir()


def _solve_block(judge, block, limits, rng, progress) -> dict[str, np.ndarray]:
    field = _fill(judge, block, limits, rng, progress)
    reached = field.level >= Level.REACHED
    q = np.where(reached[:, None], field.q, 0.0)
    return {
        "reason": _reasons(field),
        "configuration": q.astype(np.float32),
        "manipulability": np.where(reached, field.man, 0.0).astype(np.float32),
        "clearance": np.where(reached, field.gap, np.nan).astype(np.float32),
    }


def _within(progress, done: int, size: int, total: int) -> Callable[[float], None]:
    """Reporter that turns the share of one block that is done into poses of the whole map."""
    return lambda share: progress(done + int(share * size), total) if progress else None


@single_precision
def build_feasibility_map(
    cell: Workcell,
    config: MapConfig = MapConfig(),
    *,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
    partial: Path | str | None = None,
    devices: Sequence[Any] | None = None,
) -> FeasibilityMap:
    """Judge every pose of the grid.

    Args:
        cell: robot, fixtures and the objects of its scene; a payload in the scene counts.
        config: grid, thresholds and effort.
        seed: draws the random configurations.
        progress: called with (poses done, poses in all).
        partial: folder for finished blocks. A build that was interrupted and is started again
            with the same arguments goes on from them; it is removed at the end.
        devices: JAX devices to share the work; all local ones by default.

    Returns:
        The map: for each pose `[x, y, z, orientation]` its feasibility, reason and configuration.

    Raises:
        MapError: the map would not fit into memory; the message says how large it would be.
    """
    limits = np.asarray(cell.joint_limits, np.float64)
    _refuse_too_large(config, len(limits))
    judge = Judge(cell, config, devices)
    quick = Judge(cell, replace(config, backend="fused"), devices)
    scale = _scale(quick, limits, np.random.default_rng((seed, 0)))
    judge.floor = np.float32(config.least_manipulability * scale)
    stored = _Partial(partial, _fingerprint(cell, config, seed))
    grids, done = {}, 0
    for number, block in enumerate(blocks(config)):
        arrays = stored.read(number)
        if arrays is None:
            report = _within(progress, done, block.size, config.size)
            # each block draws its own numbers: a resumed build gets those of an uninterrupted one
            rng = np.random.default_rng((seed, 1, number))
            arrays = _solve_block(judge, block, limits, rng, report)
            stored.write(number, arrays)
        span = tuple(slice(f, f + n) for f, n in zip(block.first, block.count, strict=True))
        for key, a in arrays.items():
            grid = grids.setdefault(key, np.empty((*config.shape, *a.shape[1:]), a.dtype))
            grid[span] = a.reshape(*block.shape, *a.shape[1:])
        done += block.size
        if progress:
            progress(done, config.size)
    stored.discard()
    return _assembled(config, grids, scale)


def _assembled(config: MapConfig, grids: dict[str, np.ndarray], scale: float) -> FeasibilityMap:
    """The map of what was found at every pose of the grid."""
    # an arm of few joints is singular everywhere
    share = np.clip(grids["manipulability"] / max(scale, _TINY), 0.0, 1.0)
    fea = np.where(grids["reason"] == Reason.FEASIBLE, share, 0.0)
    return FeasibilityMap(
        lower=jnp.array(config.lower, jnp.float32),
        spacing=jnp.float32(config.spacing),
        orientations=jnp.asarray(orientations(config), jnp.float32),
        feasibility=jnp.asarray(fea, jnp.float32),
        manipulability_scale=jnp.float32(scale),
        **{k: jnp.asarray(a) for k, a in grids.items()},
    )
