# SPDX-License-Identifier: MIT
"""Loading cells: what is refused and how, and what the shipped cell holds."""

import mujoco
import numpy as np
import pytest

from hybrid_jax.errors import UnknownNameError, WorkcellError
from hybrid_jax.tasks.registry import make_task
from hybrid_jax.tasks.scene_sampling import sample_scene
from hybrid_jax.workcell.load import load_workcell

ARM = """<mujoco><worldbody>{world}<body name="arm" pos="0 0 .2"><joint name="a" range="-3 3"/>
<geom name="link" type="capsule" size=".03" fromto="0 0 0 .3 0 0"/><site name="tool" pos=".3 0 0"/>
</body></worldbody></mujoco>"""


def load_text(tmp_path, text):
    (tmp_path / "cell.xml").write_text(text)
    return load_workcell(tmp_path / "cell.xml")


def test_unknown_cells_name_the_known_ones():
    with pytest.raises(UnknownNameError, match="gen3_handling"):
        load_workcell("gen4")


def test_a_geom_that_the_kernels_cannot_represent_is_named(tmp_path):
    hills = '<asset><hfield name="h" nrow="2" ncol="2" size="1 1 .1 .1"/></asset><worldbody>'
    text = ARM.format(world='<geom name="hills" type="hfield" hfield="h" pos="3 0 0"/>')
    with pytest.raises(WorkcellError, match="'?hills.*hfield"):
        load_text(tmp_path, text.replace("<worldbody>", hills))


def test_a_colliding_home_is_refused_with_both_geoms(tmp_path):
    with pytest.raises(WorkcellError, match="link.*overlap|overlap.*mm") as error:
        load_text(
            tmp_path,
            ARM.format(world='<geom name="post" type="box" size=".1 .1 .3" pos=".2 0 .2"/>'),
        )
    assert "post" in str(error.value) and "link" in str(error.value)


def test_a_cell_without_tool_or_with_bad_xml_is_refused(tmp_path):
    with pytest.raises(WorkcellError, match="site named 'tool'"):
        load_text(tmp_path, ARM.format(world="").replace('name="tool"', 'name="other"'))
    with pytest.raises(WorkcellError, match="MuJoCo cannot read it"):
        load_text(tmp_path, "<mujoco><worldbody></mujoco>")


def test_task_data_with_a_wrong_name_is_refused(tmp_path):
    (tmp_path / "cell.toml").write_text('tool_site = "tool"\nlift = "high"\n')
    with pytest.raises(WorkcellError, match="fields are"):
        load_text(tmp_path, ARM.format(world=""))


def test_two_loads_share_compiled_code(cell):
    again = load_workcell("gen3_handling")
    assert again.source == cell.source and hash(again.source) == hash(cell.source)


def test_the_shipped_cell(cell):
    assert cell.joint_names == tuple(f"joint_{i}" for i in range(1, 8))
    assert cell.joint_limits.shape == (7, 2) and cell.velocity_limits.shape == (7,)
    np.testing.assert_allclose(
        np.asarray(cell.velocity_limits)[[0, 6]], [1.3963, 1.2218], atol=1e-4
    )
    assert isinstance(cell.model, mujoco.MjModel)
    assert {o.kind for o in cell.source.task.objects} == {"hammer", "bolt", "block"}


def test_scenes_are_random_per_seed_and_reproducible(cell):
    first, again, other = (sample_scene(cell, seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 1e-3


def test_the_straight_way_to_a_tray_collides(cell):
    """The cell is what it claims to be: the enclosure stands between objects and trays."""
    import jax.numpy as jnp

    from hybrid_jax.kernels import dualquat as dq

    half_a_gripper = 0.07
    for seed in range(3):
        scene = sample_scene(cell, seed)
        for name in ("hammer", "block_1"):
            task = make_task(cell, name, scene)
            ends = np.asarray(dq.position(jnp.asarray(task.key_poses[2:4])))
            data = mujoco.MjData(cell.model)
            mujoco.mj_forward(cell.model, data)
            walls = [cell.model.geom(f"wall_{side}").id for side in ("left", "right")]
            inside = [
                np.all(
                    np.abs(ends[0] + s * (ends[1] - ends[0]) - data.geom_xpos[w])
                    <= cell.model.geom_size[w] + half_a_gripper
                )
                for s in np.linspace(0, 1, 400)
                for w in walls
            ]
            assert any(inside)


@pytest.mark.slow
def test_collision_models_cover_the_real_links(cell, shared, tmp_path):
    """The checker of the reference data accepts arm and gripper."""
    import json
    import subprocess
    import sys

    from hybrid_jax.workcell.assets import robots_folder

    checker = shared / "robots" / "check_collision_model.py"
    for robot, model in (("kinova_gen3", "kinova_gen3_2f85"), ("robotiq_2f85", "robotiq_2f85")):
        name = "robotiq_2f85_slide_map" if robot == "robotiq_2f85" else f"{robot}_map"
        mapping = json.loads((shared / "robots" / "examples" / f"{name}.json").read_text())
        mapping["frames"] = {"flange": mapping["frames"]["flange"]} | (
            {"tcp": "site:tool"} if robot == "kinova_gen3" else {}
        )
        path = tmp_path / f"{robot}.json"
        path.write_text(json.dumps(mapping))
        xml = robots_folder() / model / f"{model}.xml"
        done = subprocess.run(
            [
                sys.executable,
                str(checker),
                str(xml),
                robot,
                str(path),
                "--samples",
                "1000",
                "--strict",
            ],
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stdout[-1500:] + done.stderr[-500:]


URDF = """<robot name="two"><link name="base"/>
<link name="upper"><inertial><mass value="1"/><inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0"
iyz="0"/></inertial><collision><origin xyz="0 0 .15"/><geometry><cylinder radius=".04"
length=".3"/></geometry></collision></link>
<link name="tool"><inertial><mass value="1"/><inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0"
iyz="0"/></inertial><collision><origin xyz="0 0 .15"/><geometry><box size=".04 .05 .2"/></geometry>
</collision></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
<origin xyz="0 0 .1"/><axis xyz="0 1 0"/><limit lower="-1.5" upper="1.5" effort="1" velocity="2"/>
</joint>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="tool"/>
<origin xyz="0 0 .35"/><axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="1" velocity="2"/>
</joint></robot>"""


def test_a_urdf_arm_is_loaded_with_its_last_link_as_tool(tmp_path):
    from hybrid_jax.kernels.collision.clearance import clearance
    from hybrid_jax.kernels.kinematics import tool_pose

    (tmp_path / "two.urdf").write_text(URDF)
    cell = load_workcell(tmp_path / "two.urdf")
    assert cell.joint_names == ("shoulder", "elbow")
    q = np.array([0.3, -0.4], np.float32)
    data = mujoco.MjData(cell.model)
    data.qpos[:] = q
    mujoco.mj_kinematics(cell.model, data)
    from hybrid_jax.kernels import dualquat as dq

    wanted = data.xpos[cell.model.body("tool").id]
    np.testing.assert_allclose(dq.position(tool_pose(cell, q)), wanted, atol=1e-6)
    assert np.isfinite(float(clearance(cell, q)))
