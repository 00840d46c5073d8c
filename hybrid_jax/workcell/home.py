# SPDX-License-Identifier: MIT
"""A home for a model that states none and whose joints cannot all be at zero."""

import mujoco
import numpy as np

TRIES = 200
"""Configurations that are tried, further and further from the first one."""
INSIDE = 0.1
"""Share of a joint's range that home keeps from both ends, where zero lies outside."""
_ONE = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))


def free_home(model: mujoco.MjModel) -> np.ndarray | None:
    """A configuration near zero that is within the limits and touches nothing.

    Returns:
        A whole `qpos` `[nq]`; the first one tried where all of them touch something. None where
        the model has a keyframe, zero is within all limits, or a range has its limits exchanged.
    """
    joints = [j for j in range(model.njnt) if model.jnt_limited[j] and model.jnt_type[j] in _ONE]
    address, (low, high) = model.jnt_qposadr[joints], model.jnt_range[joints].T
    zero = model.qpos0[address]
    # a range with the limits exchanged is refused later, by the name of its joint
    if model.nkey or ((low <= zero) & (zero <= high)).all() or (low > high).any():
        return None
    inset = INSIDE * (high - low)
    first = np.where((low <= zero) & (zero <= high), zero, np.clip(zero, low + inset, high - inset))
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
