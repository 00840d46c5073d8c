# SPDX-License-Identifier: MIT
"""What all readers of recordings share: what a file does not say, units, the final check."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hybrid_jax.errors import DemonstrationError
from hybrid_jax.skills.demonstration import BASE, Demonstration, check_demonstration

LENGTHS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
"""Metres by the name of a unit."""


@dataclass(frozen=True)
class ImportConfig:
    """What a file does not say itself; what is given here goes before what the file says."""

    name: str = ""
    """Name of the demonstration; the file's name where empty."""
    robot: str = ""
    """Kind of robot that it was recorded on."""
    frame: str = BASE
    """The robot's base frame, as the file calls it: poses in any other frame are refused."""
    note: str = ""
    """Free text."""
    length_unit: str = ""
    """m, cm or mm: for an NPZ file that does not say."""
    quaternion: str = ""
    """wxyz or xyzw: for an NPZ file that does not say."""
    rate: float = 0.0
    """Samples per second: for an NPZ file without times."""
    pose_topic: str = ""
    """Topic of the tool's poses in a ROS 2 bag; the only one of its kind where empty."""
    gripper_topic: str = ""
    """Topic of the gripper in a ROS 2 bag; open throughout where empty."""


def unit_factor(kind: str, unit: str | None, known: dict, where: str) -> float:
    """Factor of a stated unit to ours; DemonstrationError where it is none or unknown."""
    if unit not in known:
        stated = f"states the unit {unit!r}" if unit else "states no unit"
        raise DemonstrationError(
            f"{where} {stated} of {kind}; it must be one of: {', '.join(known)}"
        )
    return known[unit]


def finish(
    path: Path,
    config: ImportConfig,
    about: dict,
    columns: dict,
    label: Callable[[int], str] = "row {}".format,
) -> Demonstration:
    """Put a demonstration together and check it; `label` says what a sample is called."""
    times = np.asarray(columns["times"], float)
    if times.ndim == 1 and times.size and np.isfinite(times[0]):
        times = times - times[0]  # recorders count from their start, or from 1970
    demo = Demonstration(
        name=about.get("name") or config.name or path.stem,
        times=times,
        poses=columns["poses"],
        gripper=columns["gripper"],
        robot=config.robot or about.get("robot", "") or "unknown",
        frame=about.get("frame") or config.frame,
        note=config.note or about.get("note", ""),
    )
    check_demonstration(demo, frame=config.frame, label=label)
    return replace(demo, frame=BASE)
