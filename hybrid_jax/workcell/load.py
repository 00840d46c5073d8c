# SPDX-License-Identifier: MIT
"""From a name or a file to a work cell that is fit to plan in."""

from pathlib import Path

import jax.numpy as jnp
import mujoco
import numpy as np

from hybrid_jax.compilecache import enable_compile_cache
from hybrid_jax.errors import WorkcellError
from hybrid_jax.quiet import engine_messages
from hybrid_jax.types import Workcell
from hybrid_jax.workcell.assets import find_workcell
from hybrid_jax.workcell.compile import MESH_TOLERANCE, compile_workcell
from hybrid_jax.workcell.contacts import home_overlaps
from hybrid_jax.workcell.description import read_task_data
from hybrid_jax.workcell.layout import TOOL_NAMES, home_qpos
from hybrid_jax.workcell.scene import place_objects

_NUMBERS = ("body_pos", "body_quat", "geom_pos", "geom_quat", "geom_size", "jnt_pos", "jnt_axis",
            "jnt_range", "site_pos", "site_quat", "mesh_vert", "qpos0", "key_qpos")  # fmt: skip
"""Arrays of a model that geometry is computed from."""
_ABSURD = 1e6
"""No length of a work cell is larger [m]."""


def _read_urdf(path: Path) -> mujoco.MjModel:
    """Compile a URDF; its tool is the link with a usual name, else the last link of the arm."""
    spec = mujoco.MjSpec.from_file(str(path))
    spec.compiler.fusestatic = False  # a tool link without geometry would vanish
    named = [body for body in spec.bodies if body.name in TOOL_NAMES]
    (named or spec.bodies)[-1].add_site(name="tool")
    return spec.compile()


def read_model(path: Path) -> mujoco.MjModel:
    """Compile an MJCF, URDF or MJB file.

    Raises:
        WorkcellError: MuJoCo cannot read it (its own message is passed on), or a number in it is
            not finite or absurd.
    """
    try:
        with engine_messages(path.name):
            if path.suffix == ".mjb":
                model = mujoco.MjModel.from_binary_path(str(path))
            elif path.suffix == ".urdf":
                model = _read_urdf(path)
            else:
                model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise WorkcellError(f"{path.name}: MuJoCo cannot read it: {error}") from None
    try:
        model.names.decode()
    except UnicodeDecodeError as error:
        raise WorkcellError(f"{path.name}: a name in it is no UTF-8 text: {error}") from None
    for name in _NUMBERS:
        if not (np.abs(getattr(model, name)) < _ABSURD).all():
            raise WorkcellError(f"{path.name}: {name} holds a number that is not finite or absurd")
    return model


def load_workcell(name_or_path: str | Path, *, mesh_tolerance: float = MESH_TOLERANCE) -> Workcell:
    """Load a work cell by the name of a shipped one or from an MJCF file.

    A file `CELL.toml` beside `CELL.xml` holds the task data (objects, grasps, strokes). Joint
    velocity and acceleration limits stand in the joints' `user` data. Compiled programs are kept
    between processes from now on, see `compilecache`.

    Args:
        name_or_path: name of a shipped cell, or path of an MJCF, URDF or MJB file.
        mesh_tolerance: how far the boxes of a mesh may stand out of its convex hull [m].

    Returns:
        The cell with its objects and arm as in the keyframe `home`.

    Raises:
        UnknownNameError: no such cell; the message lists the shipped ones.
        WorkcellError: the cell cannot be planned in; the message names the geom or joint.
    """
    enable_compile_cache()
    path = find_workcell(name_or_path)
    model = read_model(path)
    task = read_task_data(path.with_suffix(".toml"))
    cell = compile_workcell(model, path.stem, task, mesh_tolerance, path)
    for sentence in home_overlaps(model, cell.source.layout):
        raise WorkcellError(sentence)
    home = home_qpos(model)
    poses = [home[a : a + 7] for a in cell.source.layout.object_qpos]
    return place_objects(cell, jnp.asarray(np.array(poses, np.float32).reshape(-1, 7)))
