# SPDX-License-Identifier: MIT
"""Teach-pendant programs (`.ls`): a trajectory as timed joint moves.

The controller's motion is not exactly the one that was checked: between two positions it moves
the joints evenly, as assumed here, but it rounds corners (CNT) in its own way.
"""

import itertools
import re

import numpy as np

from hybrid_jax.errors import WorkcellError
from hybrid_jax.export.fanuc_tp_reader import read_tp_program
from hybrid_jax.export.waypoint_reduction import RestToRest, reduced, rest_to_rest, tool_levers
from hybrid_jax.planner.timeline import GRIPPER_PAUSE
from hybrid_jax.types import Workcell
from hybrid_jax.workcell.description import ControllerSpec

DIGITS = 3
"""Decimals of a position [degree or mm]."""
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
    """A program name that controllers accept, from a file's name.

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
    """Joint values in the controller's counting, rounded as they are written.

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
    for joint, origin in spec.minus:
        if not {joint, origin} <= set(names):
            raise WorkcellError(
                f"[controller] minus names {joint!r} and {origin!r}; the arm's joints are "
                f"{', '.join(names)}"
            )
        column, base = names.index(joint), names.index(origin)
        if "m" in (units[column], units[base]):
            raise WorkcellError(
                f"[controller] minus names {joint!r} and {origin!r}: one of them is a slide, and "
                "only angles can be counted from each other"
            )
        # from the origin's value as it is written: so the sum of both is rounded only once
        values[:, column] -= np.round(values[:, base], DIGITS)
    return np.round(values, DIGITS)


def to_tp_program(cell: Workcell, trajectory: dict, stem: str) -> str:
    """A trajectory as a program, read back and compared before it is returned.

    Args:
        cell: with `[controller]` in its data.
        trajectory: see `trajectories.to_joint_trajectory`.
        stem: the program's name, as a file's.

    Returns:
        The text of an `.ls` file.

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
    lines, positions = ["UFRAME_NUM=0", "UTOOL_NUM=1"], []
    for phase in rest_to_rest(trajectory):
        lines += _instruction(spec, phase.command) + _moves(cell, phase, positions)
    if trajectory["gripper"]:
        lines += _instruction(spec, trajectory["gripper"][-1]["command"])
    values = controller_values(spec, cell.joint_names, cell.joint_units, np.array(positions))
    text = _as_text(program_name(stem), lines, values, cell.joint_units)
    _compare(text, values, cell.joint_units)
    return text


def _instruction(spec: ControllerSpec, command: str) -> list[str]:
    """Instructions of a gripper command, and a rest; none for no command."""
    return [getattr(spec, command), f"WAIT    {GRIPPER_PAUSE:.2f}(sec)"] if command else []


def _moves(cell: Workcell, phase: RestToRest, kept: list[np.ndarray]) -> list[str]:
    """Instructions of one phase; their positions are added to `kept`.

    After a gripper command the first move leads to where the arm stands already; the program's
    first move leads to the start.
    """
    points = reduced(phase.stamps, phase.q, tool_levers(cell, phase.q))
    lines, first = [], not kept
    if first or phase.command:
        kept.append(phase.q[0])
        lines.append(f"J P[{len(kept)}] 5% FINE")
    for previous, point in itertools.pairwise(points):
        kept.append(phase.q[point])
        ending = "FINE" if point == points[-1] else "CNT100"
        lines.append(f"J P[{len(kept)}] {point - previous}msec {ending}")
    return lines


def _as_text(name: str, lines: list[str], values: np.ndarray, units: tuple[str, ...]) -> str:
    text = _HEAD.format(name=name, lines=len(lines)) + "/MN\n"
    for number, line in enumerate(lines, 1):
        # moves stand directly after the colon, other instructions after two blanks
        separator = "" if line.startswith("J ") else "  "
        text += f"{number:4d}:{separator}{line}    ;\n"
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
    """The controller's name and unit of each joint.

    Hinges are J1, J2 ... [deg]. Slides are extended axes, E1, E2 ... [mm].

    Args:
        units: `rad` or `m` of each joint.
    """
    labels = []
    for number, unit in enumerate(units):
        index = units[: number + 1].count(unit)
        labels.append((f"E{index}", "mm") if unit == "m" else (f"J{index}", "deg"))
    return labels


def _axis_order(row: tuple) -> tuple[bool, int]:
    """Sort key of an axis: J before E, each by its number."""
    (label, _), _ = row
    return label[0] == "E", int(label[1:])


def _compare(text: str, values: np.ndarray, units: tuple[str, ...]) -> None:
    """Raise if a program does not read back as `[position, joint]` values: it must not be used."""
    program = read_tp_program(text)
    columns = [program.axes.index(label) for label in axis_labels(units)]
    positions = program.positions[:, columns]
    if positions.shape != values.shape or np.abs(positions - values).max() > 0.1**DIGITS:
        raise AssertionError("the TP program does not read back as it was written")
