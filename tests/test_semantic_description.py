# SPDX-License-Identifier: MIT
"""Adopting by a SRDF: pairs, groups and the tool."""

from dataclasses import replace

import numpy as np
import pytest
from arms import joint, link, package

from hybrid_jax.adopt.adoption import AdoptionOptions, adopt
from hybrid_jax.adopt.semantic_description import read_srdf
from hybrid_jax.errors import UnknownNameError
from hybrid_jax.kernels.kinematics import tool_pose
from hybrid_jax.workcell.load import load_workcell


def test_a_srdf_names_pairs_and_the_tool(tmp_path):
    srdf = tmp_path / "arm.srdf"
    srdf.write_text(
        '<robot name="arm"><group name="hand"><joint name="x"/></group>'
        '<group name="whole"><group name="arm"/></group>'
        '<group name="two"><link name="tool0"/><link name="other"/></group>'
        '<group name="arm"><chain base_link="base" tip_link="flange"/></group>'
        '<disable_collisions link1="base" link2="lower" reason="Never"/>'
        '<disable_collisions link1="base" link2="nothing" reason="Never"/></robot>'
    )
    options = AdoptionOptions(group="arm", srdf=srdf)
    adopted = adopt(package(tmp_path), tmp_path / "cell", options)
    text = " | ".join(adopted.notes)
    assert "the tool is the link 'flange'" in text and "'base' and 'lower' may touch" in text
    assert "nothing" not in text
    with pytest.raises(UnknownNameError, match="arm"):
        read_srdf(srdf).group("leg")
    assert read_srdf(srdf).group("whole").chains == (("base", "flange"),)
    empty = adopt(package(tmp_path / "b"), tmp_path / "c", replace(options, group="hand"))
    assert empty.path is None and "no joint or link" in empty.findings[0].text
    lost = adopt(package(tmp_path / "d"), tmp_path / "e", replace(options, group="two"))
    assert "'other'" in lost.findings[0].text


def test_joints_that_are_not_of_the_group_are_held(tmp_path):
    """The arm alone, on a column that stays where it is; forward kinematics by C MuJoCo."""
    srdf = tmp_path / "arm.srdf"
    srdf.write_text(
        '<robot name="arm"><group name="arm"><joint name="j3"/><joint name="j2"/></group></robot>'
    )
    path = package(tmp_path)
    options = AdoptionOptions(group="arm", srdf=srdf, tool="tool0")
    adopted = adopt(path, tmp_path / "cell", options)
    cell = load_workcell(adopted.path)
    assert cell.joint_names == ("j2", "j3")
    assert any("'j1' is held at 0" in note for note in adopted.notes)
    whole = load_workcell(adopt(path, tmp_path / "whole").path)
    q = np.array([0.8, 0.3], np.float32)
    here, there = tool_pose(cell, q), tool_pose(whole, np.r_[np.float32(0), q])
    np.testing.assert_allclose(here, there, atol=1e-5)


def test_a_group_of_two_arms_is_no_arm(tmp_path):
    srdf = tmp_path / "arm.srdf"
    srdf.write_text(
        '<robot name="arm"><group name="both"><link name="tool0"/><link name="side"/></group>'
        "</robot>"
    )
    path = package(tmp_path)
    path.write_text(
        path.read_text().replace(
            "</robot>", link("side") + joint("s", "lower", "side", "fixed", "") + "</robot>"
        )
    )
    text = adopt(path, tmp_path / "cell", AdoptionOptions(group="both", srdf=srdf)).findings[0].text
    assert "tool0" in text and "side" in text and "no single arm" in text


def test_a_tool_that_is_not_told_is_asked_for(tmp_path):
    path = package(tmp_path)
    text = path.read_text().replace("tool0", "left_end")
    path.write_text(
        text.replace(
            "</robot>",
            link("right_end") + joint("g", "flange", "right_end", "fixed", "") + "</robot>",
        )
    )
    adopted = adopt(path, tmp_path / "cell")
    assert adopted.path is None
    assert "left_end, right_end" in adopted.findings[0].text
    assert "--tool" in adopted.findings[0].text
    assert adopt(path, tmp_path / "cell", AdoptionOptions(tool="right_end")).fit
