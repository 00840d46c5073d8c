# SPDX-License-Identifier: MIT
"""Make a vendor's robot file into a cell folder, and say all that was done and is wrong."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np

from hybrid_jax.adopt.cell_folder import absolute_assets, write_cell
from hybrid_jax.adopt.exclusions import exclude_pairs, exclude_touching
from hybrid_jax.adopt.gripper import Gripper, attach_gripper, find_gripper
from hybrid_jax.adopt.handling_data import carried_objects, handling_data
from hybrid_jax.adopt.home_search import find_home
from hybrid_jax.adopt.joint_rates import state_rates
from hybrid_jax.adopt.overview import add_overview
from hybrid_jax.adopt.planning_group import group_tip, hold_other_joints
from hybrid_jax.adopt.semantic_description import SemanticDescription, read_srdf
from hybrid_jax.adopt.servos import add_servos, compensate_gravity
from hybrid_jax.adopt.surroundings import add_surroundings, merged, read_surroundings
from hybrid_jax.errors import HybridJaxError, WorkcellError
from hybrid_jax.runtime.quiet import engine_messages
from hybrid_jax.workcell.assets import find_workcell
from hybrid_jax.workcell.diagnosis import diagnose
from hybrid_jax.workcell.findings import WRONG, Finding
from hybrid_jax.workcell.layout import find_layout, home_qpos
from hybrid_jax.workcell.load import as_spec, compile_spec
from hybrid_jax.workcell.tool_frame import TOOL, set_tool

REPORT = "report.md"


@dataclass(frozen=True)
class AdoptionOptions:
    """What a robot's file does not tell."""

    tool: str = ""
    """Site or link that is the tool; found if empty."""
    group: str = ""
    """Group of the SRDF that is the arm; its last link is the tool if none is named."""
    gripper: str = ""
    """Shipped gripper, or model of one, to mount on the tool's frame."""
    srdf: Path | None = None
    """File that names the pairs of links which may touch, and the groups."""
    package_paths: tuple[Path, ...] = ()
    """Folders that hold ROS packages."""
    xacro_arguments: Mapping[str, str] = field(default_factory=dict)
    """Values of a xacro file's arguments by their names."""
    fixtures: tuple[Path, ...] = ()
    """TOML files of what stands around the robot."""


@dataclass(frozen=True)
class Adopted:
    """A cell folder that was written, or why none was."""

    path: Path | None
    """The cell's MJCF; None where nothing could be written."""
    notes: tuple[str, ...]
    """What was added to the robot's file, one sentence each."""
    findings: tuple[Finding, ...]
    """What `check` says of the cell, or of the robot's file where there is none."""

    @property
    def fit(self) -> bool:
        """Can the cell be planned in?"""
        return self.path is not None and all(f.level != WRONG for f in self.findings)


class _Draft(NamedTuple):
    """A cell that is not written yet."""

    spec: mujoco.MjSpec
    task_data: str
    """As TOML; empty where there is nothing to do."""


def adopt(robot: str | Path, folder: Path, options: AdoptionOptions | None = None) -> Adopted:
    """Write a cell folder of a robot: MJCF, meshes, report.

    It finds the tool, states speeds, excludes links that always touch, and finds a free home.

    Args:
        robot: URDF, xacro or MJCF file.
        folder: to write to; its name is the cell's.
        options: what the file does not tell.

    Raises:
        UnknownNameError, WorkcellError: no such file, or the folder holds a cell already.
    """
    options = options or AdoptionOptions()
    source, folder = find_workcell(robot), folder.resolve()  # `.` has no name
    if (folder / f"{folder.name}.xml").exists():
        raise WorkcellError(f"{folder} holds a cell: name another folder with --out")
    try:
        with engine_messages(source.name):
            draft, notes = _complete(source, options)
            path = write_cell(draft.spec, folder, folder.name)
            if draft.task_data:
                path.with_suffix(".toml").write_text(draft.task_data)
    except (HybridJaxError, ValueError) as error:
        others = diagnose(
            source,
            tool=options.tool,
            package_paths=options.package_paths,
            xacro_arguments=options.xacro_arguments,
        )
        first = Finding(WRONG, str(error))
        # what the adoption would have mended is not reported of a file that it could not read
        others = [f for f in others if f.level == WRONG and not f.mended]
        return Adopted(None, (), tuple(dict.fromkeys([first, *others])))
    return Adopted(path, tuple(notes), tuple(diagnose(path)))


def _complete(source: Path, options: AdoptionOptions) -> tuple[_Draft, list[str]]:
    """The spec with all that it lacks and its task data, and a sentence for each addition."""
    described = read_srdf(options.srdf) if options.srdf else SemanticDescription()
    spec = as_spec(source, options.package_paths, options.xacro_arguments)
    absolute_assets(spec)
    spec.compiler.discardvisual = False  # a URDF's sky would vanish
    _name_joints(spec)
    model = compile_spec(spec)
    had_home, home = bool(model.nkey), _by_joint(model, home_qpos(model))
    for key in list(spec.keys):  # their numbers are those of the robot alone
        spec.delete(key)
    notes, gripper = _arm(spec, described, options, home)
    contents = [read_surroundings(file) for file in options.fixtures]
    for content, file in zip(contents, options.fixtures, strict=True):
        notes += add_surroundings(spec, content, file)
    content, label = merged(contents), ", ".join(file.name for file in options.fixtures)
    task_data, carried = handling_data(content, gripper, label), carried_objects(content)
    model = compile_spec(spec)
    layout = find_layout(model, None)
    notes += state_rates(spec, model, layout)
    notes += add_servos(spec, model, layout)
    notes += compensate_gravity(spec, model, layout)
    notes += exclude_pairs(spec, described.disabled)
    model = compile_spec(spec)
    notes += exclude_touching(spec, model, layout)
    return _Draft(spec, task_data), notes + _state_home(spec, home, had_home, carried)


def _arm(
    spec: mujoco.MjSpec, described: SemanticDescription, options: AdoptionOptions, home: dict
) -> tuple[list[str], Gripper | None]:
    """Settle which joints the arm has, its tool and its gripper; sentences, and the gripper.

    `home` are values of the joints by name, which is changed as the joints are.
    """
    notes, tool = [], options.tool
    if options.group:
        group = described.group(options.group)
        tip = group_tip(spec, group, options.group)
        notes, tool = hold_other_joints(spec, group, tip, home), tool or tip
    notes += _set_tool(spec, tool)
    if not options.gripper:
        return notes, None
    file = find_gripper(options.gripper)
    gripper = attach_gripper(spec, file)
    home |= {joint: np.array([gripper.open]) for joint in gripper.joints}
    return [*notes, f"the gripper {file.stem!r} is mounted on it, along its z axis"], gripper


def _name_joints(spec: mujoco.MjSpec) -> None:
    """Name the joints that have no name: limits, home and reports go by names."""
    for number, joint in enumerate(spec.joints):
        if not joint.name:
            joint.name = f"joint_{number}_of_{joint.parent.name or 'a_body'}"


def _by_joint(model: mujoco.MjModel, qpos: np.ndarray) -> dict[str, np.ndarray]:
    """Values of joints by their names."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    return {joint.name: joint.qpos.copy() for joint in map(data.joint, range(model.njnt))}


def _set_tool(spec: mujoco.MjSpec, tool: str) -> list[str]:
    """Make sure that a usual name tells the tool; a sentence where it was another one."""
    before = {site.name for site in spec.sites}
    set_tool(spec, tool)
    added = [site for site in spec.sites if site.name not in before]
    notes = [f"the tool is the link {site.parent.name!r}" for site in added]
    chosen = added[0] if added else spec.site(tool) if tool else None
    if chosen is None or chosen.name == TOOL:
        return notes
    other = spec.site(TOOL)
    if other is not None:
        other.name = f"{TOOL}_of_the_file"
        notes.append(f"the site {TOOL!r} of the file is called {other.name!r} now")
    if chosen in added:
        chosen.name = TOOL
        return notes
    # the compiled model has its pose in one form, whichever the file has
    compiled = compile_spec(spec).site(chosen.name)
    chosen.parent.add_site(name=TOOL, pos=compiled.pos, quat=compiled.quat)
    return [*notes, f"the tool is the site {chosen.name!r}"]


def _state_home(
    spec: mujoco.MjSpec, robot_home: dict[str, np.ndarray], had_home: bool, carried: list[str]
) -> list[str]:
    """Add a keyframe `home` that is free, and a camera; a sentence where home is a new one."""
    model = compile_spec(spec)
    data = mujoco.MjData(model)
    for name, value in robot_home.items():
        data.joint(name).qpos[:] = value
    stated = data.qpos.copy()
    spec.add_key(name="home", qpos=stated)
    model = compile_spec(spec)
    objects = [model.body(name).id for name in carried]
    home, note = find_home(model, find_layout(model, None), had_home, objects)
    if home is not None:
        spec.key("home").qpos = home
    add_overview(spec, model, stated if home is None else home)
    return [note] if note else []


def report(adopted: Adopted, robot: Path) -> str:
    """What was done, as Markdown."""
    lines = [f"# {robot.name} as a cell", ""]
    if adopted.path is not None:
        lines += [f"`{adopted.path.name}` was written from `{robot.name}`.", ""]
    lines += ["## Added", "", *(f"- {note}" for note in adopted.notes or ("nothing",)), ""]
    lines += ["## Found", ""]
    lines += [f"- {f.level}: {f.text}" for f in adopted.findings] or ["- nothing"]
    return "\n".join(lines) + "\n"
