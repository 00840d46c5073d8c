# SPDX-License-Identifier: MIT
"""The Panda problems of MotionBenchMaker as work cells: one cell a problem, one trace a scene.

The robot is the spheres of the data; boxes stay boxes, cylinders become prisms that contain them.
"""

import json
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from hybrid_jax.types import Workcell
from hybrid_jax.workcell.compile import compile_workcell

ACCELERATIONS = (15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0)
"""Limits of the Panda's joints, by its maker's data sheet [rad/s^2]."""
BOX, CYLINDER = 1, 2
"""Types of obstacles in the data."""


@dataclass(frozen=True)
class Problem:
    """From one configuration to another."""

    scene: str
    number: int
    cell: Workcell
    start: np.ndarray
    goal: np.ndarray


def _quat(rpy) -> np.ndarray:
    return Rotation.from_euler("xyz", rpy).as_quat(scalar_first=True)


def robot_spec(robot: dict) -> mujoco.MjSpec:
    """The arm of the data: spheres on links, pairs that the data do not check left out."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.nuser_jnt = 2
    bodies = {"panda_link0": spec.worldbody.add_body(name="panda_link0")}
    speeds = iter(ACCELERATIONS)
    for joint in robot["joints"]:
        body = bodies[joint["parent"]].add_body(
            name=joint["child"], pos=joint["xyz"], quat=_quat(joint["rpy"])
        )
        bodies[joint["child"]] = body
        if joint["type"] == "revolute":
            body.add_joint(
                name=joint["name"],
                axis=joint["axis"],
                range=[joint["lower"], joint["upper"]],
                limited=True,
                userdata=[joint["velocity"], next(speeds)],
            )
    bodies[robot["end_effector"]].add_site(name="tool")
    for number, sphere in enumerate(robot["spheres"]):
        bodies[sphere["link"]].add_geom(
            name=f"{sphere['link']}_{number}",
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            pos=sphere["center"],
            size=[sphere["radius"], 0, 0],
            mass=0.1,
        )
    checked = {frozenset(pair) for pair in robot["vamp_checked_self_pairs"]}
    for a, b in combinations(sorted({s["link"] for s in robot["spheres"]}), 2):
        if frozenset((a, b)) not in checked:
            spec.add_exclude(bodyname1=a, bodyname2=b)
    return spec


def _add_obstacles(spec: mujoco.MjSpec, data: dict, i: int) -> None:
    for k in range(int(data["n_obs"][i])):
        pose, size = data["obs_pose"][i, k], data["obs_dims"][i, k]
        quat = Rotation.from_matrix(pose[:3, :3]).as_quat(scalar_first=True)
        kind = {BOX: mujoco.mjtGeom.mjGEOM_BOX, CYLINDER: mujoco.mjtGeom.mjGEOM_CYLINDER}
        spec.worldbody.add_geom(
            name=f"{data['obs_name'][i, k]}_{k}",
            type=kind[int(data["obs_type"][i, k])],
            pos=pose[:3, 3],
            quat=quat,
            size=size,
        )


def read_problems(folder: Path, every: int = 1, first: int = 0) -> list[Problem]:
    """The valid problems, or every n-th of each scene, from the number `first` on.

    Raises:
        FileNotFoundError: the folder lacks the data.
    """
    robot = json.loads((folder / "panda_robot.json").read_text())
    with np.load(folder / "panda_problems.npz") as file:
        data = {name: file[name] for name in file.files}
    chosen = [i for i in np.flatnonzero(data["exact_valid"]) if data["index"][i] % every == first]
    found = []
    for scene in dict.fromkeys(data["name"][chosen]):
        here = [i for i in chosen if data["name"][i] == scene]
        cells = [_compiled(robot, data, i) for i in here]
        found += [
            Problem(
                str(scene),
                int(data["index"][i]),
                cell,
                data["start"][i].astype(np.float32),
                data["goals"][i, 0].astype(np.float32),
            )
            for i, cell in zip(here, cells, strict=True)
        ]
    return found


def _compiled(robot: dict, data: dict, i: int) -> Workcell:
    spec = robot_spec(robot)
    _add_obstacles(spec, data, i)
    return compile_workcell(spec.compile(), f"panda_{data['name'][i]}", None)
