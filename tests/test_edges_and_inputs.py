# SPDX-License-Identifier: MIT
"""Edges against dense sampling; arguments that are refused, with the index that is wrong."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hybrid_jax.errors import InputError
from hybrid_jax.ik import solve_ik
from hybrid_jax.kernels.collision.clearance import clearance
from hybrid_jax.kernels.collision.motion_validation import (
    edge_is_free,
    motion_reach,
    path_is_free,
    paths_are_free,
)
from hybrid_jax.kernels.collision.rounded_boxes import robot_rows
from hybrid_jax.kernels.kinematics import tool_pose
from hybrid_jax.workcell.load import load_workcell

THIN = """<mujoco><worldbody>
<geom name="blade" type="box" size=".2 .002 .2" pos=".5 0 0"/>
<body><joint name="a" axis="0 0 1" range="-3 3"/>
<geom type="capsule" size=".01" fromto=".1 0 0 .4 0 0"/><body pos=".4 0 0">
<joint name="b" axis="0 0 1" range="-2 2"/><geom type="sphere" size=".01" pos=".1 0 0"/>
<site name="tool" pos=".1 0 0"/></body></body></worldbody>
<keyframe><key name="home" qpos="1 0"/></keyframe></mujoco>"""


@pytest.fixture(scope="module")
def thin(tmp_path_factory):
    """A two-joint arm that sweeps through a blade 4 mm thick."""
    path = tmp_path_factory.mktemp("cell") / "thin.xml"
    path.write_text(THIN)
    return load_workcell(path)


def test_nothing_slips_through_between_samples(thin):
    ends = jnp.array([[-1.0, 0.0], [1.0, 0.0]])
    for phase in np.linspace(0, 1, 9):  # samples on both sides, none in the blade
        assert float(clearance(thin, ends[0] + phase * (ends[1] - ends[0]))) > 0 or phase == 0.5
    assert not edge_is_free(thin, *ends)[0]
    assert edge_is_free(thin, ends[1], jnp.array([2.0, 1.0]))[0]


def test_edges_agree_with_dense_sampling(cell):
    low, high = np.asarray(cell.joint_limits).T
    rng = np.random.default_rng(0)
    start = rng.uniform(low, high, (40, len(low))).astype(np.float32)
    end = (start + rng.normal(0, 0.2, start.shape)).astype(np.float32)
    free, least = jax.jit(jax.vmap(lambda a, b: edge_is_free(cell, a, b)))(start, end)
    phase = np.linspace(0, 1, 201, dtype=np.float32)[:, None, None]
    dense = (start + phase * (end - start)).reshape(-1, len(low))
    gaps = jax.jit(jax.vmap(lambda q: clearance(cell, q)))(dense)
    gaps = np.asarray(gaps).reshape(201, -1).min(0)
    assert (gaps[np.asarray(free)] > 0).all(), "what is proven free is free"
    assert not (~np.asarray(free) & (gaps > 0.004)).any(), "what is clearly free is proven"
    assert np.asarray(free).sum() > 5
    assert (np.asarray(least)[np.asarray(free)] >= gaps[np.asarray(free)] - 1e-4).all()


def test_a_path_is_proven_where_dense_sampling_finds_it_clear(cell):
    low, high = np.asarray(cell.joint_limits).T
    rng = np.random.default_rng(3)
    gaps_of = jax.jit(jax.vmap(lambda q: clearance(cell, q)))
    proven = 0
    for _ in range(30):
        path = rng.uniform(low, high) + np.cumsum(rng.normal(0, 0.1, (4, len(low))), axis=0)
        path = np.clip(path, low, high)
        share = np.linspace(0, 3, 601)
        dense = np.stack([np.interp(share, range(4), column) for column in path.T], axis=1)
        least = float(np.min(gaps_of(jnp.asarray(dense, jnp.float32))))
        free = path_is_free(cell, path, 0.002)
        proven += free
        assert not free or least > 0.002, "what is proven keeps the margin"
        assert free or least < 0.002 + 0.001 + 0.003, "what is clear is proven"
    assert 5 < proven < 30


def test_a_path_through_a_thin_blade_is_not_free(thin):
    ends = np.array([[-1.0, 0.0], [1.0, 0.0]])
    assert not path_is_free(thin, ends)
    assert path_is_free(thin, np.array([[1.0, 0.0], [2.0, 1.0], [2.2, 1.0]]))
    scenes = jax.tree.map(lambda a: np.stack([a] * 3), thin.scene)
    free = paths_are_free(thin, scenes, [ends, ends[1:], np.array([[1.0, 0.0], [2.0, 0.0]])])
    assert free.tolist() == [False, True, True]


def test_no_point_moves_further_than_the_bound(cell):
    low, high = np.asarray(cell.joint_limits).T
    rng = np.random.default_rng(1)
    q = rng.uniform(low, high, (300, len(low))).astype(np.float32)
    reach, step = np.asarray(motion_reach(cell)), 1e-3
    batch = jax.tree.map(lambda a: jnp.asarray(a)[None], cell)
    place = jax.jit(lambda q: robot_rows(batch, q)[0])
    before = place(jnp.asarray(q))
    for joint in range(len(low)):
        moved = q.copy()
        moved[:, joint] += step
        after = place(jnp.asarray(moved))
        ends = [
            np.asarray(after.centre + s * after.axis - before.centre - s * before.axis)
            for s in (-1, 1)
        ]
        assert max(np.linalg.norm(e, axis=0).max() for e in ends) <= reach[joint] * step * 1.01


def test_what_is_no_configuration_is_refused(cell):
    home = np.asarray(cell.home)
    with pytest.raises(InputError, match=r"q\[3\] is nan"):
        clearance(cell, np.where(np.arange(7) == 3, np.nan, home))
    with pytest.raises(InputError, match=r"shape \(6,\).*shape \(7,\)"):
        tool_pose(cell, home[:6])
    with pytest.raises(InputError, match="jax.vmap"):
        clearance(cell, np.stack([home, home]))


def test_what_is_no_pose_is_refused(cell):
    pose, key = np.asarray(tool_pose(cell, cell.home)), jax.random.key(0)
    with pytest.raises(InputError, match=r"norm 2\.0000"):
        solve_ik(cell, 2 * pose, key=key)
    with pytest.raises(InputError, match=r"pose\[7\] is inf"):
        solve_ik(cell, np.where(np.arange(8) == 7, np.inf, pose), key=key)
    with pytest.raises(InputError, match="orthogonal"):
        solve_ik(cell, pose + np.concatenate([np.zeros(4), pose[:4]]), key=key)
