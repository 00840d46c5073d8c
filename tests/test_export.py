# SPDX-License-Identifier: MIT
"""Plans as files, read back by readers that share nothing with the writers, and the policy."""

import csv
import dataclasses
import json
import subprocess
import sys

import jax
import mujoco
import numpy as np
import pytest

from hybrid_jax.agents import joint, networks
from hybrid_jax.contracts import PlanResult
from hybrid_jax.errors import InputError, UnknownNameError, WorkcellError
from hybrid_jax.export import export_policy, to_joint_trajectory, write_plan
from hybrid_jax.export.fanuc_tp import controller_values, program_name, to_tp_program
from hybrid_jax.export.fanuc_tp_reader import read_tp_program
from hybrid_jax.export.waypoint_reduction import LEAST, TOLERANCE, reduced
from hybrid_jax.runs.run_folder import create_run
from hybrid_jax.tasks.registry import random_task
from hybrid_jax.types import Status, Trajectory
from hybrid_jax.workcell.description import ControllerSpec
from hybrid_jax.workcell.load import load_workcell


def phase(first, last, seconds, joints):
    """A smooth motion from rest to rest between two configurations."""
    times = np.linspace(0, seconds, 60)
    s = times / seconds
    step = np.outer(10 * s**3 - 15 * s**4 + 6 * s**5, np.ones(joints))
    q = first + step * (np.asarray(last) - first)
    v = np.outer(30 * s**2 - 60 * s**3 + 30 * s**4, np.asarray(last) - first) / seconds
    return Trajectory(times, q, v, np.gradient(v, times, axis=0), np.arange(60) // 30)


@pytest.fixture(scope="module")
def fpi():
    return load_workcell("fpi")


@pytest.fixture(scope="module")
def brushing(fpi):
    """A task of the inspection cell and something like its plan: two phases."""
    task = random_task(fpi, 3)
    a, b, c = np.random.default_rng(0).uniform(-0.8, 0.8, (3, 6))
    phases = [phase(a, b, 1.5, 6), phase(b, c, 2.0, 6)]
    return task, PlanResult(Status.OK, "found", phases, ["x", "y"])


def test_a_csv_says_what_the_plan_is(fpi, brushing, tmp_path):
    task, plan = brushing
    write_plan(tmp_path / "a" / "plan.csv", fpi, task, plan)
    rows = list(csv.DictReader((tmp_path / "a" / "plan.csv").open()))
    q = np.array([[float(row[name]) for name in fpi.joint_names] for row in rows])
    expected = np.concatenate([plan.phases[0].positions, plan.phases[1].positions[1:]])
    np.testing.assert_allclose(q, expected, atol=1e-6)
    times = np.array([float(row["time_from_start"]) for row in rows])
    assert (np.diff(times) > 0).all() and times[-1] == pytest.approx(3.5)
    assert [row["source"] for row in rows][:60] == ["LfD"] * 30 + ["DRL"] * 30
    speeds = np.array([float(row["joint_1_velocity"]) for row in rows])
    np.testing.assert_allclose(speeds[:60], plan.phases[0].velocities[:, 0], atol=1e-6)


def test_a_tp_program_follows_the_plan(fpi, brushing, tmp_path):
    """Even moves between its positions, in the times that it says, keep to the trajectory."""
    task, plan = brushing
    write_plan(tmp_path / "brush-3.ls", fpi, task, plan)
    program = read_tp_program((tmp_path / "brush-3.ls").read_text())
    assert program.name == "BRUSH_3"
    assert program.others == ("UFRAME_NUM=0", "UTOOL_NUM=1")
    q = np.radians(program.positions)
    q[:, 2] += q[:, 1]  # the controller's third angle is against the horizontal
    assert not program.moves[0].timed and program.moves[0].fine and program.moves[-1].fine
    assert [m.position for m in program.moves] == list(range(1, len(q) + 1))
    times = np.cumsum([0.0] + [m.speed for m in program.moves[1:]])
    points = to_joint_trajectory(fpi, task, plan)["points"]
    at = np.array([p["time_from_start"] for p in points])
    assert times[-1] == pytest.approx(at[-1], abs=1e-3)
    wanted = np.array([p["positions"] for p in points])
    found = np.stack([np.interp(at, times, q[:, column]) for column in range(6)], axis=1)
    assert np.abs(found - wanted).max() < 1e-3
    away = [np.linalg.norm(tool(fpi, a) - tool(fpi, b)) for a, b in zip(found, wanted, strict=True)]
    assert max(away) < 1e-4
    assert len(q) < times[-1] / 0.02, "points that even motion passes anyway are left out"
    rest = [i for i, move in enumerate(program.moves) if move.fine]
    assert len(rest) == 3, "at the start, where the arm rests between the phases, and at the end"
    np.testing.assert_allclose(q[rest[1]], plan.phases[0].positions[-1], atol=2e-5)


def tool(cell, q):
    """Where the tool is, as C MuJoCo sees it [m]."""
    data, layout = mujoco.MjData(cell.model), cell.source.layout
    data.qpos[list(layout.qpos)] = q
    mujoco.mj_kinematics(cell.model, data)
    return data.site_xpos[layout.tool_site].copy()


def test_reduced_way_points_keep_both_ends_and_the_tolerance():
    stamps = np.arange(2001)
    q = np.stack([np.sin(2e-3 * stamps), 0.5e-3 * stamps], axis=1)
    levers = np.zeros((len(q), 3, 2))
    levers[:, 0, 0] = levers[:, 1, 1] = 0.5
    kept = reduced(stamps, q, levers)
    assert kept[0] == 0 and kept[-1] == 2000 and len(kept) < 200
    line = np.stack([np.interp(stamps, stamps[kept], c) for c in q[kept].T], axis=1)
    assert np.linalg.norm(0.5 * (line - q), axis=1).max() <= TOLERANCE + 1e-12
    for length in range(2 * LEAST, 400):  # whatever is left at the end
        moves = np.diff(stamps[reduced(stamps[:length], q[:length], levers[:length])])
        assert moves.min() >= LEAST


def test_the_controller_counts_joints_its_own_way(fpi):
    q = np.radians([[0.0, 30.0, 50.0, 0, 0, 0]])
    names, units = fpi.joint_names, fpi.joint_units
    angles = controller_values(fpi.source.task.controller, names, units, q)
    np.testing.assert_allclose(angles, [[0, 30, 20, 0, 0, 0]])
    with pytest.raises(WorkcellError, match="'elbow'"):
        controller_values(ControllerSpec("tp", (("elbow", "joint_2"),)), names, units, q)
    with pytest.raises(WorkcellError, match="a slide"):
        spec = ControllerSpec("tp", (("joint_3", "joint_2"),))
        controller_values(spec, names, ("rad", "m", *units[2:]), q)


def test_cells_without_such_a_controller_are_refused(cell, planned, tmp_path):
    task, plan = planned
    with pytest.raises(WorkcellError, match="no controller that runs TP programs"):
        write_plan(tmp_path / "plan.ls", cell, task, plan)
    assert not list(tmp_path.iterdir())
    with pytest.raises(UnknownNameError, match=r"\.csv, \.json, \.ls"):
        write_plan(tmp_path / "plan.xlsx", cell, task, plan)


def with_controller(cell, controller):
    """The cell with another controller."""
    source = type(cell.source).__new__(type(cell.source))
    task = dataclasses.replace(cell.source.task, controller=controller)
    source.__dict__ = {**cell.source.__dict__, "task": task}
    return cell.replace(source=source)


def test_a_program_that_carries_closes_and_opens_the_gripper(cell, planned):
    task, plan = planned
    values = to_joint_trajectory(cell, task, plan)
    with pytest.raises(WorkcellError, match="'open' and 'close'"):
        to_tp_program(with_controller(cell, ControllerSpec("tp")), values, "carry")
    spec = ControllerSpec("tp", open="RO[1]=OFF", close="RO[1]=ON")
    program = read_tp_program(to_tp_program(with_controller(cell, spec), values, "carry"))
    acts = [text for text in program.others if text.startswith("RO")]
    orders = [{"open": "RO[1]=OFF", "close": "RO[1]=ON"}[g["command"]] for g in values["gripper"]]
    assert acts == orders
    q = np.radians(program.positions)
    assert len(acts) == len(plan.phases) + 1
    for trajectory in plan.phases:  # each motion begins and ends in the program
        for point in (trajectory.positions[0], trajectory.positions[-1]):
            assert np.abs(q - point).max(axis=1).min() < 1e-4


@pytest.mark.parametrize(
    "old, new, message",
    [
        ("/POS", "/PSO", "sections missing"),
        ("   3:J P[1]", "   4:J P[1]", "line 3 of /MN"),
        ("J P[2]", "L P[2]", "no joint move"),
        ("LINE_COUNT = ", "LINE_COUNT = 9", "LINE_COUNT"),
        ("P[2]{", "P[3]{", "position 2"),
        ("\tJ6= ", "\tJ7= ", "position 1"),
    ],
)
def test_damaged_programs_are_refused(fpi, brushing, old, new, message):
    text = to_tp_program(fpi, to_joint_trajectory(fpi, *brushing), "p")
    assert old in text
    with pytest.raises(InputError, match=message):
        read_tp_program(text.replace(old, new, 1))


def test_names_of_programs():
    assert program_name("my plan.2") == "MY_PLAN_2"
    for bad in ("2nd", "", "x" * 37):
        with pytest.raises(WorkcellError, match="no name for a TP program"):
            program_name(bad)


READER = """
import sys, numpy as np
from jax import export
program = export.deserialize(bytearray(open(sys.argv[1], "rb").read()))
assert "hybrid_jax" not in sys.modules
np.save(sys.argv[3], program.call(np.load(sys.argv[2])))
"""


def test_the_exported_policy_acts_as_the_agent(tmp_path):
    """In a process that does not know this package, for a batch of another size."""
    run = create_run("gen3_handling", "smoke", 0, tmp_path / "run")
    config = run.preset.joint
    net, count = joint.make_net(run.cell, config), joint.observation_length(run.cell, config)
    policy = networks.blank_policy(net, count)
    rng = np.random.default_rng(1)
    policy = jax.tree.map(
        lambda a: a + 0.1 * rng.normal(size=np.shape(a)).astype("f4") if np.ndim(a) else a,
        policy,
    )
    run.save("drl.npz", "joint agent", policy)
    export_policy(run, tmp_path / "policy.stablehlo")
    told = json.loads((tmp_path / "policy.json").read_text())
    assert sum(part["count"] for part in told["observation"]) == count
    seen = rng.normal(size=(5, count)).astype("f4")
    np.save(tmp_path / "seen.npy", seen)
    done = subprocess.run(
        [sys.executable, "-c", READER, "policy.stablehlo", "seen.npy", "acts.npy"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    expected = networks.act(net, policy, seen, None)
    np.testing.assert_allclose(np.load(tmp_path / "acts.npy"), expected, atol=1e-6)
