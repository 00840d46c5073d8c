# SPDX-License-Identifier: MIT
"""What the check command says about models in which one thing is wrong."""

import pytest

from hybrid_jax import check
from hybrid_jax.workcell.assets import find_workcell
from hybrid_jax.workcell.diagnosis import diagnose
from hybrid_jax.workcell.findings import DOUBTFUL, WRONG

GOOD = """<mujoco><compiler angle="radian"/><size nuser_jnt="2"/><worldbody>
<body name="wall"><geom type="box" pos=".5 0 .3" size=".02 .3 .3"/></body>
<body name="base"><geom type="box" pos="0 0 .02" size=".05 .05 .02"/>
<body name="upper" pos="0 0 .1">
<joint name="shoulder" axis="0 1 0" range="-2 2" user="2 5"/>
<inertial pos="0 0 .15" mass="2" diaginertia=".02 .02 .01"/>
<geom name="upper" type="capsule" fromto="0 0 .05 0 0 .25" size=".03"/>
<body name="lower" pos="0 0 .3">
<joint name="elbow" axis="0 1 0" range="-2.5 2.5" user="2 5"/>
<inertial pos="0 0 .1" mass="1" diaginertia=".01 .01 .01"/>
<geom name="lower" type="capsule" fromto="0 0 .03 0 0 .2" size=".025"/>
<body name="hand" pos="0 0 .24"><inertial pos="0 0 0" mass=".2" diaginertia="1e-4 1e-4 1e-4"/>
<geom name="hand" type="sphere" size=".02"/><site name="tool"/></body>
</body></body></body></worldbody>
<actuator><position joint="shoulder" kp="100"/><position joint="elbow" kp="100"/></actuator>
<keyframe><key name="home" qpos="0.2 0.4"/></keyframe></mujoco>"""


def found(tmp_path, *changes):
    text = GOOD
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "cell.xml"
    path.write_text(text)
    return diagnose(path)


def test_nothing_is_found_in_a_good_model(tmp_path):
    assert found(tmp_path) == []


@pytest.mark.parametrize("name", ["gen3_handling", "fpi"])
def test_nothing_is_found_in_the_shipped_cells(name):
    assert diagnose(find_workcell(name)) == []


@pytest.mark.parametrize(
    ("old", "new", "level", "words"),
    [
        ("<mujoco>", "<mojuco>", WRONG, ("MuJoCo cannot read it",)),
        ('<site name="tool"/>', "", WRONG, ("no tool frame", "add a site named 'tool'")),
        ('qpos="0.2 0.4"', 'qpos="1.5 0.1"', WRONG, ("home configuration collides", "wall", "mm")),
        ('qpos="0.2 0.4"', 'qpos="0.2 2.6"', WRONG, ("'elbow' at 2.600", "limits -2.500 to 2.500")),
        (' range="-2 2"', "", DOUBTFUL, ("'shoulder' has no range",)),
        (
            '<joint name="elbow" axis="0 1 0" range="-2.5 2.5"',
            '<joint name="elbow" type="slide"',
            WRONG,
            ("slide joint 'elbow' has no range",),
        ),
        ('<compiler angle="radian"/>', "", DOUBTFUL, ("'elbow' turns by 5.0 deg", "radian")),
        (
            ' range="-2 2" user="2 5"',
            ' range="-2 2"',
            DOUBTFUL,
            ("'shoulder' states no velocity limit", "user="),
        ),
        (
            '<inertial pos="0 0 .1" mass="1" diaginertia=".01 .01 .01"/>',
            "",
            DOUBTFUL,
            ("link 'lower' has no <inertial>", "kg"),
        ),
        ('<position joint="elbow" kp="100"/>', "", DOUBTFUL, ("'elbow' has no position actuator",)),
        (
            '<geom name="hand" type="sphere" size=".02"/>',
            '<geom name="hand" type="ellipsoid" size=".02 .02 .03"/>',
            DOUBTFUL,
            ("the ellipsoid hand", "rounded box", "mm larger"),
        ),
        (
            '<keyframe><key name="home" qpos="0.2 0.4"/></keyframe>',
            "",
            DOUBTFUL,
            ("no keyframe 'home'",),
        ),
        (
            'size=".05 .05 .02"',
            'size=".05 .05 .12"',
            WRONG,
            ("overlap in every configuration", "<exclude body1="),
        ),
        (
            '<geom name="upper" type',
            '<geom name="knob" size=".057"/><geom name="upper" type',
            WRONG,
            ("base", "knob", "never further apart than 3.0 mm", "<exclude body1='base'"),
        ),
    ],
)
def test_each_mistake_is_named(tmp_path, old, new, level, words):
    texts = [f.text for f in found(tmp_path, (old, new)) if f.level == level]
    assert any(all(word in text for word in words) for text in texts), texts


def test_mistakes_are_told_together_and_the_worst_first(tmp_path):
    some = found(tmp_path, (' range="-2 2"', ""), ('qpos="0.2 0.4"', 'qpos="1.5 0.1"'))
    assert [f.level for f in some][0] == WRONG and some[-1].level == DOUBTFUL and len(some) >= 2


def test_an_object_without_mass_is_named(tmp_path):
    body = '<body name="feather" pos="-.5 0 .5"><freejoint/><geom size=".02" mass="1e-9"/></body>'
    some = found(
        tmp_path,
        ("</worldbody>", body + "</worldbody>"),
        ('qpos="0.2 0.4"', 'qpos="0.2 0.4 -.5 0 .5 1 0 0 0"'),
    )
    assert any(f.level == WRONG and "feather" in f.text for f in some), some


def test_the_command_ends_with_what_it_found(tmp_path, capsys):
    path = tmp_path / "cell.xml"
    path.write_text(GOOD)
    assert check.main(str(path)) == 0
    assert "fit to plan in: 2 joints" in capsys.readouterr().out
    path.write_text(GOOD.replace('<site name="tool"/>', ""))
    assert check.main(str(path)) == 1
    assert "add a site named 'tool'" in capsys.readouterr().out


def test_the_engine_says_nothing_needless(capfd):
    diagnose(find_workcell("gen3_handling"))
    assert capfd.readouterr().err == ""
