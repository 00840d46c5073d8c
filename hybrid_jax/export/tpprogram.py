# SPDX-License-Identifier: MIT
"""Teach-pendant programs (`.ls`): a trajectory as timed joint moves.

The controller runs them itself, so what it makes of them is not what was checked: between two
positions it moves the joints evenly, as here, but it rounds corners (CNT) as it likes.
"""

import itertools
import re
from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.interpolate import BPoly

from hybrid_jax.errors import WorkcellError
from hybrid_jax.export.tpreading import read_tp_program
from hybrid_jax.planner.timeline import GRIPPER_PAUSE
from hybrid_jax.types import Workcell
from hybrid_jax.workcell.description import ControllerSpec
from hybrid_jax.workcell.layout import home_qpos

TOLERANCE = 5e-5
"""Deviation of the tool that moves evenly from the trajectory, at each time [m]."""
JOINT_TOLERANCE = 1e-3
"""The same of each joint [rad or m]."""
DIGITS = 3
"""Of a position after the point [degree or mm]."""
LEAST = 8
"""Shortest move, the interpolation period of common controllers [ms]."""
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


def controller_values(
    spec: ControllerSpec, names: tuple[str, ...], units: tuple[str, ...], q: np.ndarray
) -> np.ndarray:
    """Joint values as the controller counts them, rounded as they are written.

    Args:
        spec: of the controller.
        names, units: of the joints.
        q: `[point, joint]` [rad or m].

    Returns:
        `[point, joint]` [degree or mm].

    Raises:
        WorkcellError: the data name a joint that the arm does not have, or a slide.
    """
    values = np.where(np.array(units) == "m", 1e3 * q, np.degrees(q))
    for joint, other in spec.minus:
        if not {joint, other} <= set(names):
            raise WorkcellError(
                f"[controller] minus names {joint!r} and {other!r}; the arm's joints are "
                f"{', '.join(names)}"
            )
        at, less = names.index(joint), names.index(other)
        if "m" in (units[at], units[less]):
            raise WorkcellError(
                f"[controller] minus names {joint!r} and {other!r}: one of them is a slide, and "
                "only angles can be counted from each other"
            )
        # from the other as it is written: so their sum is rounded once
        values[:, at] -= np.round(values[:, less], DIGITS)
    return np.round(values, DIGITS)


@dataclass(frozen=True)
class _Phase:
    """One motion from rest to rest."""

    command: str
    """What the gripper is told before; "" for nothing."""
    stamps: np.ndarray
    """`[point]` whole milliseconds from its beginning: the moves' times can be written."""
    q: np.ndarray
    """`[point, joint]` then [rad or m]."""


def _phases(trajectory: dict) -> Iterator[_Phase]:
    """The trajectory between its points, as a controller interpolates it: by a quintic."""
    points, told = trajectory["points"], {g["point"]: g["command"] for g in trajectory["gripper"]}
    for phase in trajectory["phases"]:
        first, last = phase["first"], phase["last"]
        times = np.array([p["time_from_start"] for p in points[first : last + 1]])
        kinds = ("positions", "velocities", "accelerations")
        rows = np.array([[p[k] for k in kinds] for p in points[first : last + 1]])
        at, end = times - times[0], times[-1] - times[0]
        stamps = np.arange(int(np.ceil(1e3 * end - 1e-6)) + 1)
        q = BPoly.from_derivatives(at, rows)(np.minimum(stamps / 1e3, end))
        # a command is told at the last point before a phase, but for that before the first one
        yield _Phase(told.get(first - 1 if first else 0, ""), stamps, q)


def _levers(cell: Workcell, q: np.ndarray) -> np.ndarray:
    """`[point, 3, joint]` way of the tool for a small motion of each joint [m/rad or 1]."""
    model, layout = cell.model, cell.source.layout
    data, found = mujoco.MjData(model), np.empty((len(q), 3, len(layout.joints)))
    data.qpos[:], jacobian = home_qpos(model), np.empty((3, model.nv))
    for row, values in zip(found, q, strict=True):
        data.qpos[list(layout.qpos)] = values
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_jacSite(model, data, jacobian, None, layout.tool_site)
        row[:] = jacobian[:, list(layout.dofs)]
    return found


def sparse(stamps: np.ndarray, q: np.ndarray, levers: np.ndarray) -> list[int]:
    """Points between which even motion keeps to a trajectory.

    Args:
        stamps: `[point]` [ms].
        q: `[point, joint]` [rad or m].
        levers: `[point, 3, joint]` way of the tool for a small motion of each joint.
    """
    kept, last = [0], len(stamps) - 1
    while kept[-1] < last:
        first, end = kept[-1], min(last, kept[-1] + LEAST)
        while end < last and _even(stamps, q, levers, first, end + 1):
            end += 1
        kept.append(end)
    # the last move may be what was left: it takes some of the one before, all of which is even
    if len(kept) > 2 and last - kept[-2] < LEAST <= (last - kept[-3]) / 2:
        kept[-2] = last - LEAST
    return kept


def _even(stamps, q: np.ndarray, levers: np.ndarray, first: int, last: int) -> bool:
    inside = slice(first, last + 1)
    share = (stamps[inside] - stamps[first]) / (stamps[last] - stamps[first])
    away = q[first] + share[:, None] * (q[last] - q[first]) - q[inside]
    tool = np.linalg.norm(np.einsum("pij,pj->pi", levers[inside], away), axis=1)
    return bool(np.abs(away).max() <= JOINT_TOLERANCE and tool.max() <= TOLERANCE)


def to_tp_program(cell: Workcell, trajectory: dict, stem: str) -> str:
    """A trajectory as a program, read back and compared before it is returned.

    Args:
        cell: with `[controller]` in its data.
        trajectory: see `trajectories.to_joint_trajectory`.
        stem: the program's name, as a file's.

    Raises:
        WorkcellError: the cell's data do not describe such a controller, or lack its gripper's
            instructions; or the name is none; or an angle is counted from a slide.
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
    for phase in _phases(trajectory):
        lines += _instruction(spec, phase.command) + _moves(cell, phase, kept)
    if trajectory["gripper"]:
        lines += _instruction(spec, trajectory["gripper"][-1]["command"])
    values = controller_values(spec, cell.joint_names, cell.joint_units, np.array(kept))
    text = _as_text(program_name(stem), lines, values, cell.joint_units)
    _compare(text, values, cell.joint_units)
    return text


def _instruction(spec: ControllerSpec, command: str) -> list[str]:
    """What the gripper is told, and a rest."""
    return [getattr(spec, command), f"WAIT    {GRIPPER_PAUSE:.2f}(sec)"] if command else []


def _moves(cell: Workcell, phase: _Phase, kept: list[np.ndarray]) -> list[str]:
    """Instructions of one phase; their positions are added to `kept`.

    The first one leads to where the arm is already, but for the program's very first.
    """
    points = sparse(phase.stamps, phase.q, _levers(cell, phase.q))
    lines, first = [], not kept
    if first or phase.command:
        kept.append(phase.q[0])
        lines.append(f"J P[{len(kept)}] 5% FINE")
    for before, point in itertools.pairwise(points):
        kept.append(phase.q[point])
        ending = "FINE" if point == points[-1] else "CNT100"
        lines.append(f"J P[{len(kept)}] {point - before}msec {ending}")
    return lines


def _as_text(name: str, lines: list[str], values: np.ndarray, units: tuple[str, ...]) -> str:
    text = _HEAD.format(name=name, lines=len(lines)) + "/MN\n"
    for number, line in enumerate(lines, 1):
        # moves stand directly after the colon, other instructions after two blanks
        gap = "" if line.startswith("J ") else "  "
        text += f"{number:4d}:{gap}{line}    ;\n"
    text += "/POS\n"
    labels = axis_labels(units)
    for number, row in enumerate(values, 1):
        joints = ",\n".join(
            f"\t{label}= {value:9.{DIGITS}f} {unit}"
            for (label, unit), value in sorted(zip(labels, row, strict=True), key=_axis_order)
        )
        text += f"P[{number}]{{\n   GP1:\n\tUF : 0, UT : 1,\n{joints}\n}};\n"
    return text + "/END\n"


def axis_labels(units: tuple[str, ...]) -> list[tuple[str, str]]:
    """What the controller calls each joint, and its unit: hinges J1, J2 ... [deg]; slides, which
    are extended axes, E1, E2 ... [mm].

    Args:
        units: `rad` or `m` of each joint.
    """
    labels = []
    for number, unit in enumerate(units):
        same = units[: number + 1].count(unit)
        labels.append((f"E{same}", "mm") if unit == "m" else (f"J{same}", "deg"))
    return labels


def _axis_order(row: tuple) -> tuple[bool, int]:
    """J before E, each by its number."""
    (label, _), _ = row
    return label[0] == "E", int(label[1:])


def _compare(text: str, values: np.ndarray, units: tuple[str, ...]) -> None:
    """A program that does not say what was meant must not leave the house."""
    found = read_tp_program(text)
    columns = [found.axes.index(label) for label in axis_labels(units)]
    wanted = found.positions[:, columns]
    if wanted.shape != values.shape or np.abs(wanted - values).max() > 0.1**DIGITS:
        raise AssertionError("the TP program does not read back as it was written")
