# SPDX-License-Identifier: MIT
"""Demonstrations: what was recorded, cleaned and stored."""

from dataclasses import dataclass
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from scipy.ndimage import uniform_filter1d

from hybrid_jax import artifacts
from hybrid_jax.errors import RunFolderError
from hybrid_jax.skills.mapping import resample

POINTS = 51
"""Poses that a skill keeps of a demonstration."""


@dataclass(frozen=True)
class Demonstration:
    """One recorded motion of the tool in the robot's base frame."""

    name: str
    """Unique, e.g. `lift_bolt`."""
    robot: str
    """Robot that it was recorded on; it serves any other."""
    closed: bool
    """True where the gripper holds an object throughout."""
    times: np.ndarray
    """`[sample]` [s]."""
    poses: np.ndarray
    """`[sample, 8]` unit dual quaternions."""


_SAMPLES = 256
"""Samples that a recording is brought to before it is spaced by arc length: one trace for all."""

_resample = jax.jit(resample, static_argnames="count")


def clean(demo: Demonstration, points: int = POINTS) -> np.ndarray:
    """Continuous signs, no repeated poses, a short moving average, even spacing; `[points, 8]`."""
    poses = np.asarray(demo.poses, np.float64)
    flips = np.sum(poses[1:, :4] * poses[:-1, :4], axis=1) < 0
    poses = poses * np.concatenate([[1.0], np.cumprod(np.where(flips, -1.0, 1.0))])[:, None]
    moved = np.linalg.norm(np.diff(poses, axis=0), axis=1) > 1e-5
    poses = poses[np.concatenate([[True], moved])]
    width = min(7, len(poses) // 4 * 2 + 1)
    smooth = uniform_filter1d(poses, width, axis=0, mode="nearest")
    smooth[0], smooth[-1] = poses[0], poses[-1]
    at, wanted = np.arange(len(smooth)), np.linspace(0, len(smooth) - 1, _SAMPLES)
    even = np.stack([np.interp(wanted, at, column) for column in smooth.T], axis=1)
    even /= np.linalg.norm(even[:, :4], axis=1, keepdims=True)
    even[:, 4:] -= np.sum(even[:, :4] * even[:, 4:], 1, keepdims=True) * even[:, :4]
    return np.asarray(_resample(jnp.asarray(even, jnp.float32), points))


def save_demonstrations(path: Path, demos: list[Demonstration]) -> None:
    """Write demonstrations to one file."""
    tree = {
        d.name: {"times": d.times.astype(np.float32), "poses": d.poses.astype(np.float32)}
        for d in demos
    }
    about = {d.name: {"robot": d.robot, "closed": d.closed} for d in demos}
    artifacts.save(path, "demonstrations", "", tree, demonstrations=about)


def load_demonstrations(path: Path) -> list[Demonstration]:
    """Read demonstrations.

    Raises:
        RunFolderError: missing or damaged, or a recording that holds no motion.
    """
    header, tree = artifacts.load(path, "demonstrations", None)
    demos = [
        Demonstration(name, times=tree[name]["times"], poses=tree[name]["poses"], **about)
        for name, about in header["demonstrations"].items()
    ]
    for demo in demos:
        if len(demo.poses) < 8 or not np.isfinite(demo.poses).all():
            raise RunFolderError(
                f"{path}: demonstration {demo.name!r} has fewer than 8 samples "
                "or values that are not finite"
            )
    return demos
