# SPDX-License-Identifier: MIT
"""Make a vendor's robot file into a cell folder, and say all that was done and is wrong."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np

from hybrid_jax.adopt.cell_folder import absolute_assets, write_cell
from hybrid_jax.adopt.exclusions import exclude_pairs, exclude_touching
from hybrid_jax.adopt.home_search import find_home
from hybrid_jax.adopt.joint_rates import state_rates
from hybrid_jax.adopt.overview import add_overview
from hybrid_jax.adopt.semantic_description import SemanticDescription, read_srdf
from hybrid_jax.adopt.surroundings import add_surroundings
from hybrid_jax.errors import HybridJaxError, WorkcellError
from hybrid_jax.runtime.quiet import engine_messages
from hybrid_jax.workcell.assets import find_workcell
from hybrid_jax.workcell.diagnosis import WRONG, Finding, diagnose
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
    """Group of the SRDF whose last link is the tool."""
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
            spec, notes = _complete(source, options)
            path = write_cell(spec, folder, folder.name)
    except (HybridJaxError, ValueError) as error:
        others = diagnose(source, tool=options.tool, package_paths=options.package_paths)
        first = Finding(WRONG, str(error))
        # what the adoption would have mended is not reported of a file that it could not read
        others = [f for f in others if f.level == WRONG and not f.mended]
        return Adopted(None, (), tuple(dict.fromkeys([first, *others])))
    return Adopted(path, tuple(notes), tuple(diagnose(path)))


def _complete(source: Path, options: AdoptionOptions) -> tuple[mujoco.MjSpec, list[str]]:
    """The spec with all that it lacks, and a sentence for each addition."""
    described = read_srdf(options.srdf) if options.srdf else SemanticDescription()
    tool = options.tool or (described.tip(options.group) if options.group else "")
    spec = as_spec(source, options.package_paths, options.xacro_arguments)
    absolute_assets(spec)
    spec.compiler.discardvisual = False  # a URDF's sky would vanish
    notes = _set_tool(spec, tool)
    model = compile_spec(spec)
    robot_home = home_qpos(model)
    for file in options.fixtures:
        notes += add_surroundings(spec, file)
    had_home = bool(model.nkey)
    if had_home:  # its numbers are those of the robot alone
        for key in list(spec.keys):
            spec.delete(key)
    model = compile_spec(spec)
    layout = find_layout(model, None)
    notes += state_rates(spec, model, layout)
    notes += exclude_pairs(spec, described.disabled)
    model = compile_spec(spec)
    notes += exclude_touching(spec, model, layout)
    return spec, notes + _state_home(spec, robot_home, had_home)


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


def _state_home(spec: mujoco.MjSpec, robot_home: np.ndarray, had_home: bool) -> list[str]:
    """Add a keyframe `home` that is free, and a camera; a sentence where home is a new one."""
    model = compile_spec(spec)
    # what was added after the robot comes behind it in `qpos`
    stated = model.qpos0.copy()
    stated[: len(robot_home)] = robot_home
    spec.add_key(name="home", qpos=stated)
    model = compile_spec(spec)
    home, note = find_home(model, find_layout(model, None), had_home)
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
