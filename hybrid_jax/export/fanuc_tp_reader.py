# SPDX-License-Identifier: MIT
"""Read teach-pendant programs (`.ls`) of joint moves, as a controller does."""

import re
from dataclasses import dataclass

import numpy as np

from hybrid_jax.errors import InputError

_SECTIONS = ("/PROG", "/ATTR", "/MN", "/POS", "/END")
_LINE = re.compile(r"\s*(\d+):\s*(.*?)\s*;")
_MOVE = re.compile(r"J P\[(\d+)\] (\d+)(%|msec|sec) (FINE|CNT(\d+))")
_POSITION = re.compile(r"P\[(\d+)\]\{(.*?)\};", re.DOTALL)
_AXIS = re.compile(r"([JE]\d+)=\s*(-?\d+\.\d+) (deg|mm)")


@dataclass(frozen=True)
class TpMove:
    """One joint move."""

    position: int
    """Number of the position that it leads to, from 1."""
    speed: float
    """Share of the arm's full speed [%], or the duration of the move [s]."""
    timed: bool
    """Is `speed` a time?"""
    fine: bool
    """Does the arm come to rest?"""


@dataclass(frozen=True)
class TpProgram:
    """A program of joint moves."""

    name: str
    moves: tuple[TpMove, ...]
    positions: np.ndarray
    """`[position, axis]` values in the controller's counting of joints [degree or mm]."""
    axes: tuple[tuple[str, str], ...]
    """Name and unit of each axis: J1, J2 ... then, where there are any, E1, E2 ... [deg or mm]."""
    others: tuple[str, ...]
    """All other instructions, in order."""


def read_tp_program(text: str) -> TpProgram:
    """Parse a program.

    Args:
        text: of an `.ls` file.

    Returns:
        Moves, and positions `[position, axis]` [degree or mm].

    Raises:
        InputError: a section, a number or a position is missing; the message says which.
    """
    parts = _sections(text)
    moves, instructions = [], []
    lines = [line for line in parts["/MN"].splitlines() if line.strip()]
    for number, line in enumerate(lines, 1):
        match = _LINE.fullmatch(line)
        if not match or int(match[1]) != number:
            raise InputError(f"TP program: line {number} of /MN is {line!r}")
        move = _MOVE.fullmatch(match[2])
        if move:
            moves.append(_move_of(move))
        elif re.match(r"[JLCA] ", match[2]):
            raise InputError(f"TP program: line {number} of /MN is no joint move: {line!r}")
        else:
            instructions.append(match[2])
    _check_count(parts["/ATTR"], len(lines))
    positions, axes = _positions(parts["/POS"])
    for move in moves:
        if not 1 <= move.position <= len(positions):
            raise InputError(f"TP program: a move leads to P[{move.position}], which is missing")
    return TpProgram(parts["/PROG"].strip(), tuple(moves), positions, axes, tuple(instructions))


def _sections(text: str) -> dict[str, str]:
    places = [text.find(name) for name in _SECTIONS]
    if -1 in places or places != sorted(places):
        absent = [n for n, place in zip(_SECTIONS, places, strict=True) if place < 0]
        raise InputError(f"TP program: sections missing or not in order: {absent or _SECTIONS}")
    return {
        name: text[place + len(name) : end]
        for name, place, end in zip(_SECTIONS, places, [*places[1:], None], strict=True)
    }


def _move_of(found: re.Match) -> TpMove:
    number, amount, unit = int(found[1]), float(found[2]), found[3]
    speed = amount / 1e3 if unit == "msec" else amount
    return TpMove(number, speed, unit != "%", found[4] == "FINE")


def _check_count(attributes: str, lines: int) -> None:
    match = re.search(r"LINE_COUNT\s*=\s*(\d+);", attributes)
    if not match or int(match[1]) != lines:
        raise InputError(f"TP program: LINE_COUNT says otherwise than the {lines} lines of /MN")


def _positions(text: str) -> tuple[np.ndarray, tuple[tuple[str, str], ...]]:
    """Values `[position, axis]`, and name and unit of each axis."""
    rows, axes = [], None
    for number, match in enumerate(_POSITION.finditer(text), 1):
        values = _AXIS.findall(match[2])
        labels = tuple((name, unit) for name, _, unit in values)
        if int(match[1]) != number or not _counted(labels) or labels != (axes or labels):
            raise InputError(f"TP program: position {number} is P[{match[1]}] with {values}")
        axes = labels
        rows.append([float(value) for _, value, _ in values])
    if not axes:
        raise InputError("TP program: positions are missing")
    return np.array(rows), axes


def _counted(axes: tuple[tuple[str, str], ...]) -> bool:
    """Are the axes J1, J2 ..., then E1, E2 ..., without a gap?"""
    names = [name for name, _ in axes]
    joints = [name for name in names if name[0] == "J"]
    extended = names[len(joints) :]
    order = [f"J{i + 1}" for i in range(len(joints))] + [f"E{i + 1}" for i in range(len(extended))]
    return bool(names) and names == order
