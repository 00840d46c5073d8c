# SPDX-License-Identifier: MIT
"""Plans that nobody planned: random arms of hinges and slides, random motions, gripper or none."""

from types import SimpleNamespace

import mujoco
import numpy as np

from hybrid_jax.contracts import PlanResult
from hybrid_jax.planner.timing import TimingConfig, resting, time_parameterize
from hybrid_jax.tasks.task import Task
from hybrid_jax.types import Status
from hybrid_jax.workcell.compile import compile_workcell
from hybrid_jax.workcell.description import ControllerSpec

OPEN, CLOSE = "RO[1]=OFF", "RO[1]=ON"
STILL = 0.1
"""Share of phases in which there is nothing to do."""
RANGES = {"hinge": 2.6, "slide": 0.7}


def random_cell(rng: np.random.Generator, kinds=None):
    """An arm of 2 to 7 joints whose controller runs TP programs."""
    kinds = kinds or rng.choice(["hinge", "slide"], rng.integers(2, 8), p=[0.7, 0.3]).tolist()
    text, end = "", ""
    for number, kind in enumerate(kinds):
        axis = np.eye(3)[rng.integers(3)]
        low_high = RANGES[kind] * np.array([-1, 1])
        rates = rng.uniform(0.3, 3.0), rng.uniform(1.0, 12.0)
        text += (
            f'<body pos="{rng.uniform(0, 0.2):.3f} 0 {rng.uniform(0.05, 0.25):.3f}">'
            f'<joint name="j{number}" type="{kind}" axis="{" ".join(map(str, axis))}" '
            f'range="{low_high[0]} {low_high[1]}" user="{rates[0]:.3f} {rates[1]:.3f}"/>'
            '<geom size=".01" mass=".1"/>'
        )
        end += "</body>"
    xml = (
        '<mujoco><compiler angle="radian"/><size nuser_jnt="2"/><worldbody>'
        f'{text}<site name="tool" pos=".1 0 0"/>{end}</worldbody></mujoco>'
    )
    cell = compile_workcell(mujoco.MjModel.from_xml_string(xml), "random", None)
    cell.source.task = SimpleNamespace(controller=ControllerSpec("tp", open=OPEN, close=CLOSE))
    return cell


def random_plan(cell, rng: np.random.Generator, phases=None, carries=None):
    """A task and its plan: each phase a random smooth motion from rest to rest."""
    phases = phases or int(rng.integers(1, 5))
    carries = bool(rng.integers(2)) if carries is None else carries
    # what is held changes at each stop; without a gripper the arm stops only
    carrying = tuple(bool(carries and i % 2) for i in range(phases))
    stops = () if carries else tuple(range(1, phases))
    low, high = np.asarray(cell.joint_limits, float).T
    task = Task(
        "thing",
        np.zeros((0, 7)),
        np.tile([1.0, 0, 0, 0, 0, 0, 0, 0], (phases + 1, 1)),
        carrying,
        np.zeros(len(low)),
        stops=stops,
    )
    config = TimingConfig(speed=rng.uniform(0.3, 1.0), acceleration=rng.uniform(0.2, 1.0))
    middle, width = (low + high) / 2, (high - low) / 2
    at, paths, still = middle + 0.5 * width * rng.uniform(-1, 1, len(low)), [], {}
    for number in range(len(task.phases)):
        if rng.random() < STILL:
            end = at + rng.uniform(-9e-6, 9e-6, len(low))
            still[number], at = resting(cell, at, end, 0), end
            continue
        count = int(rng.integers(3, 9))
        away = np.cumsum(rng.normal(0, 0.15, (count, len(low))), axis=0) * width
        q = np.clip(np.vstack([at, at + away]), middle - 0.9 * width, middle + 0.9 * width)
        paths.append((q, rng.integers(0, 3, count + 1)))
        at = q[-1]
    moving = iter(time_parameterize(cell, paths, config) if paths else [])
    found = [still[i] if i in still else next(moving) for i in range(len(task.phases))]
    return task, PlanResult(Status.OK, "found", found)
