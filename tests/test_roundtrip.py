# SPDX-License-Identifier: MIT
"""Each written format, read back and followed by code that shares nothing with the writers."""

from dataclasses import replace

import numpy as np
import pytest
from controllers import interpolate, read_csv, read_json, read_tp
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from random_plans import random_cell, random_plan
from roundtrips import Wanted, depart, table_departures

from hybrid_jax.errors import WorkcellError
from hybrid_jax.export import write_plan
from hybrid_jax.types import Trajectory
from hybrid_jax.workcell.description import ControllerSpec

KINDS = st.lists(st.sampled_from(["hinge", "slide"]), min_size=2, max_size=4)


@settings(
    max_examples=25,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(kinds=KINDS, phases=st.integers(1, 4), carries=st.booleans(), seed=st.integers(0, 2**32 - 1))
def test_files_say_and_do_what_was_planned(tmp_path, kinds, phases, carries, seed):
    rng = np.random.default_rng(seed)
    cell = random_cell(rng, kinds)
    task, plan = random_plan(cell, rng, phases, carries)
    for ending, found in depart(cell, task, plan, tmp_path, rng).items():
        assert found.joint < 1e-5 and found.tool < 1e-4, (ending, found)
        assert (found.gripper, found.limits, found.refused) == (0, 0, 0), (ending, found)


@pytest.fixture(scope="module")
def carried():
    """An arm on a rail that carries something: three phases."""
    rng = np.random.default_rng(3)
    cell = random_cell(rng, ["slide", "hinge", "hinge"])
    return cell, *random_plan(cell, rng, 3, True)


def test_the_gripper_is_told_at_the_point_where_the_arm_rests(carried, tmp_path):
    """Whatever the digits of the times are."""
    cell, task, plan = carried
    phases = [
        Trajectory(p.times * 0.9999137, p.positions, p.velocities, p.accelerations, p.sources)
        for p in plan.phases
    ]
    write_plan(tmp_path / "a.csv", cell, task, replace(plan, phases=phases))
    write_plan(tmp_path / "a.json", cell, task, replace(plan, phases=phases))
    counts = np.cumsum([len(p.times) for p in phases])
    for found in (read_csv(tmp_path / "a.csv"), read_json(tmp_path / "a.json")):
        changes = [i for i in range(1, counts[-1]) if found.gripper[i] != found.gripper[i - 1]]
        assert changes == [counts[0] - 1, counts[1] - 1]
        assert found.gripper[0] == "open" and found.gripper[counts[0] - 1] == "close"
        rests = np.flatnonzero(np.diff(found.times) > 0.7)
        assert rests.tolist() == [counts[0] - 1, counts[1] - 1]


def test_the_arm_does_not_move_while_the_fingers_do(carried, tmp_path):
    cell, task, plan = carried
    write_plan(tmp_path / "a.csv", cell, task, plan)
    received = read_csv(tmp_path / "a.csv")
    rests = np.flatnonzero(np.diff(received.times) > 0.7)
    at = np.concatenate([received.times[i] + np.linspace(0, 0.8, 50) for i in rests])
    for rule in ("linear", "cubic", "quintic"):
        q = interpolate(received, rule, at)[0].reshape(len(rests), 50, -1)
        assert np.abs(q - q[:, :1]).max() < 1e-6
    # and this would show: accelerations where the arm rests lead a quintic away
    received.a[rests] += 1.0
    wanted = Wanted(task, plan.phases)
    assert table_departures(cell, wanted, received, np.random.default_rng(0)).tool > 1e-3


def test_a_slide_is_an_extended_axis_in_millimetres(carried, tmp_path):
    cell, task, plan = carried
    assert cell.joint_units == ("m", "rad", "rad")
    write_plan(tmp_path / "rail.ls", cell, task, plan)
    text = (tmp_path / "rail.ls").read_text()
    first = [move.q for move in read_tp(tmp_path / "rail.ls") if move.kind == "move"][0]
    np.testing.assert_allclose(first[1], plan.phases[0].positions[0][:1], atol=1e-6)
    np.testing.assert_allclose(first[0], plan.phases[0].positions[0][1:], atol=1e-5)
    assert "E1=" in text and "J3=" not in text
    cell.source.task.controller = ControllerSpec("tp", (("j1", "j0"),), "RO[1]=ON", "RO[1]=OFF")
    with pytest.raises(WorkcellError, match="'j1' and 'j0': one of them is a slide"):
        write_plan(tmp_path / "other.ls", cell, task, plan)
