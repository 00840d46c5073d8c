# SPDX-License-Identifier: MIT
"""A camera that sees a whole cell, and a sky behind it, for its pictures and films."""

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

CAMERA = "overview"
"""Name of the camera that films use."""
_FROM = np.array([0.75, -1.0, 0.55])
"""Direction from the cell to the camera."""
_SPAN = 1.15
"""Distance of the camera as a multiple of the radius of what it sees."""


def add_overview(spec: mujoco.MjSpec, model: mujoco.MjModel, qpos: np.ndarray) -> None:
    """Add the camera and the sky, where the model has none.

    Args:
        spec: to be added to.
        model: compiled from it.
        qpos: `[nq]` the configuration that the camera is to see.
    """
    skies = [t for t in spec.textures if t.type == mujoco.mjtTexture.mjTEXTURE_SKYBOX]
    if not skies:
        spec.add_texture(
            name="sky",
            type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
            builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
            rgb1=[0.95, 0.96, 0.98],
            rgb2=[0.75, 0.8, 0.86],
            width=64,
            height=64,
        )
        spec.visual.headlight.ambient = [0.45, 0.45, 0.45]
        spec.visual.headlight.diffuse = [0.6, 0.6, 0.6]
    if CAMERA in {camera.name for camera in spec.cameras}:
        return
    low, high = _bounds(model, qpos)
    away = _FROM / np.linalg.norm(_FROM)
    half_angle = np.radians(model.vis.global_.fovy) / 2
    distance = _SPAN * np.linalg.norm(high - low) / 2 / np.tan(half_angle) / 1.5
    right = np.cross([0.0, 0.0, 1.0], away)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(away, right), away], axis=1)
    spec.worldbody.add_camera(
        name=CAMERA,
        pos=(low + high) / 2 + distance * away,
        quat=Rotation.from_matrix(axes).as_quat(scalar_first=True),
    )


def _bounds(model: mujoco.MjModel, qpos: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners of a box around all geoms but planes, `[3]` each [m]."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    solid = np.flatnonzero(model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE)
    if not len(solid):
        return -np.ones(3), np.ones(3)
    centre, radius = data.geom_xpos[solid], model.geom_rbound[solid, None]
    return (centre - radius).min(axis=0), (centre + radius).max(axis=0)
