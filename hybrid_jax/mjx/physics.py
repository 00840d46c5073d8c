# SPDX-License-Identifier: MIT
"""The cell's model as MJX simulates it, with contacts: the engine of accelerators (`execution`)."""

import copy

import mujoco


def device_model(model: mujoco.MjModel) -> mujoco.MjModel:
    """Copy a model for MJX, with clocks for contact sensors: it has none of whole bodies.

    In float32 the solver's late iterations add noise: resting bolts jump by millimetres after 100
    of them, by less than one after 20. And with elliptic cones a grip blows up, unless friction is
    so soft that held objects creep out of it; pyramids hold them.
    """
    model = copy.deepcopy(model)
    model.opt.iterations, model.opt.ls_iterations = 20, 20
    model.opt.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL
    contact = model.sensor_type == int(mujoco.mjtSensor.mjSENS_CONTACT)
    model.sensor_type[contact] = int(mujoco.mjtSensor.mjSENS_CLOCK)
    return model
