# SPDX-License-Identifier: MIT
"""Small arms as URDF and MJCF text, for tests of loading and checking."""

import re
from pathlib import Path

from hull_shapes import can, write_stl

from hybrid_jax.workcell.assets import robots_folder
from hybrid_jax.workcell.diagnosis import diagnose
from hybrid_jax.workcell.findings import WRONG
from hybrid_jax.workcell.load import load_workcell

INERTIA = '<inertial><mass value="1"/><inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/>'


def link(name, inside=""):
    return f'<link name="{name}">{INERTIA}</inertial>{inside}</link>'


def joint(name, parent, child, kind="revolute", limit='lower="-2" upper="2"', extra=""):
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz=".3 0 0"/><axis xyz="0 0 1"/><limit {limit} effort="12" velocity="1.5"/>'
        f"{extra}</joint>"
    )


def load(tmp_path, text, name="arm.urdf", **options):
    (tmp_path / name).write_text(text)
    return load_workcell(tmp_path / name, **options)


CELL = """<mujoco><compiler angle="radian"/><size nuser_jnt="2"/><worldbody>
<body name="link"><joint name="a" axis="0 0 1" range="-1.5 1.5" user="2 5"/>
<geom name="arm" type="capsule" fromto="0 0 0 .4 0 0" size=".03"/><site name="tool" pos=".4 0 0"/>
</body>{more}</worldbody></mujoco>"""


def findings(tmp_path, text, level=WRONG):
    (tmp_path / "cell.xml").write_text(text)
    return " | ".join(f.text for f in diagnose(tmp_path / "cell.xml") if f.level == level)


WALL = '<geom name="wall" type="box" size=".02 .2 .2" pos="0 .3 0"/>'


def bare_arm(path: Path) -> Path:
    """Write the shipped Kinova without its gripper and its servos, to be made a cell of."""
    text = (robots_folder() / "kinova_gen3_2f85" / "kinova_gen3_2f85.xml").read_text()
    lines = [line for line in text.splitlines() if "gripper_base" not in line or "attach" in line]
    text = re.sub("<actuator>.*</actuator>", "", "\n".join(lines), flags=re.DOTALL)
    text = re.sub("<attach .*?/>", '<site name="attachment_site"/>', text)
    path.write_text(re.sub("<asset>.*</asset>", "", text, flags=re.DOTALL))
    return path


def small_cell(path: Path) -> Path:
    """Write a cell of that arm, a floor and a wall: seven joints, and quickly compiled."""
    around = (
        '<geom name="floor" type="box" size="1 1 .05" pos="0 0 -.06"/>'
        '<geom name="wall" type="box" size=".05 .3 .3" pos=".55 .1 .3"/></worldbody>'
    )
    path.write_text(bare_arm(path).read_text().replace("</worldbody>", around))
    return path


MESH = '<collision><geometry><mesh filename="{name}"/></geometry></collision>'


def package(folder, name="arm_description"):
    """A ROS package with an arm of three meshes; the file of its URDF."""
    root = folder / "some_folder"
    for mesh in ("base", "upper"):
        write_stl(root / "meshes" / f"{mesh}.stl", can(24, 0.06, 0.25))
    (root / "package.xml").write_text(f"<package><name>{name}</name></package>")
    part = lambda mesh: MESH.format(name=f"package://{name}/meshes/{mesh}.stl")  # noqa: E731
    text = (
        '<robot name="arm">'
        + link("base", part("base"))
        + link("upper", part("upper"))
        + link("lower", part("upper"))
        + link("flange")
        + link("tool0")
        + joint("j1", "base", "upper", limit='lower="-2" upper="2"').replace(".3 0 0", "0 0 .252")
        + joint("j2", "upper", "lower", limit='lower="0.4" upper="2"')
        .replace(".3 0 0", "0 0 .3")
        .replace('axis xyz="0 0 1"', 'axis xyz="0 1 0"')
        + joint("j3", "lower", "flange", "continuous", "").replace(".3 0 0", "0 0 .3")
        + joint("f", "flange", "tool0", "fixed", "").replace(".3 0 0", "0 0 .05")
        + "</robot>"
    )
    path = root / "urdf" / "arm.urdf"
    path.parent.mkdir()
    path.write_text(text)
    return path
