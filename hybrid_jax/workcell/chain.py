# SPDX-License-Identifier: MIT
"""The serial arm of an `MjModel` as a kinematic chain."""

import mujoco
import numpy as np

from hybrid_jax.errors import WorkcellError
from hybrid_jax.types import KinematicChain
from hybrid_jax.workcell.layout import Layout, home_qpos
from hybrid_jax.workcell.poses import as_row, matrix_pose, pose_of

DEFAULT_VELOCITY = 1.0
"""Velocity limit of a joint whose `user` data states none [rad/s or m/s]: slow on purpose."""
DEFAULT_ACCELERATION = 5.0
"""Acceleration limit of a joint whose `user` data states none [rad/s^2 or m/s^2]."""
UNLIMITED = -2 * np.pi, 2 * np.pi
"""Range about home that a hinge without limits is given [rad]: one turn either way."""
_HINGE = int(mujoco.mjtJoint.mjJNT_HINGE)


def reference_data(model: mujoco.MjModel, layout: Layout) -> mujoco.MjData:
    """Kinematics with the arm at its reference, the fingers closed, all else at home."""
    # `MjData` starts at `qpos0`, not at home: joints that are not the arm's are set as well
    data = mujoco.MjData(model)
    data.qpos[:] = home_qpos(model)
    data.qpos[list(layout.qpos)] = model.qpos0[list(layout.qpos)]
    data.qpos[[model.jnt_qposadr[j] for j in layout.fingers]] = 0.0
    mujoco.mj_kinematics(model, data)
    return data


def joint_frames(model, data, layout) -> list:
    """World pose of each arm joint's frame at the configuration of `data`.

    The frame sits at the joint's anchor and has the axes of the joint's body.
    """
    frames = []
    for j in layout.joints:
        body = model.jnt_bodyid[j]
        pose = matrix_pose(data.xpos[body], data.xmat[body])
        frames.append(pose * pose_of(model.jnt_pos[j], [1, 0, 0, 0]))
    return frames


def _limits(model, layout) -> np.ndarray:
    """`[joint, 2]` lower and upper limit of each arm joint [rad or m]."""
    limits, home = [], home_qpos(model)[list(layout.qpos)]
    for name, j, zero in zip(layout.joint_names, layout.joints, home, strict=True):
        low, high = model.jnt_range[j]
        if low > high or model.jnt_limited[j] and low == high:
            # MuJoCo takes a range with the limits exchanged as no range
            raise WorkcellError(
                f"joint {name!r} has the range {low:g} to {high:g}: the lower limit comes first"
            )
        if model.jnt_limited[j]:
            limits.append((low, high))
        elif model.jnt_type[j] == _HINGE:
            limits.append((zero + UNLIMITED[0], zero + UNLIMITED[1]))
        else:
            raise WorkcellError(f"slide joint {name!r} has no range: add range='lower upper'")
    return np.array(limits)


def _rates(model, layout, column: int, default: float) -> np.ndarray:
    """`[joint]` values of one column of the joints' `user` data, or the default where it is 0.

    Raises:
        WorkcellError: a limit that is no finite number.
    """
    if model.nuser_jnt <= column:
        return np.full(len(layout.joints), default)
    limits = model.jnt_user[list(layout.joints), column]
    for name, value in zip(layout.joint_names, limits, strict=True):
        if not np.isfinite(value):
            quantity = ("velocity", "acceleration")[column]
            raise WorkcellError(
                f"joint {name!r} has the {quantity} limit {value}: it must be finite"
            )
    return np.where(limits > 0, limits, default)


def kinematic_chain(model, data, layout) -> KinematicChain:
    """The arm as the kernels read it, in float32.

    Args:
        model: of the cell.
        data: its kinematics in the reference configuration, from `reference_data`.
        layout: where the arm is in the model.

    Returns:
        Frames `[joint, 7]`, axes `[joint, 3]` and limits `[joint, 2]`, see `KinematicChain`.

    Raises:
        WorkcellError: a slide joint without a range, or a limit that is no finite number.
    """
    frames = joint_frames(model, data, layout)
    # the arm's fixed base is merged into the first offset: the chain starts at the world's origin
    base = pose_of([0, 0, 0], [1, 0, 0, 0])
    parents = [base, *frames[:-1]]
    offsets = [as_row(a.inv() * b) for a, b in zip(parents, frames, strict=True)]
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
    return KinematicChain(*(np.asarray(a, np.float32) for a in arrays))
