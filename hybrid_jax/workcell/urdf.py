# SPDX-License-Identifier: MIT
"""URDF as an MjSpec, with what MuJoCo's importer leaves out: `package://` and velocity limits."""

import os
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

import mujoco

from hybrid_jax.errors import WorkcellError

PACKAGE = "package://"
_VARIABLES = "ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH"
"""Where ROS says its packages are."""


def read_urdf(path: Path, package_paths: Sequence[Path] = ()) -> mujoco.MjSpec:
    """Read a URDF; limits of velocity stand in the joints' `user` data then, as in a cell's MJCF.

    Args:
        path: of the file.
        package_paths: folders that hold ROS packages, looked at first.

    Raises:
        WorkcellError: it is no XML, or a mesh's package or file is not found.
        ValueError: MuJoCo cannot read it.
    """
    try:
        robot = ElementTree.fromstring(path.read_bytes())
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise WorkcellError(f"{path.name} is no XML: {error}") from None
    compiler = _compiler(robot)
    _leave_visuals_out(robot, compiler)
    for mesh in robot.iter("mesh"):
        if "filename" in mesh.attrib:
            found = _mesh_path(path, mesh.get("filename", ""), package_paths, compiler)
            mesh.set("filename", str(found))
    # the names are whole paths now
    compiler.set("strippath", "false")
    compiler.attrib.pop("meshdir", None)
    spec = mujoco.MjSpec.from_string(ElementTree.tostring(robot, encoding="unicode"))
    spec.compiler.fusestatic = False  # a tool link without geometry would vanish
    _state_velocities(spec, robot)
    return spec


def _compiler(robot: ElementTree.Element) -> ElementTree.Element:
    """MuJoCo's settings in a URDF; made where there are none."""
    extension = robot.find("mujoco")
    if extension is None:
        extension = ElementTree.SubElement(robot, "mujoco")
    compiler = extension.find("compiler")
    return ElementTree.SubElement(extension, "compiler") if compiler is None else compiler


def _leave_visuals_out(robot: ElementTree.Element, compiler: ElementTree.Element) -> None:
    """Take visuals out where MuJoCo would discard them: their meshes may be missing."""
    if compiler.get("discardvisual", "true") != "true":
        return
    for link in robot.iter("link"):
        for visual in link.findall("visual"):
            link.remove(visual)


def _state_velocities(spec: mujoco.MjSpec, robot: ElementTree.Element) -> None:
    """Put velocity limits into the joints' `user` data; 0 stands for none that is stated."""
    spec.nuser_jnt = 2
    for element in robot.iter("joint"):
        limit, joint = element.find("limit"), spec.joint(element.get("name", ""))
        if joint is None:
            continue
        stated = "0" if limit is None else limit.get("velocity", "0")
        try:
            joint.userdata = [float(stated), 0.0]
        except ValueError:
            raise WorkcellError(
                f"joint {joint.name!r}: its velocity limit {stated!r} is no number"
            ) from None


def _mesh_path(
    urdf: Path, name: str, package_paths: Sequence[Path], compiler: ElementTree.Element
) -> Path:
    """Where a mesh's file is: where MuJoCo's settings say, else where its name does.

    Raises:
        WorkcellError: it is nowhere; the message says where it was looked for.
    """
    folder = urdf.parent / compiler.get("meshdir", "")
    bare = name.removeprefix("file://").removeprefix(PACKAGE)
    stated = [folder / bare] if "meshdir" in compiler.attrib else []
    if compiler.get("strippath") == "true":
        stated.append(folder / Path(bare).name)
    for path in stated:
        if path.is_file():
            return path.resolve()
    if not name.startswith(PACKAGE):
        path = urdf.parent / name.removeprefix("file://")
        if not path.is_file():
            raise WorkcellError(f"{urdf.name}: the mesh {name} is missing: there is no {path}")
        return path.resolve()
    package, _, inside = name.removeprefix(PACKAGE).partition("/")
    for folder in _package_folders(urdf, package, package_paths):
        if (folder / inside).is_file():
            return (folder / inside).resolve()
    raise WorkcellError(
        f"{urdf.name}: the mesh {name} is missing: no package {package!r} with {inside} is in or "
        f"above {urdf.resolve().parent}, in --package-path, {' or '.join(_VARIABLES)}; name the "
        "folder that holds the package with --package-path"
    )


def _package_folders(urdf: Path, package: str, package_paths: Sequence[Path]):
    """Where a package may be: in what is named, around the file, where ROS has it."""
    around = [urdf.resolve().parent, *urdf.resolve().parents]
    named = [Path(folder) for folder in package_paths]
    stated = [Path(p) for v in _VARIABLES for p in os.environ.get(v, "").split(os.pathsep) if p]
    for folder in [*named, *around, *stated]:
        if folder.name == package:
            yield folder
        yield folder / package
        yield folder / "share" / package
