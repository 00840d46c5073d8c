# SPDX-License-Identifier: MIT
"""Mesh files that MuJoCo does not read, as files that it does."""

import hashlib
import tempfile
from pathlib import Path

from hybrid_jax.errors import WorkcellError

READABLE = ".stl", ".obj", ".msh"
"""Endings of the files that MuJoCo reads; of STL the binary kind only."""


def readable_mesh(path: Path) -> Path:
    """A file with the same mesh that MuJoCo reads: the file itself where it does.

    Raises:
        WorkcellError: the file is empty, or is no mesh, or takes a package that is not installed.
    """
    if not path.stat().st_size:
        raise WorkcellError(f"the mesh file {path} is empty")
    ending = path.suffix.lower()
    if ending == ".stl" and path.stat().st_size == 84 and not _is_text(path):
        raise WorkcellError(f"the mesh {path} has no faces")
    if ending in READABLE and not (ending == ".stl" and _is_text(path)):
        return path
    content = hashlib.sha256(path.read_bytes()).hexdigest()[:16]
    folder = Path(tempfile.gettempdir()) / "hybrid_jax_meshes"
    written = folder / f"{path.stem}_{content}.stl"
    if not written.is_file():
        folder.mkdir(exist_ok=True)
        _convert(path, written)
    return written


def _is_text(path: Path) -> bool:
    """Is an STL file of the kind that is text? A binary one has the size that its head states."""
    with path.open("rb") as file:
        head = file.read(84)
    return len(head) < 84 or path.stat().st_size != 84 + 50 * int.from_bytes(head[80:84], "little")


def _convert(path: Path, written: Path) -> None:
    try:
        import trimesh
    except ImportError:
        raise WorkcellError(
            f"the mesh {path.name} is of a kind that takes trimesh: pip install 'hybrid_jax[adopt]'"
        ) from None
    try:
        mesh = trimesh.load(path, force="mesh")
        content = trimesh.exchange.stl.export_stl(mesh)
    except Exception as error:  # trimesh and its loaders have no common base of their errors
        raise WorkcellError(f"the mesh {path} cannot be read: {error}") from None
    if not len(mesh.faces):
        raise WorkcellError(f"the mesh {path} has no faces")
    partial = written.with_suffix(f".{id(mesh)}.partial")
    partial.write_bytes(content)
    partial.replace(written)
