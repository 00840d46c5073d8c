# SPDX-License-Identifier: MIT
"""Demonstrations: one recorded motion of a tool, its checks, and folders of many."""

import os
import re
import warnings
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hybrid_jax.errors import DemonstrationError, RunFolderError
from hybrid_jax.runtime import artifacts

KIND = "demonstration"
"""Kind of file, as its header states it."""
BASE = "base"
"""Frame in which stored demonstrations are given: the robot's base."""
PARTIAL = ".partial"
"""End of the names of files that are being written."""
MIN_SAMPLES = 8
"""Least number of samples of a motion."""
REST = (0.002, 0.02)
"""Largest motion of a tool that is taken to rest [m, rad]."""
_UNIT_ERROR = 1e-3
"""How far a quaternion's length may be off 1."""
_JUMP = (0.10, 0.6)
"""Largest step between neighbouring samples that a hand can make [m, rad]."""


@dataclass(frozen=True)
class Demonstration:
    """One recorded motion of the tool in the base frame of the robot that it was recorded on.

    Only its relative motions are used, so it serves any other robot too.
    """

    name: str
    """Name, unique in a library, e.g. `lift_bolt`: letters, digits, `_`, `-`, `.`."""
    times: np.ndarray
    """`[sample]` increasing times [s]."""
    poses: np.ndarray
    """`[sample, 7]` position [m] and unit quaternion (w, x, y, z) of the tool."""
    gripper: np.ndarray
    """`[sample]` state of the gripper, from 0 (open) to 1 (closed)."""
    robot: str = "unknown"
    """Kind of robot that it was recorded on."""
    frame: str = BASE
    """Frame in which the poses are given."""
    note: str = ""
    """Free text."""

    @property
    def closed(self) -> bool:
        """Is the gripper closed for most of the motion?"""
        return bool(np.mean(self.gripper > 0.5) > 0.5)


def _check_shapes(demo: Demonstration) -> None:
    if not re.fullmatch(r"[\w.-]+", demo.name):
        raise DemonstrationError(
            f"{demo.name!r} is no name for a demonstration: use letters, digits, '_', '-', '.'"
        )
    count = len(demo.times)
    shapes = {"times": (count,), "poses": (count, 7), "gripper": (count,)}
    for field, shape in shapes.items():
        actual = getattr(demo, field).shape
        if actual != shape:
            raise DemonstrationError(
                f"{demo.name}: {field} must have shape {shape}, one row for each of the "
                f"{count} times, got {actual}"
            )
    if count < MIN_SAMPLES:
        raise DemonstrationError(f"{demo.name}: {count} samples; at least {MIN_SAMPLES} are needed")


def refuse_name(name: str) -> None:
    """Refuse a name by which a demonstration's file would be taken for an unfinished one.

    Raises:
        DemonstrationError: the name ends in `PARTIAL`.
    """
    if name.endswith(PARTIAL):
        raise DemonstrationError(
            f"{name!r} is no name for a demonstration: files whose names end in {PARTIAL!r} are "
            "unfinished ones; choose another"
        )


def _first(bad: np.ndarray) -> int | None:
    """Index of the first True."""
    indices = np.flatnonzero(bad)
    return int(indices[0]) if indices.size else None


def _faults(demo: Demonstration, max_gap: float):
    """For each rule that is broken: the first sample that breaks it, and what is wrong with it."""
    table = np.column_stack([demo.times, demo.poses, demo.gripper])
    names = ("time", "x", "y", "z", "qw", "qx", "qy", "qz", "gripper")
    not_finite = ~np.isfinite(table)
    if (i := _first(not_finite.any(axis=1))) is not None:
        column = int(_first(not_finite[i]))
        yield i, f"{names[column]} is {table[i, column]}, not a finite number"
        return  # what follows needs numbers
    step = np.diff(demo.times)
    if (i := _first(step <= 0)) is not None:
        yield i + 1, f"time {demo.times[i + 1]:g} s does not come after {demo.times[i]:g} s"
    length = np.linalg.norm(demo.poses[:, 3:], axis=1)
    if (i := _first(np.abs(length - 1) > _UNIT_ERROR)) is not None:
        yield i, f"the quaternion has length {length[i]:.4f}, must be 1 within {_UNIT_ERROR:g}"
    gap = max(max_gap, 5 * float(np.median(step)))
    if (i := _first(step > gap)) is not None:
        yield (
            i + 1,
            f"comes {step[i]:.2f} s after the sample before it, a gap (at most {gap:.2f} s)",
        )
    yield from _jumps(demo.poses)
    if (i := _first((demo.gripper < 0) | (demo.gripper > 1))) is not None:
        yield i, f"gripper is {demo.gripper[i]:g}, must lie between 0 (open) and 1 (closed)"


def _jumps(poses: np.ndarray):
    """Faults by steps that no hand makes: samples are missing, or another body was tracked."""
    move = np.linalg.norm(np.diff(poses[:, :3], axis=0), axis=1)
    if (i := _first(move > _JUMP[0])) is not None:
        yield i + 1, f"lies {move[i]:.3f} m from the sample before it (at most {_JUMP[0]} m)"
    # of half the angle; absolute, since a quaternion and its negative are the same rotation
    cosine = np.abs(np.sum(poses[1:, 3:] * poses[:-1, 3:], axis=1))
    turn = 2 * np.arccos(np.clip(cosine, 0, 1))
    if (i := _first(turn > _JUMP[1])) is not None:
        yield i + 1, f"is turned {turn[i]:.2f} rad against the one before it (at most {_JUMP[1]})"


def moves(poses: np.ndarray) -> bool:
    """Do poses get further from the first one than those of a tool at rest?

    Args:
        poses: `[sample, 7]` position [m] and unit quaternion.
    """
    distance = np.linalg.norm(poses[:, :3] - poses[0, :3], axis=1)
    chord = np.sqrt(np.maximum(2 - 2 * np.abs(poses[:, 3:] @ poses[0, 3:]), 0))
    # the distance of two unit quaternions is half the angle between them, while that is small
    return bool(distance.max() > REST[0] or 2 * chord.max() > REST[1])


def check_demonstration(
    demo: Demonstration,
    *,
    frame: str = BASE,
    label: Callable[[int], str] = "row {}".format,
    max_gap: float = 0.25,
) -> None:
    """Refuse a recording of which no skill can be made.

    Args:
        demo: the recording, with poses `[sample, 7]`.
        frame: the frame in which it must be given.
        label: name of a sample in messages, from its number, e.g. the line of its file.
        max_gap: longest time between two samples [s]; five times the median is always allowed.

    Raises:
        DemonstrationError: the message names the first row that is wrong and what would be right.
    """
    _check_shapes(demo)
    if demo.frame != frame:
        raise DemonstrationError(
            f"{demo.name}: recorded in frame {demo.frame!r}, wanted {frame!r}: bring it to the "
            "robot's base frame, or say that this frame is the base"
        )
    faults = sorted(_faults(demo, max_gap), key=lambda fault: fault[0])
    if faults:
        sample, problem = faults[0]
        raise DemonstrationError(f"{demo.name}, {label(sample)}: {problem}")
    if not moves(demo.poses):
        raise DemonstrationError(
            f"{demo.name}: the tool does not move by {1000 * REST[0]:g} mm or {REST[1]} rad"
        )


def save_demonstration(folder: Path, demo: Demonstration, *, replace: bool = False) -> Path:
    """Write one demonstration to its own file `NAME.npz` of a library's folder.

    Args:
        folder: the library; it is made if it is not there.
        demo: the demonstration, with poses `[sample, 7]`.
        replace: overwrite a demonstration of this name.

    Returns:
        Path of the file.

    Raises:
        DemonstrationError: it is no valid recording, or the name is taken.
    """
    refuse_name(demo.name)
    check_demonstration(demo)
    path = folder / f"{demo.name}.npz"
    if path.exists() and not replace:
        raise DemonstrationError(f"{path} is there already; choose another name, or remove it")
    arrays = {"times": demo.times, "poses": demo.poses, "gripper": demo.gripper}
    # in double precision, as they were checked: in single, times of a long recording may coincide
    arrays = {name: np.asarray(values, np.float64) for name, values in arrays.items()}
    about = {"robot": demo.robot, "frame": demo.frame, "note": demo.note}
    artifacts.save(path, KIND, "", arrays, demonstration=about)
    return path


def load_demonstration(path: Path) -> Demonstration:
    """Read one demonstration from its file.

    Returns:
        The demonstration, with poses `[sample, 7]` in float64.

    Raises:
        RunFolderError: the file is missing or damaged.
        DemonstrationError: it holds no valid recording.
    """
    header, arrays = artifacts.load(path, KIND, None)
    try:
        values = {name: np.asarray(arrays[name], float) for name in ("times", "poses", "gripper")}
        demo = Demonstration(path.stem, **values, **header["demonstration"])
        if not all(isinstance(v, str) for v in (demo.robot, demo.frame, demo.note)):
            raise ValueError("robot, frame and note must be text")
    except (KeyError, TypeError, ValueError) as error:
        raise RunFolderError(f"{path} is damaged: {error!r}") from None
    check_demonstration(demo)
    return demo


def load_demonstrations(folder: Path) -> list[Demonstration]:
    """Read all demonstrations of a library's folder, in the order of their names.

    A damaged file is left out, with a warning that says which and why.

    Raises:
        RunFolderError: no such folder, or no file in it can be used.
    """
    if not folder.is_dir():
        raise RunFolderError(f"{folder} is no folder with demonstrations")
    demos, damaged = [], []
    for path in sorted(folder.glob("*.npz")):
        if path.name.endswith(f"{PARTIAL}.npz"):
            continue  # a write that was interrupted
        try:
            demos.append(load_demonstration(path))
        except (RunFolderError, DemonstrationError, OSError, zipfile.BadZipFile) as error:
            damaged.append(str(error))
            warnings.warn(f"demonstration left out: {error}", stacklevel=2)
    if not demos:
        raise RunFolderError(
            f"{folder} holds no demonstration that can be used"
            + "".join(f"{os.linesep}  {message}" for message in damaged)
        )
    return demos
