# SPDX-License-Identifier: MIT
"""Adopting a robot with what stands around it."""

import numpy as np
import pytest
from arms import package
from hull_shapes import can, write_stl

from hybrid_jax.adopt.adoption import AdoptionOptions, adopt
from hybrid_jax.workcell.load import load_workcell

AROUND = """
[[fixtures]]
name = "table"
box = [0.3, 0.3, 0.02]
position = [0.9, 0, 0.1]
[[fixtures]]
name = "stand"
file = "stand.stl"
scale = 0.001
position = [-0.9, 0, 0]
[[fixtures]]
name = "rack"
file = "rack.xml"
position = [0, -1.2, 0]
euler = [0, 0, 90]
[[objects]]
name = "can"
cylinder = [0.03, 0.05]
position = [0.9, 0.1, 0.171]
mass = 0.4
"""


def test_fixtures_and_objects_stand_around_it(tmp_path):
    write_stl(tmp_path / "stand.stl", 1000 * can(12, 0.1, 0.4))
    (tmp_path / "around.toml").write_text(AROUND)
    (tmp_path / "rack.xml").write_text(
        '<mujoco><worldbody><body name="shelf" pos=".1 0 .5"><geom type="box" size=".2 .1 .01"/>'
        "</body></worldbody></mujoco>"
    )
    options = AdoptionOptions(fixtures=(tmp_path / "around.toml",))
    adopted = adopt(package(tmp_path), tmp_path / "cell", options)
    cell = load_workcell(adopted.path)
    np.testing.assert_allclose(cell.model.body("rack_shelf").pos, [0, -1.1, 0.5], atol=1e-6)
    assert cell.fixtures.used == 4 and cell.source.layout.object_names == ("can",)
    model = cell.model
    assert model.body("can").mass[0] == pytest.approx(0.4)
    assert np.ptp(model.mesh_vert[:, 2]) < 1  # the stand's millimetres are metres
    place = np.asarray(cell.scene.objects.pose)[0, :3]
    np.testing.assert_allclose(place, [0.9, 0.1, 0.171], atol=1e-6)


@pytest.mark.parametrize(
    "line, words",
    [
        ("[[fixtures]]\nbox = [1, 1, 1]", "needs a name"),
        ('[[fixtures]]\nname = "a"', "needs one of"),
        ('[[fixtures]]\nname = "a"\nbox = [1, -1, 1]', "must be positive"),
        ('[[fixtures]]\nname = "a"\nbox = [1, 1]', "3 numbers"),
        ('[[fixtures]]\nname = "a"\nbox = [1, 1, 1]\npositon = [0, 0, 0]', "positon"),
        ('[[fixtures]]\nname = "a"\nfile = "none.stl"', "none.stl"),
        ('[[fixtures]]\nname = "a"\nbox = [1, 1, 1]\neuler = ["x", 0, 0]', "euler"),
        ("[[walls]]\nname = 'a'", "walls"),
        ("name =", "no TOML"),
    ],
)
def test_a_wrong_fixture_is_named(tmp_path, line, words):
    (tmp_path / "around.toml").write_text(line)
    options = AdoptionOptions(fixtures=(tmp_path / "around.toml",))
    adopted = adopt(package(tmp_path), tmp_path / "cell", options)
    assert adopted.path is None and words in adopted.findings[0].text


def test_objects_that_the_tool_cannot_point_down_at_are_said(tmp_path):
    """An arm of three joints that turns about one axis only."""
    (tmp_path / "around.toml").write_text(
        'table = "table"\n[[fixtures]]\nname = "table"\nbox = [0.3, 0.3, 0.02]\n'
        'position = [9.0, 0, 0.1]\n[[trays]]\nname = "tray"\nhalf_size = [0.1, 0.1]\n'
        'position = [9.0, 0, 0.12]\n[[objects]]\nname = "part"\nkind = "block"\n'
        'box = [0.02, 0.02, 0.02]\nposition = [9.0, 0.2, 0.14]\ntray = "tray"\nslot = [0, 0, 0]\n'
    )
    options = AdoptionOptions(gripper="robotiq_2f85", fixtures=(tmp_path / "around.toml",))
    adopted = adopt(package(tmp_path), tmp_path / "cell", options)
    assert adopted.path is not None, adopted.findings
    assert any("no home is free whose tool points down" in note for note in adopted.notes)
