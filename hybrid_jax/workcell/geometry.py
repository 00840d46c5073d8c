# SPDX-License-Identifier: MIT
"""Collision geoms of an `MjModel` as the kernels' primitives. Host side, float64."""

from dataclasses import dataclass

import jax.numpy as jnp
import mujoco
import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from hybrid_jax.errors import WorkcellError
from hybrid_jax.types import Shapes

_G = mujoco.mjtGeom
SPHERE, CAPSULE, BOX, PLANE = (
    int(g) for g in (_G.mjGEOM_SPHERE, _G.mjGEOM_CAPSULE, _G.mjGEOM_BOX, _G.mjGEOM_PLANE)
)


@dataclass(frozen=True)
class Primitive:
    """One geom in the frame that carries it."""

    geom: int
    pose: RigidTransform
    size: np.ndarray
    """Capsule: radius, half length; box: half extents."""
    box: bool


def pose_of(position, quat_wxyz) -> RigidTransform:
    """SciPy pose from MuJoCo's position and quaternion."""
    rotation = Rotation.from_quat(np.asarray(quat_wxyz, float), scalar_first=True)
    return RigidTransform.from_components(np.asarray(position, float), rotation)


def matrix_pose(position, matrix) -> RigidTransform:
    """SciPy pose from MuJoCo's position and flat rotation matrix."""
    return RigidTransform.from_components(
        np.asarray(position, float), Rotation.from_matrix(np.asarray(matrix, float).reshape(3, 3))
    )


def as_row(pose: RigidTransform) -> np.ndarray:
    """`[7]`: position, quaternion (w, x, y, z)."""
    return np.concatenate([pose.translation, pose.rotation.as_quat(scalar_first=True)])


def geom_label(model: mujoco.MjModel, geom: int) -> str:
    """How messages name a geom."""
    body = model.body(model.geom_bodyid[geom]).name
    return f"{model.geom(geom).name or f'#{geom}'} (of body {body or 'world'!r})"


def collision_geoms(model: mujoco.MjModel) -> list[int]:
    """Geoms that can touch something.

    Raises:
        WorkcellError: a geom of a kind that the kernels cannot represent.
    """
    geoms = [g for g in range(model.ngeom) if model.geom_contype[g] or model.geom_conaffinity[g]]
    for g in geoms:
        kind = int(model.geom_type[g])
        if kind not in (SPHERE, CAPSULE, BOX, PLANE):
            raise WorkcellError(
                f"geom {geom_label(model, g)} is a {_G(kind).name[7:].lower()}; "
                "collision geoms must be spheres, capsules, boxes or planes. Approximate it with "
                "those, or set contype and conaffinity to 0 if it is only for show."
            )
    return geoms


def primitive(model, data, geom: int, frame: RigidTransform) -> Primitive:
    """A geom expressed in `frame` at the configuration of `data`."""
    world = matrix_pose(data.geom_xpos[geom], data.geom_xmat[geom])
    size = model.geom_size[geom].copy()
    kind = int(model.geom_type[geom])
    if kind == SPHERE:
        size[1] = 0.0
    return Primitive(geom, frame.inv() * world, size, bool(kind == BOX))


def plane_row(data, geom: int) -> np.ndarray:
    """`[4]` unit normal and offset of a plane geom."""
    normal = data.geom_xmat[geom].reshape(3, 3)[:, 2]
    return np.append(normal, normal @ data.geom_xpos[geom])


def to_shapes(primitives: list[Primitive], capsules: int = 0, boxes: int = 0) -> Shapes:
    """Pack primitives into arrays, padded with empty slots up to the given counts."""
    round_ones = [p for p in primitives if not p.box]
    box_ones = [p for p in primitives if p.box]
    capsules, boxes = max(capsules, len(round_ones)), max(boxes, len(box_ones))
    ends, radius = np.zeros((capsules, 2, 3)), np.full(capsules, 1e-3)
    pose, half = np.zeros((boxes, 7)), np.full((boxes, 3), 1e-3)
    pose[:, 3] = 1.0
    for i, p in enumerate(round_ones):
        axis = np.array([0.0, 0.0, p.size[1]])
        ends[i], radius[i] = p.pose.apply(np.stack([-axis, axis])), p.size[0]
    for i, p in enumerate(box_ones):
        pose[i], half[i] = as_row(p.pose), p.size
    on = [
        (np.arange(n) < len(used)).astype(np.float32)
        for n, used in ((capsules, round_ones), (boxes, box_ones))
    ]
    arrays = [np.asarray(a, np.float32) for a in (ends, radius, on[0], pose, half, on[1])]
    return Shapes(*(jnp.asarray(a) for a in arrays))
