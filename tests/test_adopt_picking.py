# SPDX-License-Identifier: MIT
"""Adopted arms that carry: a gripper is mounted, trays and objects become task data."""

from dataclasses import replace

import jax
import pytest
from arms import bare_arm

from hybrid_jax.adopt.adoption import AdoptionOptions, adopt
from hybrid_jax.execution.single_tasks import execute
from hybrid_jax.planner import infeasible_segments
from hybrid_jax.planner.bridging import rrt_bridger
from hybrid_jax.planner.infeasible_segments import harvest
from hybrid_jax.planner.pipeline import plan_motion
from hybrid_jax.planner.rrt_connect import RrtConfig
from hybrid_jax.runs.load_planner import untrained_planner
from hybrid_jax.runs.switch_problems import combined_phases
from hybrid_jax.tasks.registry import random_task
from hybrid_jax.types import Status
from hybrid_jax.workcell.assets import robots_folder
from hybrid_jax.workcell.load import load_workcell

PICK = """
table = "table"
[[fixtures]]
name = "table"
box = [0.4, 0.8, 0.03]
position = [0.52, 0.0, 0.07]
[[trays]]
name = "tray"
half_size = [0.12, 0.13]
position = [0.26, -0.53, 0.1]
[[objects]]
name = "part"
kind = "block"
box = [0.02, 0.03, 0.02]
position = [0.49, -0.1, 0.12]
mass = 0.15
tray = "tray"
slot = [0.0, 0.05, 0.0]
"""


def test_an_adopted_arm_carries_what_stands_around_it(tmp_path, capsys, monkeypatch):
    """From a bare arm and one file to a plan that C MuJoCo carries out: the part is in its tray."""
    (tmp_path / "around.toml").write_text(PICK)
    options = AdoptionOptions(gripper="robotiq_2f85", fixtures=(tmp_path / "around.toml",))
    adopted = adopt(bare_arm(tmp_path / "gen3.xml"), tmp_path / "cell", options)
    assert adopted.fit, adopted.findings
    text = " | ".join(adopted.notes)
    assert "tool points down over the objects" in text and "position servos" in text
    cell = load_workcell(adopted.path)
    assert cell.source.task.gripper.joints == ("gripper_slide_l", "gripper_slide_r")
    planner = untrained_planner(cell, 0.1)
    planner = replace(planner, bridge=rrt_bridger(cell, RrtConfig()))
    task = random_task(cell, 0)
    planned = plan_motion(planner, task, key=jax.random.key(0))
    assert planned.status == Status.OK, planned.detail
    result = execute(cell, task, planned)
    assert result.success, result
    # where nothing is in the way of the skills the agents train on what there is
    monkeypatch.setattr(infeasible_segments, "gaps_of", lambda *_: [])
    settings = planner.config.skills, planner.config.first_look, planner.scale
    found = harvest(cell, planner.library, planner.choose, *settings, tasks=range(2), seed=0)
    assert "skills alone suffice" in capsys.readouterr().err and len(found.start) >= 4
    without = replace(planner, bridge=None), [task], jax.random.key(1)
    assert len(combined_phases(*without, gaps_only=False)) > len(combined_phases(*without))


@pytest.mark.parametrize(
    "old, new, gripper, words",
    [
        ("", "", "", "--gripper"),
        ("", "", "hand", "robotiq_2f85"),
        ('table = "table"', "", "robotiq_2f85", "table = NAME"),
        ('tray = "tray"', 'tray = "box"', "robotiq_2f85", "'box'"),
        ('kind = "block"', "", "robotiq_2f85", "it needs kind"),
        ("[0.02, 0.03, 0.02]", "[0.05, 0.03, 0.02]", "robotiq_2f85", "100 mm wide"),
        ("half_size = [0.12, 0.13]", "half_size = [0.12, 0.0]", "robotiq_2f85", "half_size"),
        ("slot = [0.0, 0.05, 0.0]", "slot = [0.0, 0.05]", "robotiq_2f85", "slot"),
        ('kind = "block"', "kind = 2020-01-01", "robotiq_2f85", "kind"),
        ("mass = 0.15", "jitter = [0, 0, inf]\nmass = 0.15", "robotiq_2f85", "jitter"),
        ("mass = 0.15", "weight = 0.15", "robotiq_2f85", "weight"),
    ],
)
def test_what_a_pick_lacks_is_named(tmp_path, old, new, gripper, words):
    (tmp_path / "around.toml").write_text(PICK.replace(old, new) if old else PICK)
    options = AdoptionOptions(gripper=gripper, fixtures=(tmp_path / "around.toml",))
    adopted = adopt(bare_arm(tmp_path / "gen3.xml"), tmp_path / "cell", options)
    assert not adopted.fit and words in " ".join(f.text for f in adopted.findings)


def test_a_gripper_of_ones_own_needs_its_numbers(tmp_path):
    (tmp_path / "jaw.xml").write_text("<mujoco/>")
    options = AdoptionOptions(gripper=str(tmp_path / "jaw.xml"))
    adopted = adopt(bare_arm(tmp_path / "gen3.xml"), tmp_path / "cell", options)
    assert "jaw.toml is missing" in adopted.findings[0].text
    text = (robots_folder() / "robotiq_2f85" / "robotiq_2f85.toml").read_text()
    (tmp_path / "jaw.toml").write_text(text)
    adopted = adopt(bare_arm(tmp_path / "gen3.xml"), tmp_path / "c", options)
    assert "site of the gripper 'tool'" in adopted.findings[0].text
