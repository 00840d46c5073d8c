# SPDX-License-Identifier: MIT
"""Pictures of skills: the recorded path, and the filtered path of the skill."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402
from scipy.spatial.transform import RigidTransform  # noqa: E402

from hybrid_jax.demonstrations.demonstration import Demonstration
from hybrid_jax.demonstrations.filtering import clean

_AXES = ("tab:red", "tab:green", "tab:blue")
_SHOWN = 9
"""Number of tool frames drawn along the path."""


def _frames(ax, skill: np.ndarray, length: float) -> None:
    """Draw tool axes (x red, y green, z blue) along a skill `[point, 8]`, `length` [m] long."""
    for i in np.linspace(0, len(skill) - 1, _SHOWN).astype(int):
        pose = RigidTransform.from_dual_quat(skill[i].astype(float), scalar_first=True)
        for axis, colour in zip(np.eye(3), _AXES, strict=True):
            ends = np.stack([pose.translation, pose.apply(length * axis)])
            ax.plot(*ends.T, color=colour, lw=1.2)


def draw_demonstration(folder: Path, demo: Demonstration) -> Path:
    """Draw one demonstration to `NAME.png`: recorded (grey), kept (black), tool frames, start.

    Args:
        folder: for the picture.
        demo: recording with poses `[sample, 7]`.

    Returns:
        The picture's file.
    """
    skill = clean(demo)
    path = RigidTransform.from_dual_quat(skill.astype(float), scalar_first=True).translation
    size = max(float(np.ptp(path, axis=0).max()), 0.05)
    fig = plt.figure(figsize=(4.2, 3.8))
    ax = fig.add_subplot(projection="3d")
    ax.plot(*demo.poses[:, :3].T, color="0.6", lw=2.5, label="recorded")
    ax.plot(*path.T, color="black", lw=1.0, label="kept")
    _frames(ax, skill, 0.15 * size)
    ax.scatter(*path[0], color="tab:orange", s=40, label="start")
    centre = (path.max(axis=0) + path.min(axis=0)) / 2
    for i, name in enumerate("xyz"):
        getattr(ax, f"set_{name}lim")(centre[i] - 0.6 * size, centre[i] + 0.6 * size)
    direction = path[-1, :2] - path[0, :2]
    ax.view_init(elev=22, azim=float(np.rad2deg(np.arctan2(*direction[::-1]))) - 65)
    ax.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    ax.set_box_aspect((1, 1, 1))
    ax.locator_params(nbins=4)
    grip = "closed" if demo.closed else "open"
    ax.set_title(f"{demo.name}\n{demo.note}, gripper {grip}, {demo.times[-1]:.1f} s", fontsize=8)
    ax.legend(fontsize=7, loc="upper left")
    fig.subplots_adjust(left=0.0, right=0.94, bottom=0.08, top=0.90)
    folder.mkdir(parents=True, exist_ok=True)
    fig.savefig(folder / f"{demo.name}.png", dpi=90)
    plt.close(fig)
    return folder / f"{demo.name}.png"
