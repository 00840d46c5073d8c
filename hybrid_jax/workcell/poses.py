# SPDX-License-Identifier: MIT
"""Poses in their different forms: MuJoCo's rows, SciPy's transforms, dual quaternions. Float64."""

import mujoco
import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation


def pose_of(position, quat_wxyz) -> RigidTransform:
    """SciPy pose of a position `[3]` [m] and a quaternion `[4]` (w, x, y, z), as in MuJoCo."""
    rotation = Rotation.from_quat(np.asarray(quat_wxyz, float), scalar_first=True)
    return RigidTransform.from_components(np.asarray(position, float), rotation)


def matrix_pose(position, matrix) -> RigidTransform:
    """SciPy pose of a position `[3]` [m] and a rotation matrix `[9]`, row by row as in MuJoCo."""
    return RigidTransform.from_components(
        np.asarray(position, float), Rotation.from_matrix(np.asarray(matrix, float).reshape(3, 3))
    )


def as_row(pose: RigidTransform) -> np.ndarray:
    """Position [m] and quaternion (w, x, y, z) of SciPy poses `[*b]`, as rows `[*b, 7]`."""
    return np.concatenate([pose.translation, pose.rotation.as_quat(scalar_first=True)], axis=-1)


def of_rows(rows: np.ndarray) -> RigidTransform:
    """SciPy poses `[*b]` of rows `[*b, 7]`: position [m], quaternion (w, x, y, z)."""
    return pose_of(rows[..., :3], rows[..., 3:])


def dual_quats(rows: np.ndarray) -> np.ndarray:
    """Unit dual quaternions `[*b, 8]` in float32 of rows `[*b, 7]`: position [m], quaternion."""
    position, (w, x, y, z) = np.moveaxis(rows[..., :3], -1, 0), np.moveaxis(rows[..., 3:], -1, 0)
    # SciPy makes real parts positive, but signs along a path must not jump. The dual part is half
    # the product of the position, as a quaternion, and the rotation (paper, `t r / 2`)
    a, b, c = position / 2
    dual = [
        -a * x - b * y - c * z,
        a * w + b * z - c * y,
        b * w + c * x - a * z,
        c * w + a * y - b * x,
    ]
    return np.concatenate([rows[..., 3:], np.stack(dual, axis=-1)], axis=-1).astype(np.float32)


def pose_row(pose: np.ndarray) -> np.ndarray:
    """Position [m] and quaternion (w, x, y, z) of a dual quaternion `[8]`, as one row `[7]`."""
    pose = np.asarray(pose, float)
    # the translation is the vector part of 2 d r* (paper, section "Dual Quaternion")
    conjugate, product = np.empty(4), np.empty(4)
    mujoco.mju_negQuat(conjugate, pose[:4])
    mujoco.mju_mulQuat(product, pose[4:], conjugate)
    return np.concatenate([2 * product[1:], pose[:4]])
