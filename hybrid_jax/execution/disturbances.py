# SPDX-License-Identifier: MIT
"""Disturbances: how a simulated cell differs from what its planner knows."""

import copy
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from hybrid_jax.execution.plant import Plant
from hybrid_jax.types import Workcell


@dataclass(frozen=True)
class Disturbance:
    """How far the cell differs from what the planner is told."""

    position: float = 0.0
    """Standard deviation of an object's measured x and y [m]; drawn anew for each plan."""
    yaw: float = 0.0
    """Standard deviation of an object's measured heading [rad]; drawn anew for each plan."""
    friction: float = 1.0
    """Factor on all coefficients of friction."""
    mass: float = 1.0
    """Factor on the objects' masses."""
    push: float = 0.0
    """One object is moved this far in a random direction while the arm reaches for it [m]."""


CALM = Disturbance()
"""Everything is as the planner was told."""

DISTURBED = Disturbance(position=0.005, yaw=np.radians(3.0), friction=0.7, mass=1.5, push=0.03)
"""The study's disturbances, all at once."""


def disturbed_model(
    model: mujoco.MjModel, cell: Workcell, disturbance: Disturbance
) -> mujoco.MjModel:
    """Copy of a model with other friction and masses; the model itself where nothing differs.

    Args:
        model: of the cell, perhaps with sensors.
        cell: tells which bodies are objects.
        disturbance: `friction` and `mass` count here.

    Returns:
        A model of the same size.
    """
    if disturbance.friction == 1.0 and disturbance.mass == 1.0:
        return model
    model = copy.deepcopy(model)
    model.geom_friction[:] *= disturbance.friction
    bodies = list(cell.source.layout.object_bodies)
    model.body_mass[bodies] *= disturbance.mass
    model.body_inertia[bodies] *= disturbance.mass
    # constants that MuJoCo derives from masses and inertias
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def measured(poses: np.ndarray, disturbance: Disturbance, rng: np.random.Generator) -> np.ndarray:
    """Object poses with the errors of a camera's measurement.

    Args:
        poses: `[object, 7]` true positions [m] and quaternions.
        disturbance: `position` and `yaw` count here.
        rng: source of the errors; it advances by the same amount whatever their size.

    Returns:
        `[object, 7]` measured poses.
    """
    noise = rng.normal(size=(len(poses), 3))
    noisy = np.array(poses, float)
    noisy[:, :2] += disturbance.position * noise[:, :2]
    # the error turns about the world's vertical, so it stands on the left of the orientation
    turns = Rotation.from_euler("z", disturbance.yaw * noise[:, 2:])
    upright = Rotation.from_quat(noisy[:, 3:], scalar_first=True)
    noisy[:, 3:] = (turns * upright).as_quat(scalar_first=True)
    return noisy


def push(plant: Plant, index: int, distance: float, rng: np.random.Generator) -> bool:
    """Move an object along the table to where it touches nothing else.

    Args:
        plant: the simulated cell; its state changes.
        index: of the object.
        distance: by which it is moved, in a random direction [m].
        rng: source of directions.

    Returns:
        False if none of 16 directions has room.
    """
    pose = plant.objects()[index]
    body = plant.layout.object_bodies[index]
    data, address = plant.data, plant.layout.object_qpos[index]
    for angle in rng.uniform(0, 2 * np.pi, 16):
        shifted = pose.copy()
        shifted[:2] += distance * np.array([np.cos(angle), np.sin(angle)])
        data.qpos[address : address + 7] = shifted
        mujoco.mj_forward(plant.model, data)
        bodies = plant.model.geom_bodyid[data.contact.geom]
        contact_bodies = bodies[(bodies == body).any(axis=1)]
        table = plant.model.body(plant.spec.table).id
        free = np.isin(contact_bodies, (body, table)).all()
        # `data` served the test for contacts only: the simulation goes on from `plant.state`
        data.qpos[address : address + 7] = pose
        mujoco.mj_forward(plant.model, data)
        if free:
            plant.set_object(index, shifted)
            return True
    return False
