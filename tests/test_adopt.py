# SPDX-License-Identifier: MIT
"""Adopting robots: what a vendor's file lacks is found, stated, and written beside it."""

import json

import jax
import mujoco
import numpy as np
import pytest
from arms import joint, link, package
from hull_shapes import can, write_stl

from hybrid_jax import check
from hybrid_jax.adopt import __main__ as command
from hybrid_jax.adopt.adoption import AdoptionOptions, adopt
from hybrid_jax.errors import WorkcellError
from hybrid_jax.planner.point_to_point import plan_joint_motion
from hybrid_jax.types import Status
from hybrid_jax.workcell import load
from hybrid_jax.workcell.diagnosis import diagnose
from hybrid_jax.workcell.findings import WRONG
from hybrid_jax.workcell.load import load_workcell


def test_a_urdf_of_a_package_becomes_a_cell(tmp_path):
    adopted = adopt(package(tmp_path), tmp_path / "cell")
    assert adopted.fit and adopted.path == tmp_path / "cell" / "cell.xml"
    text = " | ".join(adopted.notes)
    assert "the tool is the link 'tool0'" in text
    # its base and first link stand on each other, and zero is outside the second joint's limits
    assert "'base' and 'upper' may touch" in text and "home is j1" in text
    assert "'j1' states no acceleration limit" in text and "'j1' states no velocity" not in text
    cell = load_workcell(adopted.path)
    assert cell.joint_names == ("j1", "j2", "j3")
    np.testing.assert_allclose(cell.velocity_limits, 1.5)
    low, high = np.asarray(cell.joint_limits).T
    assert ((low <= cell.home) & (cell.home <= high)).all()
    assert {p.name for p in (tmp_path / "cell" / "meshes").iterdir()} == {"base.stl", "upper.stl"}


def test_an_adopted_arm_plans(tmp_path):
    """Over a table to the other side; C MuJoCo, which shares no code with us, sees no contact."""
    (tmp_path / "around.toml").write_text(
        '[[fixtures]]\nname = "post"\nbox = [0.05, 0.05, 0.6]\nposition = [0.45, 0, 0.6]'
    )
    options = AdoptionOptions(fixtures=(tmp_path / "around.toml",))
    cell = load_workcell(adopt(package(tmp_path), tmp_path / "cell", options).path)
    start, goal = np.array([-0.9, 1.2, 0.0]), np.array([0.9, 1.2, 0.3])
    planned = plan_joint_motion(cell, start, goal, key=jax.random.key(0))
    assert planned.status == Status.OK, planned.detail
    model, data = cell.model, mujoco.MjData(cell.model)
    for trajectory in planned.phases:
        for q in trajectory.positions:
            data.qpos[:3] = q
            mujoco.mj_forward(model, data)
            assert not (data.contact.dist[: data.ncon] < 0).any()


def test_the_cell_needs_nothing_of_where_it_came_from(tmp_path):
    import shutil

    source = package(tmp_path)
    adopt(source, tmp_path / "cell")
    shutil.rmtree(source.parent.parent)
    shutil.move(tmp_path / "cell", tmp_path / "moved")
    assert load_workcell(tmp_path / "moved" / "cell.xml").robot.shapes.counts[-1] > 0


def test_a_xacro_is_expanded_with_its_arguments(tmp_path):
    pytest.importorskip("xacrodoc")
    urdf = package(tmp_path)
    text = urdf.read_text().replace(
        '<robot name="arm">',
        '<robot name="arm" xmlns:xacro="http://ros.org/wiki/xacro">',
    )
    path = urdf.with_suffix(".urdf.xacro")
    path.write_text(text.replace('velocity="1.5"', 'velocity="$(arg speed)"'))
    adopted = adopt(path, tmp_path / "cell", AdoptionOptions(xacro_arguments={"speed": "0.7"}))
    np.testing.assert_allclose(load_workcell(adopted.path).velocity_limits[:2], 0.7)
    missing = adopt(path, tmp_path / "other")
    assert missing.path is None and "--xacro-arg" in missing.findings[0].text
    cell = load_workcell(path, tool="tool0", xacro_arguments={"speed": "0.6"})
    np.testing.assert_allclose(cell.velocity_limits[:2], 0.6)
    stated = '><xacro:arg name="speed"/><xacro:arg name="side" default="left"/><link'
    path.write_text(path.read_text().replace("><link", stated, 1))
    named = adopt(path, tmp_path / "named").findings
    assert [f.text.rpartition("; ")[2] for f in named] == ["give --xacro-arg speed=VALUE"]
    path.write_text(text.replace("<link", '<xacro:include filename="$(find nowhere)/a"/><link', 1))
    lost = adopt(path, tmp_path / "third").findings[0].text
    assert "'nowhere'" in lost and "--package-path" in lost


def test_every_missing_mesh_is_named_at_once(tmp_path):
    path = package(tmp_path)
    for file in (path.parent.parent / "meshes").iterdir():
        file.unlink()
    text = " ".join(f.text for f in adopt(path, tmp_path / "cell").findings)
    assert "base.stl" in text and "upper.stl" in text and not (tmp_path / "cell").exists()


def test_what_else_is_wrong_is_said_with_the_meshes(tmp_path):
    path = package(tmp_path)
    for file in (path.parent.parent / "meshes").iterdir():
        file.write_bytes(bytes(84))  # a binary STL without a triangle
    path.write_text(
        path.read_text()
        .replace("tool0", "left_end")
        .replace(
            "</robot>",
            link("right_end") + joint("g", "flange", "right_end", "fixed", "") + "</robot>",
        )
    )
    text = " | ".join(f.text for f in adopt(path, tmp_path / "cell").findings)
    assert text.count("has no faces") == 2 and "left_end, right_end" in text
    mjcf = tmp_path / "arm.xml"
    mjcf.write_text(
        '<mujoco><asset><mesh file="a.stl"/><mesh file="b.stl"/></asset><worldbody><body name="l">'
        '<joint axis="0 0 1" range="-1 1"/><geom type="mesh" mesh="a"/>'
        '<geom type="mesh" mesh="b"/><site name="tool"/></body></worldbody></mujoco>'
    )
    (found,) = adopt(mjcf, tmp_path / "cell").findings
    assert str(tmp_path / "a.stl") in found.text and str(tmp_path / "b.stl") in found.text


def test_another_fault_is_not_taken_for_a_missing_file(monkeypatch):
    """As where an attached model's files lie in a folder of its own."""
    monkeypatch.setattr(load, "_missing_files", lambda spec: ["elsewhere.stl"])
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[-1.0, 0, 0], name="bad")
    with pytest.raises(ValueError, match="size") as raised:
        load.compile_spec(spec)
    assert not isinstance(raised.value, WorkcellError)


def test_a_text_stl_and_a_collada_file_are_read(tmp_path):
    trimesh, _ = pytest.importorskip("trimesh"), pytest.importorskip("collada")
    path = package(tmp_path)
    meshes = path.parent.parent / "meshes"
    mesh = trimesh.load(meshes / "base.stl")
    (meshes / "base.stl").write_text(trimesh.exchange.stl.export_stl_ascii(mesh))
    mesh.export(meshes / "upper.dae")
    path.write_text(path.read_text().replace("upper.stl", "upper.dae"))
    cell = load_workcell(adopt(path, tmp_path / "cell").path)
    assert cell.robot.shapes.used == 2 and cell.fixtures.used == 1


def test_a_mjcf_keeps_its_home_and_its_other_tool(tmp_path):
    (tmp_path / "arm.xml").write_text(
        '<mujoco><compiler angle="radian"/><worldbody><body name="a"><joint name="j" axis="0 0 1" '
        'range="-2 2"/><geom type="capsule" fromto="0 0 0 .4 0 0" size=".03"/>'
        '<site name="tool" pos=".4 0 0"/><site name="laser" pos=".2 0 .1" euler="0 1 0"/></body>'
        '</worldbody><keyframe><key name="home" qpos="0.7"/></keyframe></mujoco>'
    )
    adopted = adopt(tmp_path / "arm.xml", tmp_path / "cell", AdoptionOptions(tool="laser"))
    model = mujoco.MjModel.from_xml_path(str(adopted.path))
    np.testing.assert_allclose(model.key("home").qpos, [0.7])
    np.testing.assert_allclose(model.site("tool").pos, [0.2, 0, 0.1])
    np.testing.assert_allclose(model.site("tool").quat, model.site("laser").quat)
    assert any("tool_of_the_file" in note for note in adopted.notes)


def test_an_arm_with_weak_servos_does_not_sag(tmp_path):
    """Its own servos hold it where they are told to, by C MuJoCo."""
    (tmp_path / "arm.xml").write_text(
        '<mujoco><compiler angle="radian"/><worldbody><body name="a"><joint name="j" axis="0 1 0" '
        'range="-2 2" armature=".1"/><geom type="capsule" fromto="0 0 0 .4 0 0" size=".03" '
        'mass="5"/><site name="tool" pos=".4 0 0"/></body></worldbody>'
        '<actuator><position joint="j" kp="200" kv="20"/></actuator></mujoco>'
    )
    adopted = adopt(tmp_path / "arm.xml", tmp_path / "cell")
    assert sum("compensates the arm's weight" in note for note in adopted.notes) == 1
    model = mujoco.MjModel.from_xml_path(str(adopted.path))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.ctrl[:] = home = data.qpos.copy()
    mujoco.mj_step(model, data, 500)
    np.testing.assert_allclose(data.qpos, home, atol=1e-3)


def test_joints_without_names_keep_their_home(tmp_path):
    (tmp_path / "arm.xml").write_text(
        '<mujoco><compiler angle="radian"/><worldbody><body name="a"><joint axis="0 0 1" '
        'range="-2 2"/><geom type="capsule" fromto="0 0 0 .4 0 0" size=".03"/>'
        '<site name="tool" pos=".4 0 0"/></body></worldbody>'
        '<keyframe><key name="home" qpos="0.7"/></keyframe></mujoco>'
    )
    adopted = adopt(tmp_path / "arm.xml", tmp_path / "cell")
    assert adopted.fit, adopted.findings
    model = mujoco.MjModel.from_xml_path(str(adopted.path))
    np.testing.assert_allclose(model.key("home").qpos, [0.7])
    assert model.joint(0).name == "joint_0_of_a" and model.nu == 1


def test_a_robot_that_is_never_free_is_not_called_fit(tmp_path):
    path = package(tmp_path)
    (tmp_path / "around.toml").write_text('[[fixtures]]\nname = "wall"\nbox = [2, 2, 2]')
    options = AdoptionOptions(fixtures=(tmp_path / "around.toml",))
    adopted = adopt(path, tmp_path / "cell", options)
    assert not adopted.fit and any("no home is free" in note for note in adopted.notes)
    assert any(f.level == WRONG and "wall" in f.text for f in adopted.findings)


def test_what_is_there_is_not_overwritten(tmp_path):
    path = package(tmp_path)
    adopt(path, tmp_path / "cell")
    with pytest.raises(WorkcellError, match="holds a cell"):
        adopt(path, tmp_path / "cell")


def test_check_names_the_command_that_mends_a_model(tmp_path, capsys):
    path = package(tmp_path)
    assert check.main(str(path), quiet=True) == 1
    assert f"python -m hybrid_jax.adopt {path} --out" in capsys.readouterr().out


def test_a_mesh_in_millimetres_is_doubted(tmp_path):
    path = package(tmp_path)
    write_stl(path.parent.parent / "meshes" / "upper.stl", 1000 * can(24, 0.06, 0.25))
    text = " | ".join(f.text for f in diagnose(path) if "millimetres" in f.text)
    assert "upper" in text and "0.001" in text


def test_a_link_that_is_far_from_convex_is_named(tmp_path):
    import trimesh

    path = package(tmp_path)
    pipe = trimesh.creation.annulus(r_min=0.055, r_max=0.06, height=0.25)
    pipe.export(path.parent.parent / "meshes" / "upper.stl")
    text = " | ".join(f.text for f in diagnose(path) if "far from convex" in f.text)
    assert "upper" in text and "times its volume" in text


def test_the_command_prints_and_writes_what_it_did(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    out, urdf = tmp_path / "cell", str(package(tmp_path))
    assert command.main(urdf, out, quiet=True, json=True, picture=False) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["fit"] and answer["cell"].endswith("cell.xml")
    assert "the tool is the link" in (out / "report.md").read_text()
    (tmp_path / "x.urdf").write_text("<robot")
    assert command.main("x.urdf", tmp_path / "no", quiet=True, picture=False) == 1
    assert "nothing was written" in capsys.readouterr().out
