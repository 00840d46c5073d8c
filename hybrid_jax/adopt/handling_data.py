# SPDX-License-Identifier: MIT
"""Task data of an adopted cell: which objects are carried where, and how they are grasped."""

import json
from typing import Any

import numpy as np

from hybrid_jax.adopt.gripper import Gripper
from hybrid_jax.adopt.surroundings import FLOOR, HANDLED, numbers_of
from hybrid_jax.errors import UnknownNameError, WorkcellError

LIFT, HOVER, RELEASE = 0.12, 0.12, 0.006
"""Heights at which objects are carried and let go, as in the shipped handling cell [m]."""
JITTER = 0.02, 0.02, 0.3
"""How far an object may lie from its place in random tasks: x, y [m], heading [rad]."""
GRIPPER_FIELDS = "joints", "actuator", "open", "squeeze"
FINGER_ROOM = 0.004
"""Room that is left between the fingertips and what an object stands on [m]."""


def carried_objects(content: dict[str, Any]) -> list[str]:
    """Names of the objects that are to be carried."""
    return [entry["name"] for entry in _carried(content)]


def _carried(content: dict[str, Any]) -> list[dict[str, Any]]:
    return [entry for entry in content.get("objects", []) if HANDLED & set(entry)]


def handling_data(content: dict[str, Any], gripper: Gripper | None, file: str) -> str:
    """Task data as TOML of the objects that name a tray; empty where none does.

    Args:
        content: from `read_surroundings`, its shapes checked.
        gripper: of the arm.
        file: name of the file, for messages.

    Raises:
        WorkcellError: something is missing; the message says what.
        UnknownNameError: the table or a tray is no entry of the file.
    """
    objects = _carried(content)
    if not objects:
        return ""
    if gripper is None:
        raise WorkcellError(
            f"{file}: {objects[0]['name']!r} is to be carried, which needs a gripper: name one "
            "with --gripper"
        )
    trays = {entry["name"]: entry for entry in content.get("trays", [])}
    lines = [
        f"# Task data, made from {file}. Lengths in metres, angles in radians.",
        f"tool_site = {json.dumps(gripper.tool_site)}",
        f"table = {json.dumps(_table_of(content, file))}",
        f"lift = {LIFT}\nhover = {HOVER}\nrelease = {RELEASE}\n",
        *_table("[gripper]", {name: getattr(gripper, name) for name in GRIPPER_FIELDS}),
    ]
    for name, entry in trays.items():
        values = {"name": name, "half_size": entry["half_size"], "floor": FLOOR}
        lines += _table("[[trays]]", values)
    for entry in objects:
        if entry.get("tray") not in trays:
            what = f"tray of {entry['name']!r} in {file}"
            raise UnknownNameError(what, str(entry.get("tray")), trays)
        lines += _table("[[objects]]", _object(entry, gripper, file))
    return "\n".join(lines)


def _table_of(content: dict[str, Any], file: str) -> str:
    """Name of the fixture that the objects lie on."""
    fixtures = [entry["name"] for entry in content.get("fixtures", [])]
    name = content.get("table")
    if name not in fixtures:
        raise UnknownNameError(f"table = NAME of {file}, a fixture", str(name), fixtures)
    return name


def _table(head: str, values: dict[str, Any]) -> list[str]:
    """Lines of a table of TOML: numbers, texts and lists of them are written as in JSON."""
    return [head, *(f"{key} = {json.dumps(value)}" for key, value in values.items()), ""]


def _object(entry: dict[str, Any], gripper: Gripper, file: str) -> dict[str, Any]:
    """Fields of one object of the task data; a box tells how it is grasped.

    Raises:
        WorkcellError: the object is no box and does not say how it is grasped, or is too wide.
    """
    label = f"{file}: object {entry['name']!r}"
    missing = [key for key in ("kind", "slot") if key not in entry]
    box = entry.get("box", [])
    if not box:
        missing += [key for key in ("grasp", "grip") if key not in entry]
    if missing:
        raise WorkcellError(f"{label} is to be carried: it needs {', '.join(missing)}")
    if not isinstance(entry["kind"], str):
        raise WorkcellError(f"{label}: kind must be a text")
    (grip,) = numbers_of(entry, "grip", 1, label, (box or [None])[0]).tolist()
    if grip >= gripper.open:
        raise WorkcellError(
            f"{label} is {2e3 * grip:.0f} mm wide between the fingers, which open "
            f"{2e3 * gripper.open:.0f} mm: turn it, so that its narrow side is along x"
        )
    # as low as the fingers allow, at most in the middle
    lowest = round(max(0.0, gripper.reach + FINGER_ROOM - box[2]), 4) if box else 0.0
    numbers = lambda field, default: numbers_of(entry, field, 3, label, default).tolist()  # noqa: E731
    x, y, _ = numbers("position", (0, 0, 0))
    yaw = round(float(np.radians(numbers("euler", (0, 0, 0))[2])), 6)
    return {
        "name": entry["name"],
        "kind": entry["kind"],
        "tray": entry["tray"],
        "grasp": numbers("grasp", (0.0, 0.0, lowest)),
        "grip": grip,
        "spawn": [x, y, yaw],
        "jitter": numbers("jitter", JITTER),
        "slot": numbers("slot", ()),
    }
