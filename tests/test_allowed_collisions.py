# SPDX-License-Identifier: MIT
"""Which geoms may touch: kernels and C MuJoCo obey one rule."""

import mujoco
import numpy as np
import pytest
from arms import CELL, WALL, findings, load

from hybrid_jax import check
from hybrid_jax.errors import WorkcellError
from hybrid_jax.kernels.collision.clearance import clearance
from hybrid_jax.planner.phase_scenes import home_scene
from hybrid_jax.planner.trajectory_check import ConfigurationChecker


def test_explicit_pairs_are_obeyed(tmp_path):
    """Both geoms take part in nothing else: MuJoCo's pairs go before all filters."""
    text = CELL.format(more=WALL).replace('name="arm"', 'name="arm" contype="0" conaffinity="0"')
    text = text.replace('name="wall"', 'name="wall" contype="0" conaffinity="0"')
    pair = '<contact><pair geom1="wall" geom2="arm"/></contact></mujoco>'
    cell = load(tmp_path, text.replace("</mujoco>", pair), "cell.xml")
    data, engine = mujoco.MjData(cell.model), ConfigurationChecker(cell)
    engine.enter(home_scene(cell))
    for q in np.linspace(-1.5, 1.5, 31):
        data.qpos[:] = q
        mujoco.mj_forward(cell.model, data)
        away = mujoco.mj_geomDistance(cell.model, data, *sorted((0, 1)), 5.0, None)
        ours = float(clearance(cell, np.array([q], np.float32)))
        assert (ours < 0) == (away < 0) and (engine.collision([q]) is not None) == (away < 5e-4)


def test_both_judges_see_other_joints_where_the_scene_says(tmp_path):
    door = (
        '<body name="door" pos=".3 .3 0"><joint name="door" axis="0 0 1" range="-2 2"/>'
        '<geom name="door" size=".1" pos="0 -.3 0"/></body></worldbody>'
        '<keyframe><key name="home" qpos="0 1.6"/></keyframe>'
    )
    text = CELL.format(more="").replace("</worldbody>", door)
    cell = load(tmp_path, text, "cell.xml")
    assert float(clearance(cell, cell.home)) > 0.05
    engine = ConfigurationChecker(cell)
    engine.enter(home_scene(cell))
    assert engine.collision(np.asarray(cell.home)) is None


def test_a_capsule_right_through_a_thin_box_is_no_home(tmp_path):
    post = '<geom name="post" type="box" size=".02 .2 .2" pos=".3 .1 0"/>'
    text = CELL.format(more=post)
    assert "runs right through" in findings(tmp_path, text)
    with pytest.raises(WorkcellError, match="post.*arm|arm.*post"):
        load(tmp_path, text, "cell.xml")
    assert check.main(str(tmp_path / "cell.xml"), quiet=True) == 1
    engine_data = mujoco.MjData(mujoco.MjModel.from_xml_string(text))
    mujoco.mj_forward(mujoco.MjModel.from_xml_string(text), engine_data)
    assert engine_data.ncon == 0, "the engine alone does not see it"


def test_what_hangs_on_one_link_is_the_grippers_business(tmp_path):
    fingers = "".join(
        f'<body name="f{i}" pos=".4 {y} 0"><joint name="f{i}" type="slide" axis="0 1 0" '
        'range="-.01 .01"/><geom size=".02"/></body>'
        for i, y in ((1, 0.015), (2, -0.015))
    )
    text = CELL.format(more=WALL).replace('<site name="tool"', f'{fingers}<site name="tool"')
    cell = load(tmp_path, text, "cell.xml")
    assert float(clearance(cell, cell.home)) > 0.05
    engine = ConfigurationChecker(cell)
    engine.enter(home_scene(cell))
    assert engine.collision(np.asarray(cell.home)) is None
