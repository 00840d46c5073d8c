# SPDX-License-Identifier: MIT
"""Forward kinematics and Jacobian against C MuJoCo, finite differences and reference tables."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import oracles
import pytest

from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels.kinematics import jacobian, joint_frames, manipulability, tool_pose

pytestmark = pytest.mark.usefixtures("strict_promotion")

SLIDER = """<mujoco><worldbody><body name="a" pos=".1 0 .2" euler="10 20 30">
<joint name="lift" type="slide" axis="0 .6 .8" range="-1 1" pos=".05 0 0"/><geom size=".05"/>
<body name="b" pos="0 .3 0"><joint name="turn" axis="1 1 0" pos=".02 .01 0" range="-3 3"/>
<geom size=".05"/><body name="fixed" pos="0 0 .2" euler="0 90 0"><geom size=".04"/>
<site name="tool" pos=".1 .2 .3" euler="5 6 7"/></body></body></body></worldbody></mujoco>"""


def test_tool_pose_agrees_with_mujoco(cell, configurations):
    got = jax.vmap(lambda q: dq.to_matrix(tool_pose(cell, q)))(jnp.asarray(configurations))
    for q, matrix in zip(configurations, np.asarray(got), strict=True):
        data = oracles.cell_data(cell, q)
        site = cell.source.layout.tool_site
        np.testing.assert_allclose(matrix[:3, 3], data.site_xpos[site], atol=5e-6)
        np.testing.assert_allclose(matrix[:3, :3].ravel(), data.site_xmat[site], atol=5e-6)


def test_slides_offset_axes_and_fixed_bodies(tmp_path):
    from hybrid_jax.workcell.load import load_workcell

    (tmp_path / "slider.xml").write_text(SLIDER)
    cell = load_workcell(tmp_path / "slider.xml")
    assert cell.joint_names == ("lift", "turn")
    model, data = cell.model, mujoco.MjData(cell.model)
    for q in np.random.default_rng(0).uniform(-1, 1, (20, 2)):
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        got = dq.to_matrix(tool_pose(cell, jnp.asarray(q, jnp.float32)))
        np.testing.assert_allclose(got[:3, 3], data.site_xpos[0], atol=2e-6)
        np.testing.assert_allclose(got[:3, :3].ravel(), data.site_xmat[0], atol=2e-6)


def test_reference_tables(cell, shared):
    table = np.load(shared / "robots" / "reference_fk.npz")
    q, wanted = table["kinova_gen3/q"], table["kinova_gen3/T_tcp"]
    got = jax.vmap(lambda q: dq.to_matrix(tool_pose(cell, q)))(jnp.asarray(q, jnp.float32))
    assert np.abs(np.asarray(got)[:, :3, 3] - wanted[:, :3, 3]).max() < 1e-4
    assert np.abs(np.asarray(got)[:, :3, :3] - wanted[:, :3, :3]).max() < 1e-4


def test_jacobian_agrees_with_mujoco_and_finite_differences(cell, configurations):
    model, layout = cell.model, cell.source.layout
    for q in configurations[:20]:
        data = oracles.cell_data(cell, q)
        full = np.zeros((6, model.nv))
        mujoco.mj_jacSite(model, data, full[:3], full[3:], layout.tool_site)
        got = np.asarray(jacobian(cell, q))
        np.testing.assert_allclose(got, full[:, list(layout.dofs)], atol=1e-5)
        step = 1e-2
        for j in range(3):
            shift = np.zeros(7, np.float32)
            shift[j] = step
            ahead, behind = (dq.position(tool_pose(cell, q + s)) for s in (shift, -shift))
            np.testing.assert_allclose((ahead - behind) / (2 * step), got[:3, j], atol=2e-3)


def test_manipulability_is_the_product_of_singular_values(cell, configurations):
    for q in configurations[:10]:
        wanted = np.prod(np.linalg.svd(np.asarray(jacobian(cell, q), float), compute_uv=False))
        assert manipulability(cell, q) == pytest.approx(wanted, rel=1e-2, abs=1e-4)


def test_one_trace_for_one_shape(cell, configurations):
    traces = []

    @jax.jit
    def frames(q):
        traces.append(q.shape)
        return jax.vmap(lambda one: joint_frames(cell.chain, one))(q)

    for start in range(0, 40, 10):
        frames(jnp.asarray(configurations[start : start + 10]))
    assert traces == [(10, 7)]
