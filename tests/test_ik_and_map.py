# SPDX-License-Identifier: MIT
"""IK against forward kinematics of C MuJoCo; a coarse map against the engine's collisions."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import oracles
import pytest

from hybrid_jax.errors import RunFolderError
from hybrid_jax.feasibility import building, lookup, map_files
from hybrid_jax.feasibility.evaluation import Reason
from hybrid_jax.feasibility.grid import MapConfig, poses_at
from hybrid_jax.ik import IkConfig, solve_ik
from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels.collision.clearance import clearance
from hybrid_jax.kernels.kinematics import manipulability, tool_pose
from hybrid_jax.workcell.layout import home_qpos

CONFIG = MapConfig(
    lower=(0.1, -0.4, 0.1),
    upper=(0.7, 0.4, 0.5),
    spacing=0.2,
    tilts=(0.0, 0.6),
    yaws=(0.0, 0.75),
    samples=16,
    restarts=2,
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
    tools = jax.vmap(lambda q: tool_pose(cell, q))(result.branches)
    away = np.linalg.norm(np.asarray(dq.position(tools) - dq.position(pose)), axis=1)
    sine = np.linalg.norm(np.asarray(dq.mul(dq.conj(tools), pose))[:, 1:4], axis=1)
    errors = away + 0.3 * 2 * np.arcsin(np.clip(sine, 0, 1))
    assert float(result.position_error + 0.3 * result.rotation_error) <= errors.min() + 1e-4


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


def test_fea_is_the_best_of_all_solutions(cell, fmap):
    """Many random seeds for each feasible pose: few find a free solution with more `man'`."""
    index = np.flatnonzero(np.asarray(fmap.reason).ravel() == Reason.FEASIBLE)
    positions, quats = (a[index] for a in poses_at(CONFIG, np.arange(CONFIG.size)))
    poses = dq.from_parts(jnp.asarray(positions), jnp.asarray(quats))
    keys = jax.random.split(jax.random.key(5), len(poses))

    def best(pose, key):
        found = solve_ik(cell, pose, config=IkConfig(seeds=32), key=key)
        q = found.branches
        gaps = jax.vmap(clearance, (None, 0))(cell, q)
        man = jax.vmap(manipulability, (None, 0))(cell, q)
        return jnp.max(jnp.where(found.branch_found & (gaps > 0), man, 0.0))

    oracle = np.asarray(jax.jit(jax.vmap(best))(poses, keys)) / float(fmap.manipulability_scale)
    ours = np.asarray(fmap.feasibility).ravel()[index]
    # the first solution that is found reaches 0.93 here
    assert ours.mean() > 0.97 * np.clip(oracle, 0, 1).mean()


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
    nowhere = fmap.replace(feasibility=jnp.zeros_like(fmap.feasibility))
    assert np.isnan(lookup.nearest_feasible(nowhere, pose)).all()


def test_a_map_of_another_cell_is_refused(cell, fmap, tmp_path):
    path = tmp_path / "map.npz"
    map_files.save_map(path, cell, fmap)
    again = map_files.load_map(path, cell)
    np.testing.assert_array_equal(again.reason, fmap.reason)
    from hybrid_jax.runtime import artifacts

    artifacts.save(path, "feasibility map", "0" * 64, fmap)
    with pytest.raises(RunFolderError, match="another work cell"):
        map_files.load_map(path, cell)
    path.write_bytes(b"nonsense")
    with pytest.raises(RunFolderError, match="damaged"):
        map_files.load_map(path, cell)


def test_an_interrupted_build_goes_on(cell, fmap, tmp_path):
    """The second build finds the first block and computes the rest; the map is the same."""
    from dataclasses import replace

    config = replace(CONFIG, slab=CONFIG.size // 2)
    folder, calls = tmp_path / "partial", []

    def stop(done, total):
        calls.append(done)
        if done >= config.size // 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        building.build_feasibility_map(cell, config, progress=stop, partial=folder)
    assert len(list(folder.glob("block_*.npz"))) >= 1
    resumed = building.build_feasibility_map(cell, config, partial=folder)
    assert not folder.exists()
    straight = building.build_feasibility_map(cell, config)
    np.testing.assert_array_equal(resumed.reason, straight.reason)
    np.testing.assert_array_equal(resumed.configuration, straight.configuration)
    # blocks draw their own random numbers: what is feasible differs by chance only
    same = (np.asarray(resumed.reason) == 0) == (np.asarray(fmap.reason) == 0)
    assert same.mean() >= 0.98


def test_a_map_that_cannot_fit_is_refused_with_its_size(cell):
    from hybrid_jax.errors import MapError

    with pytest.raises(MapError, match="GiB"):
        building.build_feasibility_map(cell, MapConfig(spacing=0.001, orientations=5000))


def test_several_devices_build_the_same_map(small_cell):
    """A process with two CPU devices labels as one with one device does."""
    import subprocess
    import sys

    code = """
import sys, jax
jax.config.update("jax_platforms", "cpu")
jax.config.update("jax_num_cpu_devices", int(sys.argv[1]))
from hybrid_jax.runtime.compile_cache import enable_compile_cache
enable_compile_cache()
import numpy as np, hybrid_jax
from hybrid_jax.feasibility.grid import MapConfig
config = MapConfig(lower=(.3, -.2, .1), upper=(.6, .2, .4), spacing=.3, orientations=8, batch=128)
cell = hybrid_jax.load_workcell(sys.argv[2])
fmap = hybrid_jax.build_feasibility_map(cell, config)
print(len(jax.devices()), "".join(map(str, np.asarray(fmap.reason).ravel())))
"""
    command = [sys.executable, "-c", code]
    runs = [
        subprocess.run([*command, str(n), small_cell.source.path], capture_output=True, text=True)
        for n in (1, 2)
    ]
    assert all(r.returncode == 0 for r in runs), [r.stderr[-500:] for r in runs]
    (one, labels), (two, same) = (r.stdout.split() for r in runs)
    assert (one, two) == ("1", "2") and labels == same and len(set(labels)) > 1


def test_labels_agree_with_many_random_seeds(cell, fmap):
    """A small version of the benchmark's oracle: 32 seeds, the engine's contacts."""
    from hybrid_jax.ik import IkConfig
    from hybrid_jax.kernels.kinematics import manipulability

    index = np.random.default_rng(0).choice(CONFIG.size, 60, replace=False)
    positions, quats = poses_at(CONFIG, index)
    poses = dq.from_parts(jnp.asarray(positions), jnp.asarray(quats))
    keys = jax.random.split(jax.random.key(1), len(poses))
    config = IkConfig(seeds=32, iterations=60)
    solve = jax.jit(jax.vmap(lambda p, k: solve_ik(cell, p, config=config, key=k)))
    found = solve(poses, keys)
    least = 0.1 * float(fmap.manipulability_scale)
    man = jax.jit(jax.vmap(jax.vmap(lambda q: manipulability(cell, q))))(found.branches)
    usable = np.asarray(found.branch_found & (man >= least))
    model, data, layout = cell.model, mujoco.MjData(cell.model), cell.source.layout
    agree = []
    for i, ends in enumerate(np.asarray(found.branches)):
        free = False
        for q in ends[usable[i]]:
            data.qpos[:] = home_qpos(model)
            data.qpos[list(layout.qpos)] = q
            mujoco.mj_forward(model, data)
            touching = [
                c
                for c in data.contact[: data.ncon]
                if c.dist < -1e-4
                and any(
                    model.geom_bodyid[g] >= model.jnt_bodyid[layout.joints[0]]
                    and model.body_rootid[model.geom_bodyid[g]]
                    == model.body_rootid[model.jnt_bodyid[layout.joints[0]]]
                    for g in c.geom
                )
            ]
            free |= not touching
        agree.append(free == (np.asarray(fmap.reason).ravel()[index[i]] == Reason.FEASIBLE))
    assert np.mean(agree) >= 0.98
