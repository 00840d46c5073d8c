# SPDX-License-Identifier: MIT
"""Task data of a cell, read from `CELL.toml`: what every kind of task has in common.

The file's `kind` says what is done in the cell. All else that belongs to a kind of task stands in
one module, which `TASK_KINDS` names.
"""

import importlib
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Annotated, Protocol

import numpy as np

from hybrid_jax.errors import UnknownNameError, WorkcellError
from hybrid_jax.runtime.input_files import read_text
from hybrid_jax.workcell.records import Within, record

TASK_KINDS = {
    "handling": "hybrid_jax.tasks.handling",
    "inspection": "hybrid_jax.tasks.inspection",
}
"""Module of each kind of task, a `contracts.TaskKind`. It is imported when a cell asks for it: no
part of the package but the module itself knows what a kind of task is like."""
LENGTH = 10.0
"""Largest length that the task data of a work cell may state [m]."""


@dataclass(frozen=True)
class GripperSpec:
    """A gripper whose fingers slide symmetrically."""

    joints: tuple[str, ...]
    """Slide joints; their common value is the opening of one finger [m]."""
    actuator: str
    """Position actuator of the opening."""
    open: Annotated[float, Within(1e-6, LENGTH)]
    """Opening of each finger when open [m]."""
    squeeze: Annotated[float, Within(-LENGTH, LENGTH)]
    """Actuator command that closes on any object [m]."""


@dataclass(frozen=True)
class ControllerSpec:
    """How the robot's controller wants its programs."""

    program: str
    """Language of the programs, as the module of `export` that writes it names it: `tp`."""
    minus: tuple[tuple[str, str], ...] = ()
    """Pairs of joints: the controller counts the first from the second, not from its link."""
    close: str = ""
    """Instruction that closes the gripper."""
    open: str = ""
    """Instruction that opens the gripper."""


class MovableSpec(Protocol):
    """An object that tasks are about: where it appears in random scenes."""

    @property
    def name(self) -> str:
        """Free body."""
        ...

    @property
    def spawn(self) -> tuple[float, float, float]:
        """Middle of the region where it appears: x, y [m], yaw [rad]."""
        ...

    @property
    def jitter(self) -> tuple[float, float, float]:
        """Half widths of that region [m, m, rad]."""
        ...


class TaskData(Protocol):
    """What the task data of any kind say about a cell; its `repr` enters the cell's hash."""

    @property
    def kind(self) -> str:
        """Key of `TASK_KINDS`."""
        ...

    @property
    def tool_site(self) -> str:
        """Site that is the tool."""
        ...

    @property
    def objects(self) -> Sequence[MovableSpec]:
        """The objects that tasks are about."""
        ...

    @property
    def fixture_names(self) -> tuple[str, ...]:
        """Bodies of the cell that the data name and that do not move."""
        ...

    @property
    def gripper(self) -> GripperSpec | None:
        """The gripper; None where nothing is carried."""
        ...

    @property
    def controller(self) -> ControllerSpec | None:
        """How programs are written for the robot; None if that is not known."""
        ...

    def held_in_tool(self, name: str) -> np.ndarray | None:
        """Pose `[7]` of an object in the tool while it is held: position [m], quaternion.

        Where it can be held in several ways, the first of them; None if it is never held.
        """
        ...


def kind_module(kind: str) -> ModuleType:
    """Module of a kind of task, a key of `TASK_KINDS`; see `contracts.TaskKind`."""
    return importlib.import_module(TASK_KINDS[kind])


def read_task_data(path: Path) -> TaskData | None:
    """Read the task data beside a cell's model; None where there are none.

    Raises:
        WorkcellError: the file does not parse, or a field is missing or unknown.
        UnknownNameError: no such kind of task, or a name that the data do not list.
    """
    if not path.is_file():
        return None
    try:
        tables = tomllib.loads(read_text(path, WorkcellError))
    except (ValueError, RecursionError) as error:  # syntax, or bytes that are no text
        raise WorkcellError(f"{path.name} is no valid TOML: {error}") from None
    kind = tables.pop("kind", "handling")
    if not isinstance(kind, str) or kind not in TASK_KINDS:
        raise UnknownNameError(f"kind of task in {path.name}", kind, TASK_KINDS)
    if "controller" in tables:
        controller, label = tables["controller"], f"{path.name} [controller]"
        tables["controller"] = record(ControllerSpec, controller, label)
    return kind_module(kind).read(tables, path.name)
