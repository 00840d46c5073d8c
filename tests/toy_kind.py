# SPDX-License-Identifier: MIT
"""A toy kind of task: lift an object and put it back. `docs/adding_a_task.md` leads through it."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from hybrid_jax.contracts import Judgement
from hybrid_jax.execution.single_tasks import show  # noqa: F401  (a part of the protocol)
from hybrid_jax.tasks.scene_sampling import require_kind, sample_scene
from hybrid_jax.tasks.task import Hold, Task, as_dual_quats, start_of, upright, yaw_of
from hybrid_jax.workcell.description import ControllerSpec, GripperSpec
from hybrid_jax.workcell.poses import as_row
from hybrid_jax.workcell.records import by_name, record, records

EXECUTION, STUDY = __name__, "hybrid_jax.studies.single_tasks"
GRASP = RigidTransform.from_components([0.0, 0.0, 0.008], Rotation.from_euler("x", np.pi))


@dataclass(frozen=True)
class Weight:
    name: str
    grip: float  # half width of the object between the fingers [m]
    spawn: tuple[float, float, float]
    jitter: tuple[float, float, float]


@dataclass(frozen=True)
class Lifting:
    kind: ClassVar[str] = "lifting"
    tool_site: str
    table: str
    height: float  # by which an object is lifted [m]
    gripper: GripperSpec
    objects: tuple[Weight, ...]
    controller: ControllerSpec | None = None

    @property
    def fixture_names(self):
        return (self.table,)

    def held_in_tool(self, name):
        return as_row(GRASP.inv())


def read(tables, file):
    gripper = record(GripperSpec, tables["gripper"], f"{file} [gripper]")
    objects = records(Weight, tables["objects"], f"{file} [[objects]]")
    return record(Lifting, tables | {"gripper": gripper, "objects": objects}, file)


def make_task(cell, object_name, object_poses, start=None):
    data = require_kind(cell, Lifting, "lifted")
    pose = object_poses[cell.source.layout.object_names.index(object_name)]
    grasp = upright(pose[:3], yaw_of(pose)) * GRASP
    up = RigidTransform.from_components(grasp.translation + [0, 0, data.height], grasp.rotation)
    start, tool = start_of(cell, start)
    opening = by_name("object", object_name, data.objects).grip
    hold = Hold(as_row(GRASP.inv()), opening, (data.table,))
    poses = np.stack([tool, *as_dual_quats([grasp, up, grasp])])
    held, released = (False, True, True), data.gripper.open
    return Task(object_name, object_poses, poses, held, start, hold=hold, opening=released)


def random_task(cell, seed):
    objects = require_kind(cell, Lifting, "lifted").objects
    return make_task(cell, objects[seed % len(objects)].name, sample_scene(cell, seed))


def judge(plant, task):
    index = plant.layout.object_names.index(task.object_name)
    moved = plant.objects()[index, :3] - task.object_poses[index, :3]
    distance = float(np.linalg.norm(moved))
    return Judgement("" if distance < 0.005 else "not put back", {"moved_mm": 1e3 * distance})
