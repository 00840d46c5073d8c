# SPDX-License-Identifier: MIT
"""URDF as an MjSpec, with what MuJoCo's importer leaves out: `package://` and velocity limits."""

import functools
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np

from hybrid_jax.errors import WorkcellError
from hybrid_jax.runtime.terminal import remark
from hybrid_jax.workcell.mesh_files import readable_mesh
from hybrid_jax.workcell.ros_packages import PACKAGE, package_folders, where_packages_were_sought
from hybrid_jax.workcell.xacro_files import ENDING, expand_xacro

LEAST_MASS, LEAST_INERTIA = 1e-4, 1e-8
"""Mass [kg] and inertia [kg m^2] of a moving link that states less."""


def read_urdf(
    path: Path,
    package_paths: Sequence[Path] = (),
    xacro_arguments: Mapping[str, str] | None = None,
    *,
    with_meshes: bool = True,
) -> mujoco.MjSpec:
    """Spec of a URDF, with velocity limits in the joints' `user` data as in a cell's MJCF.

    Args:
        path: of the file, or of a xacro file.
        package_paths: folders that hold ROS packages, looked at first.
        xacro_arguments: values of a xacro file's arguments by their names.
        with_meshes: False to leave out all geometry, to see what else is wrong.

    Raises:
        WorkcellError: the file is no XML, or the package or file of a mesh is not found.
        ValueError: MuJoCo cannot read it.
    """
    try:
        if path.suffix.lower() == ENDING:
            content = expand_xacro(path, package_paths, xacro_arguments).encode()
        else:
            content = path.read_bytes()
        robot = ElementTree.fromstring(_with_prefixes(content))
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise WorkcellError(f"{path.name} is no XML: {error}") from None
    compiler = _compiler(robot)
    _mend_inertias(path, robot)
    _leave_visuals_out(robot, compiler)
    if with_meshes:
        _name_meshes(path, robot, package_paths, compiler)
    else:
        _remove(robot, "visual", "collision")
    spec = mujoco.MjSpec.from_string(ElementTree.tostring(robot, encoding="unicode"))
    spec.compiler.fusestatic = False  # a tool link without geometry would vanish
    spec.compiler.balanceinertia = True
    # links that only carry frames have no mass, which MuJoCo refuses where they move
    spec.compiler.boundmass = max(spec.compiler.boundmass, LEAST_MASS)
    spec.compiler.boundinertia = max(spec.compiler.boundinertia, LEAST_INERTIA)
    _state_velocities(spec, robot)
    return spec


def _name_meshes(
    path: Path,
    robot: ElementTree.Element,
    package_paths: Sequence[Path],
    compiler: ElementTree.Element,
) -> None:
    """Name all meshes by whole paths of files that MuJoCo reads.

    Raises:
        WorkcellError: for all that are missing, empty or of an unknown kind together.
    """
    faults = []
    for mesh in robot.iter("mesh"):
        try:
            if "filename" in mesh.attrib:
                file = _mesh_path(path, mesh.get("filename", ""), package_paths, compiler)
                mesh.set("filename", str(readable_mesh(file)))
        except WorkcellError as error:
            faults.append(str(error))
    if faults:
        raise WorkcellError("; ".join(dict.fromkeys(faults)))
    # these two settings would change whole paths
    compiler.set("strippath", "false")
    compiler.attrib.pop("meshdir", None)


def _remove(robot: ElementTree.Element, *kinds: str) -> None:
    """Remove elements of some kinds from all links."""
    for link in robot.iter("link"):
        for element in [e for kind in kinds for e in link.findall(kind)]:
            link.remove(element)


def _mend_inertias(path: Path, robot: ElementTree.Element) -> None:
    """Replace matrices that are no inertias, which MuJoCo refuses: no plan depends on them."""
    names = "ixx", "iyy", "izz", "ixy", "ixz", "iyz"
    for link in robot.iter("link"):
        for element in link.iter("inertia"):
            try:
                xx, yy, zz, xy, xz, yz = (float(element.get(name, "0")) for name in names)
            except ValueError:
                continue  # MuJoCo names it
            matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            if not np.isfinite(matrix).all() or np.linalg.eigvalsh(matrix)[0] > 0:
                continue
            for name in names:
                element.set(name, str(1e-4 if name[1] == name[2] else 0))
            if matrix.any():
                _say_once(
                    f"{path.name}: the inertia of link {link.get('name')!r} is none: one of "
                    "its eigenvalues is not positive. A small one is used"
                )


@functools.cache
def _say_once(sentence: str) -> None:
    remark(sentence)


def _with_prefixes(content: bytes) -> bytes:
    """The same XML, in which prefixes of names that nothing declares are declared.

    ROS's own readers know no namespaces, so extensions of others (`drake:`) often stand so.
    """
    used = set(re.findall(rb"</?([A-Za-z_][\w.-]*):[A-Za-z_]", content))
    used |= set(re.findall(rb"\s([A-Za-z_][\w.-]*):[\w.-]+\s*=\s*[\"']", content))
    declared = set(re.findall(rb"xmlns:([\w.-]+)", content))
    missing = b"".join(
        b' xmlns:%b="%b"' % (name, name) for name in sorted(used - declared - {b"xml", b"xmlns"})
    )
    return re.sub(rb"<robot\b", lambda match: match[0] + missing, content, count=1)


def _compiler(robot: ElementTree.Element) -> ElementTree.Element:
    """Element of MuJoCo's compiler settings in a URDF; it is added where there is none."""
    extension = robot.find("mujoco")
    if extension is None:
        extension = ElementTree.SubElement(robot, "mujoco")
    compiler = extension.find("compiler")
    return ElementTree.SubElement(extension, "compiler") if compiler is None else compiler


def _leave_visuals_out(robot: ElementTree.Element, compiler: ElementTree.Element) -> None:
    """Remove the visuals where MuJoCo would discard them: their meshes may be missing."""
    if compiler.get("discardvisual", "true") == "true":
        _remove(robot, "visual")


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
    for folder in package_folders(urdf, package, package_paths):
        if (folder / member).is_file():
            return (folder / member).resolve()
    raise WorkcellError(
        f"{urdf.name}: the mesh {name} is missing: no package {package!r} with {member} is "
        f"{where_packages_were_sought(urdf)}; name the folder that holds the package with "
        "--package-path"
    )
