# SPDX-License-Identifier: MIT
"""A model in a browser page: its geoms as meshes, moved by configurations."""

from collections.abc import Container

import mujoco
import numpy as np
import trimesh
import viser

_KIND = mujoco.mjtGeom
_HIDDEN_GROUPS = (3, 4, 5)
"""Geom groups that are not drawn, as in MuJoCo's own viewer."""
_PLANE = 4.0
"""Side of a plane without size [m]."""


def _mesh(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh | None:
    """Triangles of a geom in its own frame; None for a type that is not drawn."""
    # `geom_size`: half extents of boxes and planes, radius and half length of capsules, cylinders
    kind, size = int(model.geom_type[geom]), model.geom_size[geom]
    if kind == _KIND.mjGEOM_BOX:
        return trimesh.creation.box(2 * size)
    if kind == _KIND.mjGEOM_SPHERE:
        return trimesh.creation.icosphere(2, size[0])
    if kind == _KIND.mjGEOM_CAPSULE:
        return trimesh.creation.capsule(2 * size[1], size[0], count=(12, 12))
    if kind == _KIND.mjGEOM_CYLINDER:
        return trimesh.creation.cylinder(size[0], 2 * size[1], sections=24)
    if kind == _KIND.mjGEOM_ELLIPSOID:
        return trimesh.creation.icosphere(2).apply_scale(size)
    if kind == _KIND.mjGEOM_PLANE:
        return trimesh.creation.box([*(2 * s if s else _PLANE for s in size[:2]), 0.001])
    if kind == _KIND.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        face, faces = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
        return trimesh.Trimesh(
            model.mesh_vert[first : first + count], model.mesh_face[face : face + faces]
        )
    return None


def _colour(model: mujoco.MjModel, geom: int) -> np.ndarray:
    material = int(model.geom_matid[geom])
    return model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]


class WebScene:
    """The geoms of a model in a viser scene, one frame for each body."""

    def __init__(
        self,
        server: viser.ViserServer,
        model: mujoco.MjModel,
        root: str = "/cell",
        without: Container[int] = (),
    ):
        """Draw the model; `show` moves it.

        Args:
            server: of the scene.
            model: to draw.
            root: name of its frame in the scene.
            without: bodies that are not drawn.
        """
        self._model, self._data = model, mujoco.MjData(model)
        self._frames = {}
        self.root = server.scene.add_frame(root, show_axes=False)
        for geom in range(model.ngeom):
            body = int(model.geom_bodyid[geom])
            if body in without or int(model.geom_group[geom]) in _HIDDEN_GROUPS:
                continue
            mesh = _mesh(model, geom)
            if mesh is None:
                continue
            name = f"{root}/{body}"
            if body not in self._frames:
                self._frames[body] = server.scene.add_frame(name, show_axes=False)
            rgba = _colour(model, geom)
            server.scene.add_mesh_simple(
                f"{name}/{geom}",
                mesh.vertices,
                mesh.faces,
                color=tuple(float(c) for c in rgba[:3]),
                opacity=float(rgba[3]),
                wxyz=model.geom_quat[geom],
                position=model.geom_pos[geom],
            )

    def show(self, qpos: np.ndarray) -> None:
        """Move every body to its pose in a configuration `[nq]`."""
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, self._data)
        for body, frame in self._frames.items():
            frame.position, frame.wxyz = self._data.xpos[body], self._data.xquat[body]
