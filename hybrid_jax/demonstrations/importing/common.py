# SPDX-License-Identifier: MIT
"""Common parts of all readers of recordings: settings, units, the final check."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hybrid_jax.demonstrations.demonstration import BASE, Demonstration, check_demonstration
from hybrid_jax.errors import DemonstrationError

LENGTHS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
"""Units of length, in metres."""


@dataclass(frozen=True)
class ImportConfig:
    """What a file does not say itself; what is given here goes before what the file says."""

    name: str = ""
    """Name of the demonstration; where empty, that of the file."""
    robot: str = ""
    """Kind of robot that it was recorded on."""
    frame: str = BASE
    """The robot's base frame, as the file calls it: poses in any other frame are refused."""
    note: str = ""
    """Free text."""
    length_unit: str = ""
    """Unit of length, m, cm or mm, of an NPZ file that does not say."""
    quaternion: str = ""
    """Order of the quaternions, wxyz or xyzw, of an NPZ file that does not say."""
    rate: float = 0.0
    """Samples per second of an NPZ file without times."""
    pose_topic: str = ""
    """Topic of the tool's poses in a ROS 2 bag; where empty, the only one of its kind."""
    gripper_topic: str = ""
    """Topic of the gripper in a ROS 2 bag; where empty, the gripper is open throughout."""


def unit_factor(kind: str, unit: str | None, known: dict, label: str) -> float:
    """Factor from a stated unit to the package's own (m, s, rad).

    Args:
        kind: of quantity, for the message: "length".
        unit: as the file states it; None or empty where it states none.
        known: factors by unit.
        label: what the message begins with: file and column.

    Raises:
        DemonstrationError: no unit is stated, or an unknown one.
    """
    if unit not in known:
        stated = f"states the unit {unit!r}" if unit else "states no unit"
        raise DemonstrationError(
            f"{label} {stated} of {kind}; it must be one of: {', '.join(known)}"
        )
    return known[unit]


def finish(
    path: Path,
    config: ImportConfig,
    about: dict,
    columns: dict,
    label: Callable[[int], str] = "row {}".format,
) -> Demonstration:
    """Put a demonstration together and check it.

    Args:
        path: of the file, which gives the name where nothing else does.
        config: what the file does not say itself.
        about: name, robot, frame and note, as far as the file says them.
        columns: `times` `[sample]` [s], `poses` `[sample, 7]` position [m] and quaternion (w, x,
            y, z), `gripper` `[sample]`.
        label: name of a sample in messages, from its number.

    Raises:
        DemonstrationError: it is no valid recording.
    """
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
