# SPDX-License-Identifier: MIT
"""What an execution may meet that its planner did not know."""

import copy
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from hybrid_jax.simulation.plant import Plant
from hybrid_jax.types import Workcell


@dataclass(frozen=True)
class Disturbance:
    """How far the cell differs from what the planner is told."""

    position: float = 0.0
    """Standard deviation of each horizontal coordinate of an object's measured place [m], ..."""
    yaw: float = 0.0
    """... and of its measured heading [rad]; drawn anew for each plan."""
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
    """The model with other friction and masses; the same object where nothing differs."""
    if disturbance.friction == 1.0 and disturbance.mass == 1.0:
        return model
    model = copy.deepcopy(model)
    model.geom_friction[:] *= disturbance.friction
    bodies = list(cell.source.layout.object_bodies)
    model.body_mass[bodies] *= disturbance.mass
    model.body_inertia[bodies] *= disturbance.mass
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def measured(poses: np.ndarray, disturbance: Disturbance, rng: np.random.Generator) -> np.ndarray:
    """Object poses `[object, 7]` as a camera would tell them."""
    noise = rng.normal(size=(len(poses), 3))
    seen = np.array(poses, float)
    seen[:, :2] += disturbance.position * noise[:, :2]
    turns = Rotation.from_euler("z", disturbance.yaw * noise[:, 2:])
    upright = Rotation.from_quat(seen[:, 3:], scalar_first=True)
    seen[:, 3:] = (turns * upright).as_quat(scalar_first=True)
    return seen


def push(plant: Plant, index: int, distance: float, rng: np.random.Generator) -> bool:
    """Move an object along the table to where it touches nothing; False if there is no room."""
    pose = plant.objects()[index]
    body = plant.layout.object_bodies[index]
    data, address = plant.data, plant.layout.object_qpos[index]
    for angle in rng.uniform(0, 2 * np.pi, 16):
        moved = pose.copy()
        moved[:2] += distance * np.array([np.cos(angle), np.sin(angle)])
        data.qpos[address : address + 7] = moved
        mujoco.mj_forward(plant.model, data)
        bodies = plant.model.geom_bodyid[data.contact.geom]
        others = bodies[(bodies == body).any(axis=1)]
        table = plant.model.body(plant.spec.table).id
        free = np.isin(others, (body, table)).all()
        data.qpos[address : address + 7] = pose
        mujoco.mj_forward(plant.model, data)
        if free:
            plant.set_object(index, moved)
            return True
    return False
