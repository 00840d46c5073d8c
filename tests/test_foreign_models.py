# SPDX-License-Identifier: MIT
"""Models as others write them: nothing that they say is lost, nothing is guessed without a word."""

import sys

import numpy as np
import pytest
from arms import CELL, findings, joint, link, load

from hybrid_jax import check
from hybrid_jax.errors import UnknownNameError, WorkcellError
from hybrid_jax.kernels.kinematics import tool_pose
from hybrid_jax.runs.run_folder import create_run, open_run
from hybrid_jax.workcell.diagnosis import diagnose
from hybrid_jax.workcell.findings import DOUBTFUL, WRONG
from hybrid_jax.workcell.load import load_workcell

BALL = '<collision><geometry><sphere radius=".05"/></geometry></collision>'
ARM = (
    '<robot name="arm">'
    + link("base")
    + link("upper", BALL)
    + link("wrist", BALL)
    + joint("j1", "base", "upper")
    + joint("j2", "upper", "wrist", "continuous", "")
)
FINGERS = (
    link("left")
    + link("right")
    + joint("f1", "wrist", "left", "prismatic", 'lower="0" upper=".04"')
    + joint("f2", "wrist", "right", "prismatic", 'lower="0" upper=".04"', '<mimic joint="f1"/>')
)


def box_mesh():
    """A cube of 0.1 m as the text of an OBJ file."""
    cube = np.array(np.meshgrid(*[(0, 0.1)] * 3)).reshape(3, -1).T
    faces = [
        (0, 1, 2),
        (1, 3, 2),
        (4, 6, 5),
        (5, 6, 7),
        (0, 4, 1),
        (1, 4, 5),
        (2, 3, 6),
        (3, 7, 6),
        (0, 2, 4),
        (2, 6, 4),
        (1, 5, 3),
        (3, 5, 7),
    ]
    text = "".join(f"v {x} {y} {z}\n" for x, y, z in cube)
    return text + "".join(f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in faces)


def tool_body(cell):
    return cell.model.body(int(cell.model.site_bodyid[cell.source.layout.tool_site])).name


def test_what_a_urdf_states_counts(tmp_path):
    cell = load(tmp_path, ARM + "</robot>")
    np.testing.assert_allclose(cell.velocity_limits, [1.5, 1.5])
    np.testing.assert_allclose(cell.model.jnt_actfrcrange[:, 1], [12, 12])
    assert cell.model.jnt_limited.tolist() == [1, 0]
    texts = [finding.text for finding in diagnose(tmp_path / "arm.urdf")]
    assert not any("no velocity limit" in text for text in texts)
    assert any("'j1' states no acceleration limit: 5 rad/s^2" in text for text in texts)


def test_fingers_do_not_become_the_tool(tmp_path):
    cell = load(tmp_path, ARM + FINGERS + "</robot>")
    assert cell.joint_names == ("j1", "j2") and tool_body(cell) == "wrist"
    fixed = '<joint name="t" type="fixed"><parent link="wrist"/><child link="{}"/></joint>'
    flange = link("flange") + fixed.format("flange")
    assert tool_body(load(tmp_path, ARM + FINGERS + flange + "</robot>")) == "flange"
    tcp = link("my_tcp_link") + fixed.format("my_tcp_link")
    assert tool_body(load(tmp_path, ARM + FINGERS + flange + tcp + "</robot>")) == "my_tcp_link"


@pytest.mark.parametrize(
    "more, candidates",
    [
        (FINGERS.replace('<mimic joint="f1"/>', ""), ("wrist", "left", "right")),
        (link("jaw") + joint("jaw_joint", "wrist", "jaw"), ("wrist", "jaw")),
        (link("second") + joint("k1", "base", "second"), ("wrist", "second")),
    ],
    ids=["two fingers without mimic", "a jaw", "two arms"],
)
def test_where_the_tool_cannot_be_told_the_candidates_are_listed(tmp_path, more, candidates):
    with pytest.raises(WorkcellError, match="--tool NAME") as error:
        load(tmp_path, ARM + more + "</robot>")
    assert all(name in str(error.value) for name in candidates)
    assert tool_body(load(tmp_path, ARM + more + "</robot>", tool="wrist")) == "wrist"
    with pytest.raises(UnknownNameError, match="wrist"):
        load(tmp_path, ARM + more + "</robot>", tool="hand")
    # and the check goes on to what else there is to say
    levels = {finding.level for finding in diagnose(tmp_path / "arm.urdf")}
    assert levels == {WRONG, DOUBTFUL}


def test_a_link_that_is_named_goes_before_a_site_with_the_usual_name(tmp_path):
    text = CELL.format(more="").replace(
        "</body>", '<body name="tip" pos=".5 0 0"><geom size=".01" mass=".1"/></body></body>'
    )
    assert tool_body(load(tmp_path, text, "cell.xml")) == "link"
    cell = load(tmp_path, text, "cell.xml", tool="tip")
    assert tool_body(cell) == "tip"
    np.testing.assert_allclose(tool_pose(cell, np.zeros(1, np.float32))[:4], [1, 0, 0, 0])


def test_a_run_keeps_the_tool_that_was_named(tmp_path):
    (tmp_path / "arm.urdf").write_text(ARM + link("jaw") + joint("k", "wrist", "jaw") + "</robot>")
    run = create_run(str(tmp_path / "arm.urdf"), "smoke", 0, tmp_path / "run", tool="wrist")
    assert tool_body(run.cell) == "wrist"
    opened = open_run(tmp_path / "run")
    assert tool_body(opened.cell) == "wrist" and opened.tool == run.tool == "wrist"


def test_endings_in_any_case_and_files_of_other_kinds(tmp_path):
    assert load(tmp_path, ARM + "</robot>", "ARM.URDF").joint_names == ("j1", "j2")
    assert load(tmp_path, CELL.format(more=""), "CELL.XML").joint_names == ("a",)
    with pytest.raises(WorkcellError, match="none of .xml, .urdf, .xacro, .mjb"):
        load(tmp_path, ARM, "arm.txt")


def test_a_xacro_is_read_or_says_what_it_takes(tmp_path, monkeypatch):
    with monkeypatch.context() as without:
        without.setitem(sys.modules, "xacrodoc", None)
        with pytest.raises(WorkcellError, match=r"pip install 'hybrid_jax\[adopt\]'"):
            load(tmp_path, ARM + "</robot>", "arm.urdf.xacro")
    pytest.importorskip("xacrodoc")
    assert load(tmp_path, ARM + "</robot>", "arm.urdf.xacro").joint_names == ("j1", "j2")


MESH = '<collision><geometry><mesh filename="{}"/></geometry></collision>'


def test_packages_are_found_or_named(tmp_path, monkeypatch):
    package = tmp_path / "ws" / "my_robot" / "meshes"
    package.mkdir(parents=True)
    (package / "box.obj").write_text(box_mesh())
    robot = ARM.replace(BALL, MESH.format("package://my_robot/meshes/box.obj"), 1) + "</robot>"
    away, beside = tmp_path / "elsewhere", tmp_path / "ws" / "my_robot" / "urdf"
    for folder in (away, beside):
        folder.mkdir()
    assert load(beside, robot).robot.shapes.count == 2
    with pytest.raises(WorkcellError, match="no package 'my_robot'.*--package-path"):
        load(away, robot)
    assert load(away, robot, package_paths=[tmp_path / "ws"]).robot.shapes.count == 2
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "ws"))
    assert load(away, robot).robot.shapes.count == 2
    with pytest.raises(WorkcellError, match="there is no .*none.stl"):
        load(away, robot.replace("package://my_robot/meshes/box.obj", "none.stl"))


def test_visuals_that_are_missing_are_none_of_our_business(tmp_path):
    """MuJoCo discards them."""
    shape = MESH.format("package://nowhere/a.dae").replace("collision", "visual")
    robot = ARM.replace(BALL, BALL + shape, 1) + "</robot>"
    assert load(tmp_path, robot).robot.shapes.count == 2


@pytest.mark.parametrize(
    "settings, name",
    [('meshdir="parts"', "box.obj"), ('strippath="true" meshdir="parts"', "package://x/y/box.obj")],
)
def test_settings_of_mujoco_in_a_urdf_count(tmp_path, settings, name):
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "box.obj").write_text(box_mesh())
    compiler = f"<mujoco><compiler {settings}/></mujoco></robot>"
    robot = ARM.replace(BALL, MESH.format(name), 1) + compiler
    assert load(tmp_path, robot).robot.shapes.count == 2


def test_a_home_is_found_where_zero_is_outside_the_limits(tmp_path):
    text = ARM.replace('lower="-2" upper="2"', 'lower="-3" upper="-.1"') + "</robot>"
    cell = load(tmp_path, text)
    assert -3 < float(cell.home[0]) < -0.1
    texts = [f.text for f in diagnose(tmp_path / "arm.urdf") if f.level == WRONG]
    assert texts == []


@pytest.mark.parametrize(
    "old, new, level, words",
    [
        ("-1.5 1.5", "1.5 -1.5", WRONG, "'a' has the range 1.5 to -1.5"),
        ('user="2 5"', 'user="inf 5"', WRONG, "velocity limit inf"),
        ('user="2 5"', 'user="2 nan"', WRONG, "acceleration limit nan"),
        ('user="2 5"', 'user="1e-8 5"', WRONG, "velocity limit 1e-08 rad/s"),
        ('user="2 5"', 'user="171 900"', DOUBTFUL, "171 rad/s: was it meant in deg/s?"),
        ('pos=".4 0 0"', 'pos="400 0 0"', DOUBTFUL, "400 m long: lengths are in metres"),
        ('name="tool"', 'name="other"', WRONG, "no tool frame"),
        ('<geom name="arm"', '<geom contype="0" conaffinity="0"', WRONG, "no geom of the arm"),
    ],
)
def test_each_doubt_says_its_likely_cause(tmp_path, old, new, level, words):
    assert words in findings(tmp_path, CELL.format(more="").replace(old, new), level)


@pytest.mark.parametrize("name", ["link_tcp", "pinch", "attachment_site", "grasp_site"])
def test_usual_names_of_tools_are_known(tmp_path, name):
    text = CELL.format(more="").replace('name="tool"', f'name="{name}"')
    assert not findings(tmp_path, text)
    assert load_workcell(str(tmp_path / "cell.xml")).source.layout.tool_site >= 0


def test_limits_that_are_no_numbers_do_not_load(tmp_path):
    for bad in ('user="inf 5"', 'user="nan 5"'):
        with pytest.raises(WorkcellError, match="must be finite"):
            load(tmp_path, CELL.format(more="").replace('user="2 5"', bad), "cell.xml")


def test_coupled_joints_and_closed_chains_are_refused(tmp_path):
    text = CELL.format(more="").replace(
        '<site name="tool" pos=".4 0 0"/>',
        '<body name="fore" pos=".4 0 0"><joint name="b" axis="0 0 1" range="-2 2"/>'
        '<geom size=".02" pos=".2 0 0"/><site name="tool" pos=".3 0 0"/></body>',
    )
    couple = '<equality><joint joint1="b" joint2="a" polycoef="0 -1 0 0 0"/></equality></mujoco>'
    with pytest.raises(WorkcellError, match="couples the joints 'b' and 'a'"):
        load(tmp_path, text.replace("</mujoco>", couple), "cell.xml")
    tie = '<equality><connect body1="fore" body2="world" anchor="0 0 0"/></equality></mujoco>'
    with pytest.raises(WorkcellError, match="ties 'fore' to 'world'"):
        load(tmp_path, text.replace("</mujoco>", tie), "cell.xml")
    loose = couple.replace("<joint ", '<joint active="false" ')
    assert load(tmp_path, text.replace("</mujoco>", loose), "cell.xml").joint_names == ("a", "b")


def test_a_body_without_a_name_is_looked_up_by_its_number(tmp_path):
    text = CELL.format(more="").replace('<body name="link">', "<body>")
    (tmp_path / "cell.xml").write_text(text)
    assert check.main(str(tmp_path / "cell.xml"), quiet=True) == 0


def test_a_model_whose_meshes_are_missing_is_diagnosed(tmp_path):
    """MuJoCo reads its text but cannot compile it: the file is the finding, not a crash."""
    mesh = '<asset><mesh name="m" file="nowhere.stl"/></asset><worldbody>'
    text = CELL.format(more='<geom type="mesh" mesh="m"/>').replace("<worldbody>", mesh)
    assert "nowhere.stl" in findings(tmp_path, text)
