# SPDX-License-Identifier: MIT
"""Problems of MotionBenchMaker as work cells: one cell a problem, one trace a scene.

The robot is the spheres of the data; boxes stay boxes, cylinders become prisms that contain them.
The robots are the Panda, and Fetch: an arm of seven joints on a lift.
"""

import json
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from hybrid_jax.adopt.exclusions import exclude_pairs
from hybrid_jax.adopt.joint_rates import state_rates
from hybrid_jax.adopt.semantic_description import read_srdf
from hybrid_jax.types import Workcell
from hybrid_jax.workcell.compile import compile_workcell
from hybrid_jax.workcell.layout import find_layout
from hybrid_jax.workcell.load import compile_spec
from hybrid_jax.workcell.urdf import read_urdf

ACCELERATIONS = (15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0)
"""Limits of the Panda's joints, by its maker's data sheet [rad/s^2]."""
ROUNDING = 1e-4
"""How far an end may be outside a limit [rad or m]."""
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


def fetch_spec(folder: Path) -> mujoco.MjSpec:
    """Fetch of the data: its spheres, the pairs of its SRDF left out, accelerations by its size."""
    spec = read_urdf(folder / "fetch_spherized.urdf")
    spec.body("gripper_link").add_site(name="tool")
    exclude_pairs(spec, read_srdf(folder / "fetch.srdf").disabled)
    model = compile_spec(spec)
    state_rates(spec, model, find_layout(model, None))
    return spec


def panda_spec(folder: Path) -> mujoco.MjSpec:
    """The Panda of the data: spheres on links, pairs that the data do not check left out."""
    robot = json.loads((folder / "panda_robot.json").read_text())
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


SPECS = {"panda": panda_spec, "fetch": fetch_spec}
"""Robots of the data; the problems of each are in its `ROBOT_problems.npz`."""


def file_of(folder: Path) -> tuple[str, Path] | None:
    """Robot and file of the problems in a folder; None where it has none."""
    files = [(robot, folder / f"{robot}_problems.npz") for robot in SPECS]
    return next(((robot, file) for robot, file in files if file.is_file()), None)


def read_problems(folder: Path, every: int = 1, first: int = 0) -> list[Problem]:
    """The problems, or every n-th of each scene, from the number `first` on.

    Problems that the data themselves call invalid are left out.

    Raises:
        FileNotFoundError: the folder lacks the data.
    """
    found = file_of(folder)
    if found is None:
        raise FileNotFoundError(f"{folder} has no problems of {' or '.join(SPECS)}")
    robot, path = found
    with np.load(path) as file:
        data = {name: file[name] for name in file.files}
    valid = data.get("exact_valid", np.ones(len(data["index"]), bool))
    chosen = [i for i in np.flatnonzero(valid) if data["index"][i] % every == first]
    return [
        _problem(SPECS[robot](folder), f"{robot}_{scene}", data, i)
        for scene in dict.fromkeys(data["name"][chosen])
        for i in chosen
        if data["name"][i] == scene
    ]


def _problem(spec: mujoco.MjSpec, name: str, data: dict, i: int) -> Problem:
    """One problem; its ends are put on the limits where the data round them beyond."""
    _add_obstacles(spec, data, i)
    cell = compile_workcell(spec.compile(), name, None)
    low, high = np.asarray(cell.joint_limits).T
    ends = [np.asarray(data[key][i], np.float32).reshape(-1) for key in ("start", "goals")]
    for q in ends:
        rounded = np.clip(q, low, high)
        if np.abs(rounded - q).max() > ROUNDING:
            raise ValueError(f"{name} {data['index'][i]}: an end is outside the limits")
        q[:] = rounded
    return Problem(str(data["name"][i]), int(data["index"][i]), cell, *ends)
