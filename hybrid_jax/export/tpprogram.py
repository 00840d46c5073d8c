# SPDX-License-Identifier: MIT
"""Teach-pendant programs (`.ls`): a trajectory as timed joint moves.

The controller runs them itself, so what it makes of them is not what was checked: between two
positions it moves the joints evenly, as here, but it rounds corners (CNT) as it likes.
"""

import itertools
import re
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hybrid_jax.errors import WorkcellError
from hybrid_jax.export.tpreading import read_tp_program
from hybrid_jax.export.trajectories import GRIPPER_PAUSE
from hybrid_jax.types import Workcell
from hybrid_jax.workcell.description import ControllerSpec

TOLERANCE = 1e-3
"""Deviation of the even moves from the trajectory, in each joint and at each time [rad]."""
READ_BACK = 1e-3
"""Positions are written with three digits after the point [degree]."""
_STILL = 1e-5
"""Speed of an arm that rests; speeds are written with six digits [rad/s]."""
LEAST = 0.008
"""Shortest move, the interpolation period of common controllers [s]."""
_HEAD = """/PROG  {name}
/ATTR
OWNER = MNEDITOR;
COMMENT = "hybrid_jax";
PROG_SIZE = 0;
CREATE = DATE 00-01-01  TIME 00:00:00;
MODIFIED = DATE 00-01-01  TIME 00:00:00;
FILE_NAME = ;
VERSION = 0;
LINE_COUNT = {lines};
MEMORY_SIZE = 0;
PROTECT = READ_WRITE;
TCD:  STACK_SIZE = 0,
      TASK_PRIORITY = 50,
      TIME_SLICE = 0,
      BUSY_LAMP_OFF = 0,
      ABORT_REQUEST = 0,
      PAUSE_REQUEST = 0;
DEFAULT_GROUP = 1,*,*,*,*;
CONTROL_CODE = 00000000 00000000;
"""


def program_name(stem: str) -> str:
    """A name that controllers take, from a file's.

    Raises:
        WorkcellError: it does not begin with a letter, or is longer than 36 characters.
    """
    name = re.sub(r"[^A-Z0-9_]", "_", stem.upper())
    if not re.fullmatch(r"[A-Z][A-Z0-9_]{0,35}", name):
        raise WorkcellError(
            f"{stem!r} is no name for a TP program: it must begin with a letter and have at most "
            "36 characters"
        )
    return name


def controller_angles(spec: ControllerSpec, names: tuple[str, ...], q: np.ndarray) -> np.ndarray:
    """Joint angles as the controller counts them.

    Args:
        spec: of the controller.
        names: of the joints.
        q: `[point, joint]` [rad].

    Returns:
        `[point, joint]` [degree].

    Raises:
        WorkcellError: the data name a joint that the arm does not have.
    """
    angles = np.degrees(q)
    for one, other in spec.minus:
        if not {one, other} <= set(names):
            raise WorkcellError(
                f"[controller] minus names {one!r} and {other!r}; the arm's joints are "
                f"{', '.join(names)}"
            )
        angles[:, names.index(one)] -= np.degrees(q[:, names.index(other)])
    return angles


def sparse(times: np.ndarray, q: np.ndarray) -> list[int]:
    """Points between which even motion keeps to a trajectory within `TOLERANCE`.

    Args:
        times: `[point]` [s].
        q: `[point, joint]` [rad].
    """
    kept, last = [0], len(times) - 1
    while kept[-1] < last:
        first, end = kept[-1], kept[-1] + 1
        while end < last and (times[end] - times[first] < LEAST or _even(times, q, first, end + 1)):
            end += 1
        kept.append(end)
    return kept


def _even(times: np.ndarray, q: np.ndarray, first: int, last: int) -> bool:
    share = (times[first : last + 1] - times[first]) / (times[last] - times[first])
    line = q[first] + share[:, None] * (q[last] - q[first])
    return bool(np.abs(line - q[first : last + 1]).max() <= TOLERANCE)


@dataclass(frozen=True)
class _Stretch:
    """What happens between two commands of the gripper."""

    command: str
    """That comes first; "" for none."""
    times: np.ndarray
    """`[point]` [s]."""
    q: np.ndarray
    """`[point, joint]` [rad]."""
    rests: np.ndarray
    """Points at which the arm does not move."""


def _stretches(trajectory: dict) -> Iterator[_Stretch]:
    points = trajectory["points"]
    times = np.array([p["time_from_start"] for p in points])
    q, speeds = (np.array([p[k] for p in points]) for k in ("positions", "velocities"))
    orders = trajectory["gripper"] or [{"time_from_start": -np.inf, "command": ""}]
    ends = [order["time_from_start"] for order in orders[1:]] + [np.inf]
    for order, end in zip(orders, ends, strict=True):
        # the last point before a command has its time; the first one begins at 0 itself
        begin = order["time_from_start"] or -np.inf
        here = (times > begin + 1e-3) & (times <= end + 1e-3)
        rests = np.flatnonzero(np.abs(speeds[here]).max(axis=1, initial=0.0) < _STILL)
        yield _Stretch(order["command"], times[here], q[here], rests)


def to_tp_program(cell: Workcell, trajectory: dict, stem: str) -> str:
    """A trajectory as a program, read back and compared before it is returned.

    Args:
        cell: with `[controller]` in its data.
        trajectory: see `trajectories.to_joint_trajectory`.
        stem: the program's name, as a file's.

    Raises:
        WorkcellError: the cell's data do not describe such a controller, or lack its gripper's
            instructions; or the name is none.
    """
    spec = getattr(cell.source.task, "controller", None)
    if spec is None or spec.program != "tp":
        raise WorkcellError(
            f"cell {cell.source.name!r} has no controller that runs TP programs: its data need "
            '[controller] with program = "tp"; write .json or .csv instead'
        )
    if trajectory["gripper"] and not (spec.open and spec.close):
        raise WorkcellError(
            f"cell {cell.source.name!r}: a TP program that carries needs 'open' and 'close' in "
            "[controller], the instructions of its gripper"
        )
    lines, kept = ["UFRAME_NUM=0", "UTOOL_NUM=1"], []
    for stretch in _stretches(trajectory):
        if stretch.command:
            lines += [getattr(spec, stretch.command), f"WAIT    {GRIPPER_PAUSE:.2f}(sec)"]
        lines += _moves(stretch, kept)
    angles = controller_angles(spec, cell.joint_names, np.array(kept))
    text = _as_text(program_name(stem), lines, angles)
    _compare(text, angles)
    return text


def _moves(stretch: _Stretch, kept: list[np.ndarray]) -> list[str]:
    """Instructions of one stretch; their positions are added to `kept`."""
    times, q, lines = stretch.times, stretch.q, []
    if not len(times):
        return []
    fine = sorted({0, len(times) - 1, *stretch.rests.tolist()})
    points = [0]
    for a, b in itertools.pairwise(fine):
        points += [a + i for i in sparse(times[a : b + 1], q[a : b + 1])[1:]]
    stamps = np.round(1e3 * times).astype(int)  # so that rounding does not add up
    for a, b in zip([None, *points[:-1]], points, strict=True):
        kept.append(q[b])
        speed = "5%" if a is None else f"{max(1, stamps[b] - stamps[a])}msec"
        ending = "FINE" if b in fine else "CNT100"
        lines.append(f"J P[{len(kept)}] {speed} {ending}")
    return lines


def _as_text(name: str, lines: list[str], angles: np.ndarray) -> str:
    text = _HEAD.format(name=name, lines=len(lines)) + "/MN\n"
    for number, line in enumerate(lines, 1):
        # moves stand directly after the colon, other instructions after two blanks
        gap = "" if line.startswith("J ") else "  "
        text += f"{number:4d}:{gap}{line}    ;\n"
    text += "/POS\n"
    for number, row in enumerate(angles, 1):
        joints = ",\n".join(f"\tJ{i}= {a:9.3f} deg" for i, a in enumerate(row, 1))
        text += f"P[{number}]{{\n   GP1:\n\tUF : 0, UT : 1,\n{joints}\n}};\n"
    return text + "/END\n"


def _compare(text: str, angles: np.ndarray) -> None:
    """A program that does not say what was meant must not leave the house."""
    found = read_tp_program(text).positions
    if found.shape != angles.shape or np.abs(found - angles).max() > READ_BACK:
        raise AssertionError("the TP program does not read back as it was written")
