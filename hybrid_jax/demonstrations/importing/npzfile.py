# SPDX-License-Identifier: MIT
"""Recordings in NPZ files. Errors name a sample by its number, from 0."""

import zipfile
from pathlib import Path

import numpy as np

from hybrid_jax.demonstrations.demonstration import Demonstration
from hybrid_jax.demonstrations.importing.common import LENGTHS, ImportConfig, finish, unit_factor
from hybrid_jax.errors import DemonstrationError
from hybrid_jax.runtime.input_files import read_arrays

KNOWN = {
    "poses",
    "times",
    "gripper",
    "rate",
    "robot",
    "frame",
    "note",
    "quaternion",
    "length_unit",
}
"""Names of the arrays that are read; others are not even unpacked."""


def _arrays(path: Path) -> dict[str, np.ndarray]:
    try:
        return read_arrays(path, DemonstrationError, KNOWN.__contains__)
    except DemonstrationError:
        raise
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise DemonstrationError(
            f"{path} cannot be read ({error}); wanted an NPZ file of numbers and strings: "
            "stored Python objects are never loaded"
        ) from None


def read_npz(path: Path, config: ImportConfig = ImportConfig()) -> list[Demonstration]:
    """Read one or several demonstrations of an NPZ file.

    Args:
        path: of the file, with `poses` `[sample, 7]` or `[demo, sample, 7]`.
        config: what the file does not say itself.

    Returns:
        One demonstration, or each of several, with poses `[sample, 7]`.

    Raises:
        DemonstrationError: an array or a unit is missing, or a row is wrong.
    """
    arrays = _arrays(path)
    if "poses" not in arrays:
        raise DemonstrationError(
            f"{path}: array 'poses' is missing; of the known ones there are: "
            f"{', '.join(arrays) or 'none'}"
        )
    about = {k: str(arrays[k]) for k in ("robot", "frame", "note", "quaternion") if k in arrays}
    unit = config.length_unit or str(arrays.get("length_unit", ""))
    scale = unit_factor("length", unit, LENGTHS, f"{path}")
    order = config.quaternion or about.get("quaternion", "")
    if order not in ("wxyz", "xyzw"):
        raise DemonstrationError(f"{path}: quaternion order {order!r}, must be wxyz or xyzw")
    poses = np.array(arrays["poses"], float)
    if poses.ndim not in (2, 3) or poses.shape[-1] != 7:
        raise DemonstrationError(f"{path}: poses must be [sample, 7], got {list(poses.shape)}")
    poses[..., :3] *= scale
    if order == "xyzw":
        poses = poses[..., [0, 1, 2, 6, 3, 4, 5]]
    rate = config.rate or float(arrays.get("rate", 0.0))
    if "times" not in arrays and not rate > 0:
        raise DemonstrationError(f"{path}: neither 'times' [s] nor a 'rate' [Hz] is given")
    times = (
        np.asarray(arrays["times"], float)
        if "times" in arrays
        else np.arange(poses.shape[-2]) / rate
    )
    gripper = np.asarray(arrays.get("gripper", np.zeros(poses.shape[:-1])), float)
    if poses.ndim == 2:
        return [finish(path, config, about, dict(times=times, poses=poses, gripper=gripper))]
    name = config.name or path.stem
    # one row of times may serve all demonstrations
    times, gripper = (np.broadcast_to(a, poses.shape[:-1]) for a in (times, gripper))
    return [
        finish(path, config, about | {"name": f"{name}_{i + 1}"}, dict(times=t, poses=p, gripper=g))
        for i, (t, p, g) in enumerate(zip(times, poses, gripper, strict=True))
    ]
