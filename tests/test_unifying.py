# SPDX-License-Identifier: MIT
"""Cells of one robot that share their programs, against C MuJoCo."""

import jax
import mujoco
import numpy as np
import pytest

from hybrid_jax.kernels.collision.clearance import clearance
from hybrid_jax.workcell.compile import compile_workcell
from hybrid_jax.workcell.shape_padding import unify_shapes

ARM = """
<mujoco><compiler angle="radian"/><worldbody>
  {obstacles}
  <body pos="0 0 0.2"><joint name="a" axis="0 0 1" range="-3 3"/>
    <geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.05"/>
    <body pos="0.4 0 0"><joint name="b" axis="0 1 0" range="-2 2"/>
      <geom type="capsule" fromto="0.1 0 0 0.4 0 0" size="0.04"/><site name="tool" pos="0.4 0 0"/>
    </body></body>
</worldbody></mujoco>"""
OBSTACLES = (
    '<geom type="box" pos="0.5 0.3 0.3" size="0.05 0.1 0.2"/>',
    '<geom type="sphere" pos="0.3 -0.5 0.2" size="0.1"/>'
    '<geom type="cylinder" pos="-0.4 0.1 0.3" size="0.06 0.2"/>',
    "",
)


@pytest.fixture(scope="module")
def cells():
    models = [mujoco.MjModel.from_xml_string(ARM.format(obstacles=o)) for o in OBSTACLES]
    return unify_shapes([compile_workcell(m, f"c{i}", None) for i, m in enumerate(models)])


def test_each_cell_keeps_its_own_obstacles_and_one_trace_serves_all(cells):
    traces = []

    @jax.jit
    def gaps(cell, q):
        traces.append(cell)
        return jax.vmap(clearance, (None, 0))(cell, q)

    q = np.random.default_rng(0).uniform([-3, -2], [3, 2], (300, 2)).astype(np.float32)
    for cell in cells:
        found, data = np.asarray(gaps(cell, q)), mujoco.MjData(cell.model)
        for row, gap in zip(q, found, strict=True):
            data.qpos[:] = row
            mujoco.mj_forward(cell.model, data)
            touching = data.ncon > 0 and data.contact.dist.min() < 0
            assert touching == (gap < 0) or abs(gap) < 2e-3  # a cylinder's prism stands out 1 mm
    assert len(traces) == 1
    assert (np.asarray(gaps(cells[0], q)) < 0).any() and (np.asarray(gaps(cells[1], q)) < 0).any()


def test_other_robots_and_movable_objects_are_refused_by_name(cells, cell):
    with pytest.raises(ValueError, match="'gen3_handling' has movable objects"):
        unify_shapes([cell])
    site = '<site name="tool"'
    longer = ARM.format(obstacles="").replace(site, '<geom size=".03"/>' + site)
    other = compile_workcell(mujoco.MjModel.from_xml_string(longer), "longer", None)
    with pytest.raises(ValueError, match="'longer' has another robot"):
        unify_shapes([cells[0], other])
