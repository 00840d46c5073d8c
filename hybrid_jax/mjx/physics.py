# SPDX-License-Identifier: MIT
"""The cell's physics on MJX: batched, on any JAX device, from the same model.

On a CPU C MuJoCo is faster (`execution`), on an accelerator this is the engine.
"""

import copy

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jax import Array
from jaxtyping import Float
from mujoco import mjx

from hybrid_jax.types import Workcell
from hybrid_jax.workcell.layout import home_qpos


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


def put_cell(cell: Workcell) -> mjx.Model:
    """The cell's model on the device."""
    return mjx.put_model(device_model(cell.model))


def start_state(cell: Workcell, qpos: Float[Array, " nq"] | None = None) -> mjx.Data:
    """A simulation at rest, its servos holding the arm.

    Args:
        cell: the cell.
        qpos: `[nq]` to begin with, in MuJoCo's units; home if None.

    Returns:
        MJX's data: `qpos` `[nq]`, `ctrl` `[nu]`, `qvel` zero.
    """
    qpos = jnp.asarray(home_qpos(cell.model) if qpos is None else qpos, jnp.float32)
    return mjx.make_data(device_model(cell.model)).replace(qpos=qpos, ctrl=hold_command(cell, qpos))


def hold_command(cell: Workcell, qpos: Float[Array, " nq"]) -> Float[Array, " nu"]:
    """Command `[nu]` under which the servos hold the arm at `qpos` `[nq]`, the gripper open."""
    layout = cell.source.layout
    pairs = zip(layout.actuators, layout.qpos, strict=True)
    # -1 stands for a joint without a servo
    servos = np.array([pair for pair in pairs if pair[0] >= 0], int).reshape(-1, 2)
    ctrl = jnp.zeros(cell.model.nu).at[servos[:, 0]].set(qpos[servos[:, 1]])
    if layout.gripper_actuator >= 0:
        ctrl = ctrl.at[layout.gripper_actuator].set(cell.source.task.gripper.open)
    return ctrl


def step(model: mjx.Model, data: mjx.Data, steps: int) -> mjx.Data:
    """The data after so many physics steps under their command `ctrl` `[nu]`."""
    return jax.lax.fori_loop(0, steps, lambda _, d: mjx.step(model, d), data)


def settle_in_engine(cell: Workcell, qpos: np.ndarray, steps: int) -> np.ndarray:
    """`qpos` `[nq]` after the same steps in C MuJoCo from `qpos` `[nq]`: the oracle of `step`."""
    data = mujoco.MjData(cell.model)
    data.qpos[:] = qpos
    data.ctrl[:] = np.asarray(hold_command(cell, jnp.asarray(qpos)))
    for _ in range(steps):
        mujoco.mj_step(cell.model, data)
    return data.qpos.copy()
