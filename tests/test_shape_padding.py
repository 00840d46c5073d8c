# SPDX-License-Identifier: MIT
"""Cells of one class share their programs and keep what is their own, against C MuJoCo."""

import jax
import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hybrid_jax.kernels.collision.clearance import clearance
from hybrid_jax.kernels.collision.motion_validation import path_clearance, path_is_free
from hybrid_jax.kernels.rays import sense
from hybrid_jax.planner.point_to_point import plan_joint_motion
from hybrid_jax.runtime.kept_programs import traced
from hybrid_jax.types import Status
from hybrid_jax.workcell import compile as compiling
from hybrid_jax.workcell.compile import compile_workcell
from hybrid_jax.workcell.shape_padding import OBSTACLE_DIGITS, class_of, padded_size

ARM = """
<mujoco><compiler angle="radian"/><worldbody>
  {obstacles}
  <body pos="0 0 0.2"><joint name="a" axis="0 0 1" range="-3 3"/>
    <geom type="capsule" fromto="0 0 0 0.4 0 0" size="{thickness}"/>
    <body pos="0.4 0 0"><joint name="b" axis="0 1 0" range="-2 2"/>
      <geom type="capsule" fromto="0.1 0 0 0.4 0 0" size="0.04"/><site name="tool" pos="0.4 0 0"/>
    </body></body>
</worldbody></mujoco>"""
BOX = '<geom type="box" pos="{} 0.3 0.3" size="0.05 0.1 0.2"/>'
BALL = '<geom type="sphere" pos="{} -0.5 0.2" size="0.1"/>'
CYLINDER = BALL.format(0.3) + '<geom type="cylinder" pos="-0.4 0.1 0.3" size="0.06 0.2"/>'
CLASS = (
    "".join(BOX.format(0.5 + i) for i in range(9)) + BALL.format(0.3),
    "".join(BOX.format(-0.5 - i) for i in range(10)) + BALL.format(-0.2),
)


def cell_of(obstacles: str, name: str = "", thickness: float = 0.05):
    text = ARM.format(obstacles=obstacles, thickness=thickness)
    return compile_workcell(mujoco.MjModel.from_xml_string(text), name or "arm", None)


@pytest.fixture(scope="module")
def cells():
    """Of one class: with other obstacles, and with another arm."""
    first, second = (cell_of(obstacles, f"c{i}") for i, obstacles in enumerate(CLASS))
    return first, second, cell_of(CLASS[0], "thin", 0.02)


@given(st.integers(0, 5000), st.integers(1, 6))
def test_sizes_are_few_and_close(count, digits):
    size = padded_size(count, digits)
    assert count <= size <= count * (1 + 2.0 ** (1 - digits))
    assert size == padded_size(size, digits)
    assert len({padded_size(n, digits) for n in range(1, 1025)}) <= 11 * 2**digits


def test_cells_of_a_class_have_equal_shapes(cells):
    structures = {jax.tree.structure(cell.for_programs()) for cell in cells}
    shapes = {tuple(leaf.shape for leaf in jax.tree.leaves(cell)) for cell in cells}
    assert len(structures) == 1 == len(shapes)
    assert cells[0].fixtures.used == 10 and cells[1].fixtures.used == 11
    assert cells[0].fixtures.count == 1 + padded_size(9, OBSTACLE_DIGITS)
    assert len(cells[0].source.fixture_bodies) == cells[0].fixtures.count


def test_a_class_has_a_name_of_its_own(cells):
    assert len({class_of(cell) for cell in cells}) == 1
    assert class_of(cell_of("", "bare")) != class_of(cells[0])


def test_each_cell_keeps_its_own_obstacles(cells):
    q = np.random.default_rng(0).uniform([-3, -2], [3, 2], (300, 2)).astype(np.float32)
    for cell in (*cells, cell_of(CYLINDER, "cylinder")):
        excess = 2e-3 if cell.source.name == "cylinder" else 1e-5  # its prism stands out 1 mm
        gaps, data = path_clearance(cell, q, 1.0), mujoco.MjData(cell.model)
        for row, gap in zip(q, gaps, strict=True):
            data.qpos[:] = row
            mujoco.mj_forward(cell.model, data)
            touching = data.ncon > 0 and data.contact.dist.min() < 0
            assert touching == (gap < 0) or abs(gap) < excess
        assert (gaps < 0).any() and (gaps > 0).any()


def test_empty_slots_change_nothing(cells, monkeypatch):
    monkeypatch.setattr(compiling, "fill_up", lambda cell: cell)
    q = np.random.default_rng(1).uniform([-3, -2], [3, 2], (100, 2)).astype(np.float32)
    pose = np.array([1, 0, 0, 0, 0, 0.1, 0.1, 0.2], np.float32)
    for cell, obstacles in zip(cells, (*CLASS, CLASS[0]), strict=True):
        thickness = 0.02 if cell.source.name == "thin" else 0.05
        bare = cell_of(obstacles, cell.source.name, thickness)
        assert bare.fixtures.count == cell.fixtures.used
        assert bare.source.digest == cell.source.digest
        np.testing.assert_array_equal(path_clearance(bare, q), path_clearance(cell, q))
        np.testing.assert_array_equal(sense(bare, pose), sense(cell, pose))


def test_a_second_cell_of_a_class_traces_nothing(cells):
    q = np.zeros(2, np.float32)
    asked = (
        lambda cell: float(clearance(cell, q)),
        lambda cell: path_is_free(cell, np.stack([q, q + 0.1])),
        lambda cell: plan_joint_motion(cell, q - 1.5, q + 1.5, key=jax.random.key(0)).status,
    )
    first = [ask(cells[0]) for ask in asked]
    before = len(traced)
    others = [[ask(cell) for ask in asked] for cell in cells[1:]]
    assert traced[before:] == []
    assert {first[-1], *(answers[-1] for answers in others)} == {Status.OK}
    assert len({first[0], *(answers[0] for answers in others)}) == 3
