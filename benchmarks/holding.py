# SPDX-License-Identifier: MIT
"""How far held objects creep: `python -m benchmarks.holding [--json FILE]`.

Each object is gripped, lifted, and held for 30 s; and it is carried through a whole planned
transfer, in C MuJoCo. Holding is measured once more with the pyramidal friction cones that MJX
is run with.
"""

import copy
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import tyro
from scipy.spatial.transform import Rotation

from benchmarks.report import metric, write
from hybrid_jax.execution.contact_sensors import SensedCell, sense_cell
from hybrid_jax.execution.engines import HostEngine, get_state
from hybrid_jax.execution.plant import Plant, Steps
from hybrid_jax.execution.scheduler import drive
from hybrid_jax.execution.single_tasks import execute
from hybrid_jax.ik import solve_ik
from hybrid_jax.planner.bridging import rrt_bridger
from hybrid_jax.planner.pipeline import plan_batch
from hybrid_jax.planner.rrt_connect import RrtConfig
from hybrid_jax.runs.load_planner import untrained_planner
from hybrid_jax.runs.seeds import HOLDING
from hybrid_jax.tasks.registry import make_task
from hybrid_jax.tasks.scene_sampling import sample_scene
from hybrid_jax.tasks.task import Task
from hybrid_jax.types import Workcell
from hybrid_jax.workcell.load import load_workcell

HOLD = 30.0
"""Time of holding [s]."""


def at_grasp(sensed: SensedCell, model: mujoco.MjModel, task: Task) -> tuple[Plant, np.ndarray]:
    """A plant whose tool stands at the grasp, and the joint way that lifts the object."""
    cell, ends = sensed.cell, [np.asarray(sensed.cell.home)]
    for pose in task.key_poses[1:3]:
        found = np.asarray(solve_ik(cell, jnp.asarray(pose), key=jax.random.key(0)).branches)
        nearest = np.abs(found - ends[-1]).max(axis=1).argmin()
        ends.append(found[nearest].astype(float))
    plant = Plant(sensed, task.object_poses, 25, model)
    plant.data.qpos[list(sensed.layout.qpos)] = plant.target = ends[1]
    mujoco.mj_forward(model, plant.data)
    plant.state = get_state(model, plant.data)
    return plant, ends[2] - ends[1]


def squeeze(plant: Plant, way: np.ndarray, seconds: float) -> Steps:
    """Closed fingers while the arm goes a joint way in the given time."""
    share = np.linspace(0, 1, round(seconds / plant.dt))[:, None]
    everything = np.ones((len(plant.sensed.movers), len(plant.sensed.things)), bool)
    q = plant.target + share * way
    for chunk in plant.chunks(q, np.zeros_like(q), plant.spec.gripper.squeeze):
        yield from plant.step(chunk, everything)


def turn_in_tool(plant: Plant, index: int) -> Rotation:
    """Rotation of an object in the tool's frame."""
    tool = plant.data.site_xmat[plant.layout.tool_site].reshape(3, 3)
    body = plant.data.xmat[plant.layout.object_bodies[index]].reshape(3, 3)
    return Rotation.from_matrix(tool.T @ body)


def creep(
    sensed: SensedCell, model: mujoco.MjModel, task: Task, seconds: float
) -> tuple[float, float]:
    """How far [m] and by which angle [deg] a lifted object moves in the tool while it is held."""
    engine, index = HostEngine(sensed), sensed.layout.object_names.index(task.object_name)
    plant, way = at_grasp(sensed, model, task)
    for motion, lasts in ((0 * way, 0.8), (way, 2.0), (0 * way, 0.5)):
        drive([squeeze(plant, motion, lasts)], engine)
    before = plant.object_in_tool(index), turn_in_tool(plant, index)
    drive([squeeze(plant, 0 * way, seconds)], engine)
    turn = (before[1].inv() * turn_in_tool(plant, index)).magnitude()
    return float(np.linalg.norm(plant.object_in_tool(index) - before[0])), float(np.degrees(turn))


def transfers(cell: Workcell, tasks: list[Task]) -> list[float]:
    """How far each object moves in the tool in a planned transfer [m]."""
    planner = replace(untrained_planner(cell, 0.1), bridge=rrt_bridger(cell, RrtConfig()))
    plans = plan_batch(planner, tasks, key=jax.random.key(0))
    return [execute(cell, task, plan).slip for task, plan in zip(tasks, plans, strict=True)]


def main(json: Path | None = None, tiny: bool = False) -> None:
    """Print all figures.

    Args:
        json: file to write them to.
        tiny: as little of everything as shows that it runs.
    """
    cell = load_workcell("gen3_handling")
    sensed, poses = sense_cell(cell), sample_scene(cell, HOLDING.start)
    pyramids = copy.deepcopy(sensed.model)
    pyramids.opt.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL
    tasks = [make_task(cell, name, poses) for name in cell.source.layout.object_names]
    tasks, seconds = (tasks[:1], 0.2) if tiny else (tasks, HOLD)
    found = []
    for task, slip in zip(tasks, transfers(cell, tasks), strict=True):
        (way, turn), (far, wide) = (
            creep(sensed, model, task, seconds) for model in (sensed.model, pyramids)
        )
        note = f"{turn:.3f} deg; as pyramids: {1e3 * far:.3f} mm, {wide:.3f} deg"
        found += [
            metric(f"holding.{task.object_name}_creep", 1e3 * way, "mm", "lower", note),
            metric(
                f"holding.{task.object_name}_transfer",
                1e3 * slip,
                "mm",
                "lower",
                "in the tool, from grip to release",
            ),
        ]
    write(found, json, {"HOLDING": HOLDING})


if __name__ == "__main__":
    tyro.cli(main)
