# SPDX-License-Identifier: MIT
"""Maps in files, marked with the hash of their cell."""

from pathlib import Path

import jax

from hybrid_jax.errors import RunFolderError
from hybrid_jax.feasibility.building import FeasibilityMap
from hybrid_jax.kernels.argument_checks import single_precision
from hybrid_jax.runtime import artifacts
from hybrid_jax.types import Workcell

_KIND = "feasibility map"
_ON_GRID = ("feasibility", "reason", "manipulability", "clearance")


def save_map(path: Path | str, cell: Workcell, fmap: FeasibilityMap) -> None:
    """Write a map with its cell's hash.

    Args:
        path: file to write, ending in `.npz`.
        cell: that the map is of.
        fmap: a built map, its arrays `[x, y, z, orientation]`.

    Raises:
        OSError: it cannot be written; what was there before stays.
    """
    artifacts.save(Path(path), _KIND, cell.source.digest, fmap)


@single_precision
def load_map(path: Path | str, cell: Workcell) -> FeasibilityMap:
    """Read a map.

    Args:
        path: of a file that `save_map` wrote.
        cell: that the map must be of.

    Returns:
        The map, its arrays `[x, y, z, orientation]`.

    Raises:
        RunFolderError: the file is missing, damaged, or the map of another cell.
    """
    _, state = artifacts.load(Path(path), _KIND, cell.source.digest)
    try:
        fmap = FeasibilityMap(**{k: jax.device_put(v) for k, v in state.items()})
        grid = (*fmap.feasibility.shape[:3], len(fmap.orientations))
        shapes = [getattr(fmap, name).shape for name in _ON_GRID]
        sound = all(shape == grid for shape in shapes) and fmap.lower.shape == (3,)
        sound &= fmap.configuration.shape == (*grid, len(cell.joint_names))
        sound &= fmap.orientations.shape == (grid[3], 4) and fmap.manipulability_scale.shape == ()
        sound &= fmap.spacing.shape == () and bool(fmap.spacing > 0)
    except (TypeError, ValueError, AttributeError, IndexError) as error:
        raise RunFolderError(f"{path} is no complete map: {error}") from None
    if not sound:
        raise RunFolderError(f"{path} is no map of one grid: its arrays do not fit together")
    return fmap
