# SPDX-License-Identifier: MIT
"""A home for a model that states none and whose joints cannot all be at zero."""

import mujoco
import numpy as np

TRIES = 200
"""Configurations that are looked at, ever further from the first one."""
INSIDE = 0.1
"""Share of a joint's range that home keeps from both ends, where zero lies outside."""
_ONE = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))


def free_home(model: mujoco.MjModel) -> np.ndarray | None:
    """`[nq]` the configuration next to zero that is within the limits and touches nothing.

    Returns:
        None where the model has a keyframe, or zero within all limits. Where everything that was
        tried touches something, what was tried first.
    """
    joints = [j for j in range(model.njnt) if model.jnt_limited[j] and model.jnt_type[j] in _ONE]
    address, (low, high) = model.jnt_qposadr[joints], model.jnt_range[joints].T
    zero = model.qpos0[address]
    if model.nkey or ((low <= zero) & (zero <= high)).all() or (low > high).any():
        return None
    keep = INSIDE * (high - low)
    first = np.where((low <= zero) & (zero <= high), zero, np.clip(zero, low + keep, high - keep))
    rng, data = np.random.default_rng(0), mujoco.MjData(model)
    for attempt in range(TRIES):
        share = attempt / TRIES
        q = first + share * (rng.uniform(low, high) - first)
        data.qpos[:] = model.qpos0
        data.qpos[address] = q
        mujoco.mj_fwdPosition(model, data)
        if not (data.contact.dist[: data.ncon] < 0).any():
            return data.qpos.copy()
    data.qpos[address] = first
    return data.qpos.copy()
