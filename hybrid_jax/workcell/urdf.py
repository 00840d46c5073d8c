# SPDX-License-Identifier: MIT
"""URDF as an MjSpec, with what MuJoCo's importer leaves out: `package://` and velocity limits."""

import os
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

import mujoco

from hybrid_jax.errors import WorkcellError

PACKAGE = "package://"
"""How the name of a mesh begins that lies in a ROS package."""
_VARIABLES = "ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH"
"""Environment variables in which ROS lists the folders of its packages."""


def read_urdf(path: Path, package_paths: Sequence[Path] = ()) -> mujoco.MjSpec:
    """Spec of a URDF, with velocity limits in the joints' `user` data as in a cell's MJCF.

    Args:
        path: of the file.
        package_paths: folders that hold ROS packages, looked at first.

    Raises:
        WorkcellError: the file is no XML, or the package or file of a mesh is not found.
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
            file = _mesh_path(path, mesh.get("filename", ""), package_paths, compiler)
            mesh.set("filename", str(file))
    # the meshes are named by whole paths now, which these two settings would change
    compiler.set("strippath", "false")
    compiler.attrib.pop("meshdir", None)
    spec = mujoco.MjSpec.from_string(ElementTree.tostring(robot, encoding="unicode"))
    spec.compiler.fusestatic = False  # a tool link without geometry would vanish
    _state_velocities(spec, robot)
    return spec


def _compiler(robot: ElementTree.Element) -> ElementTree.Element:
    """Element of MuJoCo's compiler settings in a URDF; it is added where there is none."""
    extension = robot.find("mujoco")
    if extension is None:
        extension = ElementTree.SubElement(robot, "mujoco")
    compiler = extension.find("compiler")
    return ElementTree.SubElement(extension, "compiler") if compiler is None else compiler


def _leave_visuals_out(robot: ElementTree.Element, compiler: ElementTree.Element) -> None:
    """Remove the visuals where MuJoCo would discard them: their meshes may be missing."""
    if compiler.get("discardvisual", "true") != "true":
        return
    for link in robot.iter("link"):
        for visual in link.findall("visual"):
            link.remove(visual)


def _state_velocities(spec: mujoco.MjSpec, robot: ElementTree.Element) -> None:
    """Put velocity limits into the joints' `user` data; 0 where the URDF states none."""
    spec.nuser_jnt = 2
    for element in robot.iter("joint"):
        limit, joint = element.find("limit"), spec.joint(element.get("name", ""))
        if joint is None:
            continue
        velocity = "0" if limit is None else limit.get("velocity", "0")
        try:
            joint.userdata = [float(velocity), 0.0]
        except ValueError:
            raise WorkcellError(
                f"joint {joint.name!r}: its velocity limit {velocity!r} is no number"
            ) from None


def _mesh_path(
    urdf: Path, name: str, package_paths: Sequence[Path], compiler: ElementTree.Element
) -> Path:
    """File of a mesh, where MuJoCo's settings say, else where the mesh's name says.

    Raises:
        WorkcellError: there is no such file; the message says where it was looked for.
    """
    folder = urdf.parent / compiler.get("meshdir", "")
    relative = name.removeprefix("file://").removeprefix(PACKAGE)
    candidates = [folder / relative] if "meshdir" in compiler.attrib else []
    if compiler.get("strippath") == "true":
        candidates.append(folder / Path(relative).name)
    for path in candidates:
        if path.is_file():
            return path.resolve()
    if not name.startswith(PACKAGE):
        path = urdf.parent / name.removeprefix("file://")
        if not path.is_file():
            raise WorkcellError(f"{urdf.name}: the mesh {name} is missing: there is no {path}")
        return path.resolve()
    package, _, member = name.removeprefix(PACKAGE).partition("/")
    for folder in _package_folders(urdf, package, package_paths):
        if (folder / member).is_file():
            return (folder / member).resolve()
    raise WorkcellError(
        f"{urdf.name}: the mesh {name} is missing: no package {package!r} with {member} is in or "
        f"above {urdf.resolve().parent}, in --package-path, {' or '.join(_VARIABLES)}; name the "
        "folder that holds the package with --package-path"
    )


def _package_folders(urdf: Path, package: str, package_paths: Sequence[Path]):
    """Folders that may be the package: those named, those around the URDF, those of ROS."""
    parents = [urdf.resolve().parent, *urdf.resolve().parents]
    user_folders = [Path(folder) for folder in package_paths]
    ros_folders = [
        Path(p) for v in _VARIABLES for p in os.environ.get(v, "").split(os.pathsep) if p
    ]
    for folder in [*user_folders, *parents, *ros_folders]:
        if folder.name == package:
            yield folder
        yield folder / package
        yield folder / "share" / package
