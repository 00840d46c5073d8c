# SPDX-License-Identifier: MIT
"""Servos and gravity compensation that a vendor's file lacks, so that plans can be simulated."""

import mujoco
import numpy as np

from hybrid_jax.workcell.layout import Layout, body_path

FREQUENCY = 60.0
"""Natural frequency of a joint's servo, critically damped [rad/s]."""
ARMATURE_SHARE = 0.05
"""Rotor inertia of a joint that states none, as a share of the inertia that it moves."""
_SAMPLES = 64
"""Random configurations whose largest inertia counts."""


def add_servos(spec: mujoco.MjSpec, model: mujoco.MjModel, layout: Layout) -> list[str]:
    """Give the arm's joints position servos where they have no actuator.

    The gains follow from the inertia that the joint moves.

    Args:
        spec: to be changed.
        model: compiled from it.
        layout: of the arm.

    Returns:
        A sentence that names the joints; none where all have actuators.
    """
    bare = [i for i, actuator in enumerate(layout.actuators) if actuator < 0]
    if not bare:
        return []
    inertias = _inertias(model, layout)
    for i in bare:
        joint = spec.joint(layout.joint_names[i])
        if joint.armature <= 0:
            joint.armature = round(ARMATURE_SHARE * inertias[i], 6)
        inertia = inertias[i] + joint.armature
        low, high = model.jnt_range[layout.joints[i]]
        servo = spec.add_actuator(
            name=f"servo_{joint.name}",
            target=joint.name,
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
        )
        gain = FREQUENCY**2 * inertia
        servo.set_to_position(kp=round(gain, 3), kv=round(2 * FREQUENCY * inertia, 3))
        if model.jnt_limited[layout.joints[i]]:
            servo.ctrlrange = [low, high]
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    names = ", ".join(layout.joint_names[i] for i in bare)
    return [
        f"the joints {names} have no actuators: position servos of {FREQUENCY:g} rad/s, "
        "critically damped"
    ]


def compensate_gravity(spec: mujoco.MjSpec, model: mujoco.MjModel, layout: Layout) -> list[str]:
    """Let no link of the arm sag by its weight, as the controllers of real arms see to.

    Args:
        spec: to be changed.
        model: compiled from it.
        layout: of the arm.

    Returns:
        A sentence; none where the file compensates gravity itself.
    """
    first_link = int(model.jnt_bodyid[layout.joints[0]])
    links = [body for body in spec.bodies if first_link in body_path(model, body.id)]
    # a gripper that was mounted may have it already
    moved = model.jnt_bodyid[list(layout.joints)]
    if all(body.gravcomp for body in links if body.id in moved):
        return []
    for body in links:
        body.gravcomp = body.gravcomp or 1.0
    return ["the simulation compensates the arm's weight, as its controller does"]


def _inertias(model: mujoco.MjModel, layout: Layout) -> np.ndarray:
    """`[joint]` largest inertia that each joint of the arm moves [kg m^2 or kg]."""
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    limited = model.jnt_limited[list(layout.joints)].astype(bool)[:, None]
    low, high = np.where(limited, model.jnt_range[list(layout.joints)], [-np.pi, np.pi]).T
    dofs, largest = list(layout.dofs), np.zeros(len(layout.dofs))
    matrix = np.zeros((model.nv, model.nv))
    for _ in range(_SAMPLES):
        data.qpos[list(layout.qpos)] = rng.uniform(low, high)
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, matrix)
        largest = np.maximum(largest, matrix.diagonal()[dofs])
    return largest
