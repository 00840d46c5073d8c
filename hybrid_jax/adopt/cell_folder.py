# SPDX-License-Identifier: MIT
"""A cell as a folder of its own: MJCF, with copies of its meshes and textures beside it."""

import filecmp
import shutil
from pathlib import Path

import mujoco
import numpy as np

from hybrid_jax.errors import WorkcellError
from hybrid_jax.workcell.load import compile_spec

MESHES, TEXTURES = "meshes", "textures"


def absolute_assets(spec: mujoco.MjSpec) -> None:
    """Name the files of a spec's meshes and textures by whole paths."""
    start = Path(spec.modelfiledir or ".")
    for elements, folder in ((spec.meshes, spec.meshdir), (spec.textures, spec.texturedir)):
        for element in elements:
            if element.file:
                element.file = str((start / (folder or "") / element.file).resolve())
    spec.meshdir = spec.texturedir = ""


def write_cell(spec: mujoco.MjSpec, folder: Path, name: str) -> Path:
    """Write a cell folder: `NAME.xml`, its meshes and textures.

    Args:
        spec: whose files are named by whole paths (`absolute_assets`).
        folder: to write to; it is made.
        name: of the cell.

    Raises:
        WorkcellError: the folder holds another cell of that name, or MuJoCo does not compile it.
    """
    path = folder / f"{name}.xml"
    if path.exists():
        raise WorkcellError(f"{path} exists: name another folder with --out, or remove it")
    folder.mkdir(parents=True, exist_ok=True)
    for elements, inner in ((spec.meshes, MESHES), (spec.textures, TEXTURES)):
        for element in elements:
            if element.file:
                element.file = _copied(Path(element.file), folder / inner)
    spec.meshdir, spec.texturedir, spec.modelname = MESHES, TEXTURES, name
    spec.modelfiledir = str(folder.resolve())
    _state_inertias(spec, compile_spec(spec))
    path.write_text(spec.to_xml())
    return path


def _state_inertias(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """Write down the inertias as the compiler balanced them: a file has no word for that."""
    for body in spec.bodies:
        if body.explicitinertial:
            body.fullinertia = [np.nan] * 6
            inertia = model.body_inertia[body.id].copy()
            # at its bound, the largest one would exceed it once all three are rounded
            inertia = np.minimum(inertia, 0.9999 * (inertia.sum() - inertia))
            body.mass, body.inertia = model.body_mass[body.id], inertia
            body.ipos, body.iquat = model.body_ipos[body.id], model.body_iquat[body.id]


def _copied(file: Path, folder: Path) -> str:
    """Copy a file to a folder; its name there, another one where a different file has that name."""
    folder.mkdir(exist_ok=True)
    target, number = folder / file.name, 2
    while target.exists() and not filecmp.cmp(file, target, shallow=False):
        target, number = folder / f"{file.stem}_{number}{file.suffix}", number + 1
    if not target.exists():
        shutil.copyfile(file, target)
    return target.name
