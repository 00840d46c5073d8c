# SPDX-License-Identifier: MIT
"""Load a work cell from a name or a file, and refuse one that cannot be planned in."""

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path

import jax
import mujoco
import numpy as np

from hybrid_jax.errors import HybridJaxError, WorkcellError
from hybrid_jax.kernels.argument_checks import single_precision
from hybrid_jax.runtime.compile_cache import enable_compile_cache
from hybrid_jax.runtime.devices import require_device
from hybrid_jax.runtime.quiet import engine_messages
from hybrid_jax.types import Workcell
from hybrid_jax.workcell.allowed_collisions import home_overlaps
from hybrid_jax.workcell.assets import find_workcell
from hybrid_jax.workcell.compile import compile_workcell
from hybrid_jax.workcell.convex_hulls import MESH_TOLERANCE
from hybrid_jax.workcell.description import read_task_data
from hybrid_jax.workcell.home import free_home
from hybrid_jax.workcell.layout import home_qpos
from hybrid_jax.workcell.poses import as_row, of_rows
from hybrid_jax.workcell.tool_frame import set_tool
from hybrid_jax.workcell.urdf import read_urdf
from hybrid_jax.workcell.xacro_files import ENDING

_NUMBERS = (
    "body_pos",
    "body_quat",
    "geom_pos",
    "geom_quat",
    "geom_size",
    "jnt_pos",
    "jnt_axis",
    "jnt_range",
    "site_pos",
    "site_quat",
    "mesh_vert",
    "qpos0",
    "key_qpos",
)
"""Arrays of a model that geometry is computed from."""
_ABSURD = 1e6
"""Number from which on a model is refused: no length of a work cell is as large [m]."""


def is_urdf(path: Path) -> bool:
    """Is a file a URDF, or a xacro file that becomes one?"""
    return path.suffix.lower() in (".urdf", ENDING)


def as_spec(
    path: Path,
    package_paths: Sequence[Path] = (),
    xacro_arguments: Mapping[str, str] | None = None,
) -> mujoco.MjSpec:
    """Spec of an MJCF or URDF file as it is written; a URDF's is completed by `read_urdf`."""
    if is_urdf(path):
        return read_urdf(path, package_paths, xacro_arguments)
    if path.suffix == ".xml":
        return mujoco.MjSpec.from_file(str(path))
    # MuJoCo does not know a file by an ending in capitals
    spec = mujoco.MjSpec.from_string(path.read_text())
    spec.modelfiledir = str(path.parent)
    return spec


def read_spec(
    path: Path,
    tool: str = "",
    package_paths: Sequence[Path] = (),
    xacro_arguments: Mapping[str, str] | None = None,
) -> mujoco.MjSpec:
    """Spec of an MJCF or URDF file with a tool and, where it needs one, a home.

    A model without a keyframe whose joints cannot all be at zero gets one, see `free_home`.

    Args:
        path: of the file.
        tool: site or link that is the tool; found if empty.
        package_paths: folders that hold the ROS packages of a URDF's meshes.
        xacro_arguments: values of a xacro file's arguments by their names.

    Raises:
        ValueError: MuJoCo cannot read it.
        WorkcellError, UnknownNameError: see `read_model`.
    """
    spec = as_spec(path, package_paths, xacro_arguments)
    if tool or is_urdf(path):
        set_tool(spec, tool)
    home = free_home(compile_spec(spec))
    if home is not None:
        spec.add_key(name="home", qpos=home)
    return spec


def compile_spec(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Compile a spec without the warning that a file which includes another cannot be saved.

    Raises:
        WorkcellError: files of meshes or textures are missing, all by name.
        ValueError: MuJoCo finds something else wrong.
    """
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Attaching a spec", UserWarning)
            return spec.compile()
    except ValueError as error:
        missing = _missing_files(spec)
        # files of attached models lie elsewhere: only what MuJoCo itself misses counts
        if not any(Path(file).name in str(error) for file in missing):
            raise
        text = f"files that the model names are missing: {', '.join(missing)}"
        raise WorkcellError(text) from None


def _missing_files(spec: mujoco.MjSpec) -> list[str]:
    """Files of meshes and textures that are not there."""
    start = Path(spec.modelfiledir or ".")
    files = [
        start / (folder or "") / element.file
        for elements, folder in ((spec.meshes, spec.meshdir), (spec.textures, spec.texturedir))
        for element in elements
        if element.file
    ]
    return [str(file) for file in dict.fromkeys(files) if not file.is_file()]


def _compile(
    path: Path,
    tool: str,
    package_paths: Sequence[Path],
    xacro_arguments: Mapping[str, str] | None,
) -> tuple[mujoco.MjModel, mujoco.MjSpec | None]:
    if path.suffix.lower() == ".mjb":
        return mujoco.MjModel.from_binary_path(str(path)), None
    spec = read_spec(path, tool, package_paths, xacro_arguments)
    return compile_spec(spec), spec


def read_model(
    path: Path,
    tool: str = "",
    package_paths: Sequence[Path] = (),
    xacro_arguments: Mapping[str, str] | None = None,
) -> mujoco.MjModel:
    """Compile an MJCF, URDF or MJB file; see `read_model_and_spec`."""
    return read_model_and_spec(path, tool, package_paths, xacro_arguments)[0]


def read_model_and_spec(
    path: Path,
    tool: str = "",
    package_paths: Sequence[Path] = (),
    xacro_arguments: Mapping[str, str] | None = None,
) -> tuple[mujoco.MjModel, mujoco.MjSpec | None]:
    """Compile an MJCF, URDF or MJB file; see `read_spec`.

    Args:
        path: of the file.
        tool: site or link that is the tool; found if empty.
        package_paths: folders that hold the ROS packages of a URDF's meshes.
        xacro_arguments: values of a xacro file's arguments by their names.

    Returns:
        The model, and the spec that it was compiled from: None for an MJB file.

    Raises:
        WorkcellError: MuJoCo cannot read it (its own message is passed on), a number in it is not
            finite or absurd, or nothing tells which frame of a URDF is the tool.
        UnknownNameError: no such tool.
    """
    try:
        with engine_messages(path.name):
            model, spec = _compile(path, tool, package_paths, xacro_arguments)
    except ValueError as error:
        if isinstance(error, HybridJaxError):
            raise
        raise WorkcellError(f"{path.name}: MuJoCo cannot read it: {error}") from None
    try:
        model.names.decode()
    except UnicodeDecodeError as error:
        raise WorkcellError(f"{path.name}: a name in it is no UTF-8 text: {error}") from None
    for name in _NUMBERS:
        if not (np.abs(getattr(model, name)) < _ABSURD).all():
            raise WorkcellError(f"{path.name}: {name} holds a number that is not finite or absurd")
    return model, spec


@single_precision
def load_workcell(
    name_or_path: str | Path,
    *,
    mesh_tolerance: float = MESH_TOLERANCE,
    tool: str = "",
    package_paths: Sequence[Path] = (),
    xacro_arguments: Mapping[str, str] | None = None,
) -> Workcell:
    """Load a work cell by the name of a shipped one or from an MJCF file.

    A file `CELL.toml` beside `CELL.xml` holds the task data (objects, grasps, strokes). Joint
    velocity and acceleration limits stand in the joints' `user` data. Compiled programs are kept
    between processes from now on, see `runtime.compile_cache`.

    Args:
        name_or_path: name of a shipped cell, or path of an MJCF, URDF or MJB file.
        mesh_tolerance: how far the polytope of a mesh may stand out of its convex hull [m].
        tool: site or link that is the tool; as the task data say, or found, if empty.
        package_paths: folders that hold the ROS packages of a URDF's meshes.
        xacro_arguments: values of a xacro file's arguments by their names.

    Returns:
        The cell with its objects and arm as in the keyframe `home`.

    Raises:
        UnknownNameError: no such cell; the message lists the shipped ones.
        WorkcellError: the cell cannot be planned in; the message names the geom or joint.
        DeviceError: JAX has no device of the kind that JAX_PLATFORMS asks for.
    """
    enable_compile_cache()
    require_device()
    path = find_workcell(name_or_path)
    task = read_task_data(path.with_suffix(".toml"))
    model, spec = read_model_and_spec(path, tool, package_paths, xacro_arguments)
    cell = compile_workcell(model, path.stem, task, mesh_tolerance, path, tool, spec)
    for sentence in home_overlaps(model, cell.source.layout):
        raise WorkcellError(sentence)
    objects, home = cell.scene.objects, home_qpos(model)
    bodies = np.array([home[a : a + 7] for a in cell.source.layout.object_qpos]).reshape(-1, 7)
    if not objects.count:
        return cell
    owners = of_rows(bodies[list(cell.source.owners)])  # empty slots get the pose of the last
    rows = as_row(owners * of_rows(np.asarray(objects.pose, float))).astype(np.float32)
    objects = objects.replace(pose=jax.device_put(rows))
    return cell.replace(scene=cell.scene.replace(objects=objects))
