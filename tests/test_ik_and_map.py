# SPDX-License-Identifier: MIT
"""IK against forward kinematics of C MuJoCo; a coarse map against the engine's collisions."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import oracles
import pytest

from hybrid_jax.errors import RunFolderError
from hybrid_jax.feasibility import building, lookup
from hybrid_jax.feasibility.grid import MapConfig, poses_at
from hybrid_jax.feasibility.judging import Reason
from hybrid_jax.ik import solve_ik
from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels.kinematics import tool_pose
from hybrid_jax.workcell.layout import home_qpos

CONFIG = MapConfig(
    lower=(0.1, -0.4, 0.1),
    upper=(0.7, 0.4, 0.5),
    spacing=0.2,
    tilts=(0.0, 0.6),
    yaws=(0.0, 0.75),
    batch=256,
)


@pytest.fixture(scope="module")
def fmap(cell):
    return building.build_feasibility_map(cell, CONFIG)


def test_reachable_poses_are_found(cell, configurations):
    poses = jax.vmap(lambda q: tool_pose(cell, q))(jnp.asarray(configurations))
    keys = jax.random.split(jax.random.key(0), len(poses))
    result = jax.jit(jax.vmap(lambda p, k: solve_ik(cell, p, key=k)))(poses, keys)
    assert np.asarray(result.found).mean() >= 0.99
    low, high = np.asarray(cell.joint_limits).T
    assert (np.asarray(result.q) >= low).all() and (np.asarray(result.q) <= high).all()
    for q, pose, found in zip(np.asarray(result.q), poses, result.found, strict=True):
        if found:
            data = oracles.cell_data(cell, q)
            site = data.site_xpos[cell.source.layout.tool_site]
            assert np.linalg.norm(site - np.asarray(dq.position(pose))) < 1.1e-3


def test_unreachable_poses_are_reported_with_the_closest_approach(cell):
    pose = dq.from_parts(jnp.array([2.0, 0.0, 0.5]), jnp.array([0.0, 1.0, 0.0, 0.0]))
    result = solve_ik(cell, pose, key=jax.random.key(0))
    assert not result.found
    assert 0.8 < float(result.position_error) < 1.6


def test_feasible_poses_are_free_in_the_engine_too(cell, fmap):
    model, data = cell.model, mujoco.MjData(cell.model)
    layout = cell.source.layout
    moved = np.zeros(model.nbody, bool)
    roots = {int(model.jnt_bodyid[j]) for j in layout.joints}
    for body in range(1, model.nbody):
        moved[body] = moved[model.body_parentid[body]] or body in roots
    positions, _ = poses_at(CONFIG, np.arange(CONFIG.size))
    reason = np.asarray(fmap.reason).ravel()
    q = np.asarray(fmap.configuration).reshape(CONFIG.size, -1)
    assert (reason == Reason.FEASIBLE).sum() > 20
    for index in np.flatnonzero(reason == Reason.FEASIBLE):
        data.qpos[:] = home_qpos(model)
        data.qpos[list(layout.qpos)] = q[index]
        mujoco.mj_forward(model, data)
        place = data.site_xpos[layout.tool_site]
        assert np.linalg.norm(place - positions[index]) < 1.1e-3
        for contact in data.contact[: data.ncon]:
            bodies = [int(model.geom_bodyid[g]) for g in contact.geom]
            assert not (contact.dist < -1e-4 and any(moved[b] for b in bodies))


def test_every_reason_is_explained(fmap):
    reason = np.asarray(fmap.reason)
    assert {Reason.FEASIBLE, Reason.CELL_COLLISION, Reason.UNREACHABLE} <= set(np.unique(reason))
    assert (np.asarray(fmap.feasibility)[reason != Reason.FEASIBLE] == 0).all()


def test_query_and_nearest_feasible(fmap):
    reason = np.asarray(fmap.reason)
    i, j, k, r = np.argwhere(reason == Reason.FEASIBLE)[0]
    point = np.asarray(fmap.lower) + float(fmap.spacing) * np.array([i, j, k])
    pose = dq.from_parts(jnp.asarray(point, jnp.float32), fmap.orientations[r])
    value, q = lookup.query(fmap, pose)
    assert float(value) == pytest.approx(float(fmap.feasibility[i, j, k, r]), abs=1e-5)
    np.testing.assert_allclose(q, fmap.configuration[i, j, k, r])
    np.testing.assert_allclose(dq.position(lookup.nearest_feasible(fmap, pose)), point, atol=1e-5)


def test_a_map_of_another_cell_is_refused(cell, fmap, tmp_path):
    path = tmp_path / "map.npz"
    building.save_map(path, cell, fmap)
    again = building.load_map(path, cell)
    np.testing.assert_array_equal(again.reason, fmap.reason)
    from hybrid_jax import artifacts

    artifacts.save(path, "feasibility map", "0" * 64, fmap)
    with pytest.raises(RunFolderError, match="another work cell"):
        building.load_map(path, cell)
    path.write_bytes(b"nonsense")
    with pytest.raises(RunFolderError, match="damaged"):
        building.load_map(path, cell)
