# SPDX-License-Identifier: MIT
"""MuJoCo's positions, quaternions and matrices as SciPy poses, float64 on the host."""

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation


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
