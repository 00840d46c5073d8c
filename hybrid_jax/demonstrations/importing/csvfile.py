# SPDX-License-Identifier: MIT
"""Recordings in CSV files. Errors name a sample by its line in the file."""

import csv
import io
import re
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from hybrid_jax.demonstrations.demonstration import Demonstration
from hybrid_jax.demonstrations.importing.common import LENGTHS, ImportConfig, finish, unit_factor
from hybrid_jax.errors import DemonstrationError
from hybrid_jax.runtime.input_files import MOST_TEXT, require_regular

TIMES = {"s": 1.0, "ms": 1e-3}
"""Units of time, in seconds."""
ANGLES = {"rad": 1.0, "deg": np.pi / 180}
"""Units of angle, in radians."""
_QUATERNION = ("qw", "qx", "qy", "qz")
_EULER = ("roll", "pitch", "yaw")


def _header(cells: list[str], label: str) -> dict[str, tuple[int, str | None]]:
    """Number and unit of each column, by the column's name."""
    columns = {}
    for column, cell in enumerate(cells):
        match = re.fullmatch(r"\s*(\w+)\s*(?:\[(\w*)\])?\s*", cell)
        if match is None:
            raise DemonstrationError(f"{label}: {cell!r} is no column; write it as: name [unit]")
        name = match[1].lower()
        if name in columns:
            raise DemonstrationError(
                f"{label}: column {name!r} stands there twice, as number "
                f"{columns[name][0] + 1} and {column + 1}: which of them counts?"
            )
        columns[name] = (column, match[2])
    rotation = _QUATERNION if _QUATERNION[0] in columns else _EULER
    absent = [name for name in ("time", "x", "y", "z", *rotation) if name not in columns]
    if absent:
        raise DemonstrationError(
            f"{label}: column {absent[0]!r} is missing; wanted: time [s], x [m], y [m], z [m], "
            "then qw, qx, qy, qz or roll [deg], pitch [deg], yaw [deg], then gripper"
        )
    return columns


def _numbers(lines: list[tuple[int, list[str]]], width: int, path: Path) -> np.ndarray:
    """Table `[line, column]` of the numbers of lines (line number, cells)."""
    rows = []
    for number, cells in lines:
        try:
            rows.append([float(cell) for cell in cells])
        except ValueError as error:
            raise DemonstrationError(f"{path}, line {number}: {error}") from None
        if len(cells) != width:
            raise DemonstrationError(
                f"{path}, line {number}: {len(cells)} values under {width} columns"
            )
    return np.array(rows).reshape(len(rows), width)


def read_csv(path: Path, config: ImportConfig = ImportConfig()) -> list[Demonstration]:
    """Read a CSV recording.

    Args:
        path: of the file.
        config: what the file does not say itself.

    Returns:
        One demonstration, with poses `[sample, 7]`.

    Raises:
        DemonstrationError: a column, a unit or a number is missing or wrong.
    """
    require_regular(path, MOST_TEXT, DemonstrationError)
    text = path.read_text(encoding="utf-8-sig", errors="replace")
    about = dict(re.findall(r"^#\s*(robot|frame|note)\s*:\s*(.*?)\s*$", text, re.MULTILINE))
    lines = [
        (i + 1, next(csv.reader(io.StringIO(line))))
        for i, line in enumerate(text.splitlines())
        if line.strip() and not line.startswith("#")
    ]
    if not lines:
        raise DemonstrationError(f"{path} is empty; wanted a header line and rows of numbers")
    label = f"{path}, line {lines[0][0]}"
    header = _header(lines[0][1], label)
    table = _numbers(lines[1:], len(lines[0][1]), path)

    def column(name: str, kind: str, known: dict) -> np.ndarray:
        index, unit = header[name]
        return table[:, index] * unit_factor(kind, unit, known, f"{label}: column {name!r}")

    position = np.stack([column(axis, "length", LENGTHS) for axis in "xyz"], axis=1)
    if "qw" in header:
        rotation = table[:, [header[name][0] for name in _QUATERNION]]
    else:
        angles = np.stack([column(name, "angle", ANGLES) for name in _EULER], axis=1)
        # small letters: about the fixed axes, first x, then y, then z
        rotation = Rotation.from_euler("xyz", angles).as_quat(scalar_first=True)
    gripper = table[:, header["gripper"][0]] if "gripper" in header else np.zeros(len(table))
    columns = {"times": column("time", "time", TIMES), "gripper": gripper}
    columns["poses"] = np.concatenate([position, rotation], axis=1)
    return [finish(path, config, about, columns, lambda sample: f"line {lines[sample + 1][0]}")]
