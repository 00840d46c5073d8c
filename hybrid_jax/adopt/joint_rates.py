# SPDX-License-Identifier: MIT
"""Speed limits of joints that state none, by the size of the arm."""

import mujoco
import numpy as np

from hybrid_jax.workcell.chain import joint_frames, reference_data
from hybrid_jax.workcell.layout import Layout

TOOL_SPEED = 1.0
"""Speed of the tool that one hinge alone may give it [m/s]."""
HINGE_SPEEDS = 0.5, 3.0
"""Limits of what follows from it [rad/s]."""
SLIDE_SPEED = 0.3
"""Speed of a slide [m/s]."""
SLIDE_RANGE = 5.0
"""How far a slide without a range may go either way [m]."""
RAMP = 0.25
"""Time in which a joint reaches its speed [s]."""


def state_rates(spec: mujoco.MjSpec, model: mujoco.MjModel, layout: Layout) -> list[str]:
    """Give the arm's joints the limits that they lack, in their `user` data.

    Args:
        spec: to be changed.
        model: compiled from it.
        layout: of the arm.

    Returns:
        A sentence for each joint that got one.
    """
    spec.nuser_jnt = max(2, int(model.nuser_jnt))
    data, notes = reference_data(model, layout), []
    points = [frame.translation for frame in joint_frames(model, data, layout)]
    points.append(data.site_xpos[layout.tool_site].copy())
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    for number, name in enumerate(layout.joint_names):
        joint, unit = spec.joint(name), layout.joint_units[number]
        stated = np.zeros(2)
        values = np.asarray(joint.userdata, float).ravel()[:2]
        stated[: len(values)] = values
        reach = max(float(steps[number:].sum()), 1e-3)
        speed = SLIDE_SPEED if unit == "m" else float(np.clip(TOOL_SPEED / reach, *HINGE_SPEEDS))
        speed = stated[0] if stated[0] > 0 else round(speed, 2)
        acceleration = stated[1] if stated[1] > 0 else round(speed / RAMP, 2)
        rest = np.asarray(joint.userdata, float).ravel()[2:]
        joint.userdata = [speed, acceleration, *rest]
        if stated[0] <= 0:
            notes.append(
                f"joint {name!r} states no velocity limit: {speed:g} {unit}/s, by its size"
            )
        if stated[1] <= 0:
            notes.append(
                f"joint {name!r} states no acceleration limit: {acceleration:g} {unit}/s^2, which "
                f"reaches its speed in {RAMP:g} s"
            )
        if unit == "m" and not model.jnt_limited[layout.joints[number]]:
            joint.limited, joint.range = (
                mujoco.mjtLimited.mjLIMITED_TRUE,
                [-SLIDE_RANGE, SLIDE_RANGE],
            )
            notes.append(f"slide {name!r} states no range: {-SLIDE_RANGE:g} to {SLIDE_RANGE:g} m")
    return notes
