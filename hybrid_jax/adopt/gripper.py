# SPDX-License-Identifier: MIT
"""Attach a gripper to an arm's flange: a model and, beside it, what an arm must know of it."""

import tomllib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import mujoco

from hybrid_jax.adopt.cell_folder import absolute_assets
from hybrid_jax.errors import UnknownNameError, WorkcellError
from hybrid_jax.runtime.input_files import read_text
from hybrid_jax.workcell.assets import robots_folder
from hybrid_jax.workcell.description import LENGTH
from hybrid_jax.workcell.load import as_spec, compile_spec
from hybrid_jax.workcell.records import Within, record
from hybrid_jax.workcell.tool_frame import TOOL, usual_site

PREFIX = "gripper_"
"""Of all names of the gripper in the cell."""
FLANGE = "flange"
"""Name that the arm's own tool frame gets."""


@dataclass(frozen=True)
class Gripper:
    """What an arm must know of a gripper whose fingers slide symmetrically."""

    tool_site: str
    """Site between the fingertips."""
    reach: Annotated[float, Within(0.0, LENGTH)]
    """How far the fingers reach beyond that site [m]."""
    joints: tuple[str, ...]
    """Slide joints; their common value is the opening of one finger [m]."""
    actuator: str
    """Position actuator of the opening."""
    open: Annotated[float, Within(1e-6, LENGTH)]
    """Opening of each finger when open [m]."""
    squeeze: Annotated[float, Within(-LENGTH, LENGTH)]
    """Actuator command that closes on any object [m]."""


def find_gripper(name_or_path: str) -> Path:
    """Model of a gripper from the name of a shipped one, or of a file.

    Raises:
        UnknownNameError: it is neither; the message lists the names.
    """
    path = Path(name_or_path)
    if path.is_file():
        return path.resolve()
    shipped = {p.stem: p.with_suffix(".xml") for p in robots_folder().glob("*/*.toml")}
    shipped = {name: path for name, path in shipped.items() if path.parent.name == name}
    if name_or_path not in shipped:
        raise UnknownNameError("gripper (and no such file)", name_or_path, shipped)
    return shipped[name_or_path]


def read_gripper(model: Path) -> Gripper:
    """What stands beside a gripper's model, in a TOML file of the same name.

    Raises:
        WorkcellError: there is no such file, or a field is missing, unknown or wrong.
    """
    path = model.with_suffix(".toml")
    if not path.is_file():
        raise WorkcellError(f"{path} is missing: it tells the gripper's joints and openings")
    try:
        values = tomllib.loads(read_text(path, WorkcellError))
    except ValueError as error:
        raise WorkcellError(f"{path.name} is no valid TOML: {error}") from None
    return record(Gripper, values, path.name)


def attach_gripper(spec: mujoco.MjSpec, model: Path) -> Gripper:
    """Mount a gripper on the tool's site of an arm, along its z axis; its own becomes `TOOL`.

    Args:
        spec: of the arm, without keyframes.
        model: of the gripper.

    Returns:
        The gripper, its names as in the cell.

    Raises:
        WorkcellError, UnknownNameError: see `read_gripper`; a name that its model lacks.
    """
    gripper, child = read_gripper(model), as_spec(model)
    absolute_assets(child)
    _require_names(gripper, child)
    name = usual_site([site.name for site in spec.sites])
    flange, compiled = spec.site(name), compile_spec(spec).site(name)
    frame = flange.parent.add_frame(pos=compiled.pos, quat=compiled.quat)
    if name == TOOL:
        flange.name = FLANGE if spec.site(FLANGE) is None else f"{FLANGE}_of_the_arm"
    for key in list(child.keys):
        child.delete(key)
    # how well friction holds an object is a setting of the whole model
    for option in ("cone", "impratio", "integrator"):
        setattr(spec.option, option, getattr(child.option, option))
    spec.attach(child, prefix=PREFIX, frame=frame)
    spec.site(PREFIX + gripper.tool_site).name = TOOL
    return replace(
        gripper,
        tool_site=TOOL,
        joints=tuple(PREFIX + joint for joint in gripper.joints),
        actuator=PREFIX + gripper.actuator,
    )


def _require_names(gripper: Gripper, child: mujoco.MjSpec) -> None:
    """Refuse names that the gripper's model lacks."""
    wanted = [
        ("site", [gripper.tool_site], child.sites, child.site),
        ("joint", gripper.joints, child.joints, child.joint),
        ("actuator", [gripper.actuator], child.actuators, child.actuator),
    ]
    for what, names, elements, find in wanted:
        for name in names:
            if find(name) is None:
                known = [element.name for element in elements if element.name]
                raise UnknownNameError(f"{what} of the gripper", name, known)
