# SPDX-License-Identifier: MIT
"""The serial arm of an `MjModel` as a kinematic chain."""

import jax.numpy as jnp
import mujoco
import numpy as np

from hybrid_jax.errors import WorkcellError
from hybrid_jax.types import KinematicChain
from hybrid_jax.workcell.layout import Layout, home_qpos
from hybrid_jax.workcell.poses import as_row, matrix_pose, pose_of

DEFAULT_VELOCITY = 1.0
"""Velocity limit of a joint whose `user` data states none [rad/s or m/s]: slow on purpose."""
DEFAULT_ACCELERATION = 5.0
"""The same for accelerations [rad/s^2 or m/s^2]."""
UNLIMITED = -2 * np.pi, 2 * np.pi
"""Range about home in which a hinge without limits is planned [rad]: a turn either way."""
_HINGE = int(mujoco.mjtJoint.mjJNT_HINGE)


def reference_data(model: mujoco.MjModel, layout: Layout) -> mujoco.MjData:
    """Kinematics with the arm at its reference, the fingers closed, the rest at home."""
    data = mujoco.MjData(model)
    data.qpos[:] = home_qpos(model)
    data.qpos[list(layout.qpos)] = model.qpos0[list(layout.qpos)]
    data.qpos[[model.jnt_qposadr[j] for j in layout.fingers]] = 0.0
    mujoco.mj_kinematics(model, data)
    return data


def joint_frames(model, data, layout) -> list:
    """World pose of each joint's frame in the reference configuration."""
    frames = []
    for j in layout.joints:
        body = model.jnt_bodyid[j]
        pose = matrix_pose(data.xpos[body], data.xmat[body])
        frames.append(pose * pose_of(model.jnt_pos[j], [1, 0, 0, 0]))
    return frames


def _limits(model, layout) -> np.ndarray:
    rows, home = [], home_qpos(model)[list(layout.qpos)]
    for name, j, zero in zip(layout.joint_names, layout.joints, home, strict=True):
        low, high = model.jnt_range[j]
        if low > high or model.jnt_limited[j] and low == high:
            # MuJoCo takes a range that is turned round as none
            raise WorkcellError(
                f"joint {name!r} has the range {low:g} to {high:g}: the lower limit comes first"
            )
        if model.jnt_limited[j]:
            rows.append((low, high))
        elif model.jnt_type[j] == _HINGE:
            rows.append((zero + UNLIMITED[0], zero + UNLIMITED[1]))
        else:
            raise WorkcellError(f"slide joint {name!r} has no range: add range='lower upper'")
    return np.array(rows)


def _rates(model, layout, column: int, default: float) -> np.ndarray:
    """What is stated, else the default.

    Raises:
        WorkcellError: a limit that is no finite number.
    """
    if model.nuser_jnt <= column:
        return np.full(len(layout.joints), default)
    stated = model.jnt_user[list(layout.joints), column]
    for name, value in zip(layout.joint_names, stated, strict=True):
        if not np.isfinite(value):
            what = ("velocity", "acceleration")[column]
            raise WorkcellError(f"joint {name!r} has the {what} limit {value}: it must be finite")
    return np.where(stated > 0, stated, default)


def kinematic_chain(model, data, layout) -> KinematicChain:
    """The arm as the kernels read it.

    Raises:
        WorkcellError: a slide joint without a range, or a limit that is no finite number.
    """
    frames = joint_frames(model, data, layout)
    base = pose_of([0, 0, 0], [1, 0, 0, 0])
    before = [base, *frames[:-1]]
    offsets = [as_row(a.inv() * b) for a, b in zip(before, frames, strict=True)]
    site = layout.tool_site
    tool = matrix_pose(data.site_xpos[site], data.site_xmat[site])
    joints = list(layout.joints)
    arrays = (
        as_row(base),
        np.stack(offsets),
        model.jnt_axis[joints],
        (model.jnt_type[joints] == _HINGE).astype(float),
        model.qpos0[list(layout.qpos)],
        as_row(frames[-1].inv() * tool),
        _limits(model, layout),
        _rates(model, layout, 0, DEFAULT_VELOCITY),
        _rates(model, layout, 1, DEFAULT_ACCELERATION),
    )
    return KinematicChain(*(jnp.asarray(np.asarray(a, np.float32)) for a in arrays))
