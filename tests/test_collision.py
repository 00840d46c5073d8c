# SPDX-License-Identifier: MIT
"""Clearance of the whole cell against C MuJoCo, pair by pair; payload and support."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import oracles
import pytest

from hybrid_jax.envs.reach import points_between
from hybrid_jax.kernels.collision import clearance as clearance_module
from hybrid_jax.kernels.collision.clearance import (
    clearance,
    clearance_up_to,
    clearances,
)
from hybrid_jax.kernels.collision.motion_validation import clearances_in_scenes
from hybrid_jax.workcell.allowed_collisions import contact_filter
from hybrid_jax.workcell.scene import attach, detach, with_opening, with_support


def robot_bodies(cell):
    model = cell.model
    roots = {int(model.jnt_bodyid[j]) for j in cell.source.layout.joints}
    moved = np.zeros(model.nbody, bool)
    for body in range(1, model.nbody):
        moved[body] = moved[model.body_parentid[body]] or body in roots
    return moved


def pairs_of(cell):
    """(geom, geom, both on the robot) of every pair that MuJoCo would check."""
    model, moved = cell.model, robot_bodies(cell)
    on, allowed = moved[model.geom_bodyid], contact_filter(model)
    return [
        (a, b, bool(on[a] and on[b]))
        for a in range(model.ngeom)
        for b in range(a + 1, model.ngeom)
        if (on[a] or on[b]) and allowed[a, b]
    ]


def engine_clearances(cell, data, pairs):
    """Smallest `mj_geomDistance` robot-world and robot-robot, and whether it can be trusted.

    Where the axis of a capsule runs through a box, MuJoCo reports the depth of an end of the
    capsule, or even a gap: such a configuration is only good for its sign.
    """
    best, trusted = [9.0, 9.0], [True, True]
    for a, b, own in pairs:
        gap = mujoco.mj_geomDistance(cell.model, data, a, b, 9.0, None)
        best[own] = min(best[own], gap)
        if crosses(cell.model, data, a, b):
            best[own], trusted[own] = min(best[own], -1e-3), False
    return best, trusted


def crosses(model, data, a, b):
    """Does the axis of a capsule run through a box?"""
    kinds = {int(model.geom_type[g]): g for g in (a, b)}
    box, capsule = (int(g) for g in (mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CAPSULE))
    if box not in kinds or capsule not in kinds:
        return False
    c, x = kinds[capsule], kinds[box]
    axis = data.geom_xmat[c].reshape(3, 3)[:, 2] * model.geom_size[c, 1]
    ends = np.stack([data.geom_xpos[c] - axis, data.geom_xpos[c] + axis])
    local = (ends - data.geom_xpos[x]) @ data.geom_xmat[x].reshape(3, 3)
    return oracles.sampled_segment_box(local, model.geom_size[x], 401) == 0.0


def test_clearance_agrees_with_mujoco(cell, configurations):
    pairs = pairs_of(cell)
    got = np.asarray(jax.vmap(lambda q: clearances(cell, q))(jnp.asarray(configurations)))
    exact = 0
    for q, found in zip(configurations, got, strict=True):
        data = oracles.cell_data(cell, q)
        wanted, trusted = engine_clearances(cell, data, pairs)
        for kind in (0, 1):
            if abs(wanted[kind]) > 1e-4:
                assert np.sign(found[kind]) == np.sign(wanted[kind])
            if trusted[kind]:
                assert found[kind] == pytest.approx(wanted[kind], abs=1e-4)
                exact += 1
    assert exact > 200


def test_a_held_object_counts_and_its_support_does_not(cell):
    held = with_opening(attach(cell, "block_1", jnp.array([0, 0, 0.006, 0, 1, 0, 0.0])), 0.025)
    down = low_configuration(held)
    free = float(clearance(with_opening(cell, 0.025), down))
    loaded = float(clearance(held, down))
    assert loaded < free - 0.003, "the block hangs below the fingers"
    relieved = float(clearance(with_support(held, ("table",)), down))
    assert relieved > loaded


def low_configuration(cell):
    """A configuration with the tool just above the table, in front of a tray."""
    from hybrid_jax.ik import solve_ik
    from hybrid_jax.kernels import dualquat as dq

    pose = dq.from_parts(jnp.array([0.20, 0.25, 0.035]), jnp.array([0.0, 1.0, 0.0, 0.0]))
    result = solve_ik(cell, pose, key=jax.random.key(0))
    assert result.found
    return result.q


def test_open_fingers_are_wider(cell):
    q = cell.home
    wide, narrow = (with_opening(cell, o) for o in (0.0425, 0.0))
    from hybrid_jax.kernels.collision.rounded_boxes import robot_rows

    spans = []
    for one in (wide, narrow):
        batch = jax.tree.map(lambda a: jnp.asarray(a)[None], one)
        spans.append(np.ptp(np.asarray(robot_rows(batch, q[None])[0].centre)[0]))
    assert spans[0] > spans[1]


def test_an_edge_is_as_close_as_its_closest_sample(cell, configurations):
    a, b = (jnp.asarray(q) for q in configurations[:2])
    samples = [float(clearance(cell, a + s * (b - a))) for s in (0.25, 0.5, 0.75, 1.0)]
    found = min(float(clearance(cell, q)) for q in points_between(a, b, 4))
    assert found == pytest.approx(min(samples), abs=1e-6)


def test_a_large_batch_is_as_exact_as_every_pair(cell):
    """The bounds of a batch choose what is measured; a small batch measures everything."""
    low, high = np.asarray(cell.joint_limits).T
    rng = np.random.default_rng(3)
    q = jnp.asarray(rng.uniform(low, high, (1000, len(low))), jnp.float32)
    batch = jax.jit(jax.vmap(lambda one: clearance(cell, one)))
    few = jnp.concatenate([batch(q[i : i + 50]) for i in range(0, 1000, 50)])
    np.testing.assert_allclose(batch(q), few, atol=1e-6)
    parts = jax.jit(jax.vmap(lambda one: clearances(cell, one)))(q)
    np.testing.assert_allclose(jnp.min(parts, axis=1), few, atol=1e-6)


def test_an_accelerators_passes_give_the_same(small_cell, monkeypatch):
    """Its sizes of batches, tried on this device, against every pair of every configuration."""
    cell = small_cell
    low, high = np.asarray(cell.joint_limits).T
    q = jnp.asarray(np.random.default_rng(5).uniform(low, high, (4300, len(low))), jnp.float32)
    wide = jax.tree.map(lambda a: jnp.asarray(a)[None], cell)
    whole = np.asarray(clearance_module._kernel(wide, q, against="all", measured=None).distance)
    asked = []
    monkeypatch.setattr(
        clearance_module, "by_backend", lambda cpu, other: asked.append(other) or other
    )
    exact, near = clearance_module._CLOSEST["all"], clearance_module._NEAR
    run = jax.vmap(lambda one: (exact(cell, one).distance, near(cell, one, jnp.float32(0.01))))
    found = np.asarray(jax.jit(run)(q))
    assert asked and max(asked) < len(q)
    np.testing.assert_allclose(found, [whole, np.minimum(whole, 0.01)], atol=1e-6)


@pytest.mark.parametrize("enough", [0.004, 0.02])
def test_clearance_up_to_is_the_clearance_cut_off(cell, configurations, enough):
    """In small and large batches; some of either kind occur."""
    whole = np.asarray(jax.vmap(clearance, (None, 0))(cell, configurations))
    assert (whole < enough).any() and (whole > enough).any()
    for size in (20, 200):
        found = jax.vmap(clearance_up_to, (None, 0, None))(cell, configurations[:size], enough)
        np.testing.assert_allclose(found, np.minimum(whole[:size], enough), atol=1e-6)


def test_scenes_and_configurations_batch_in_any_nest(cell, configurations):
    """Each lane has its own scene: a payload of its own, objects of its own."""
    held = [
        attach(cell, name, jnp.array([0, 0, 0.006, 0, 1, 0, 0.0]))
        for name in ("block_1", "bolt_1", "hammer")
    ]
    scenes = jax.tree.map(lambda *a: jnp.stack(a), *(c.scene for c in held))
    q = jnp.asarray(configurations[:30])
    one = lambda scene, q: clearance(cell.replace(scene=scene), q)  # noqa: E731
    got = jax.jit(jax.vmap(jax.vmap(one, (None, 0)), (0, None)))(scenes, q)
    wanted = [[clearance(c, row) for row in q] for c in held]
    np.testing.assert_allclose(got, wanted, atol=1e-6)
    across = jax.jit(jax.vmap(jax.vmap(one, (0, None)), (None, 0)))(scenes, q)
    np.testing.assert_allclose(across.T, wanted, atol=1e-6)


@pytest.mark.parametrize("count", [1, 70, 700])
def test_configurations_in_scenes_of_their_own_are_each_measured(cell, configurations, count):
    """In groups that are full, short, and more than one call takes; some of either kind occur."""
    held = [
        attach(cell, name, jnp.array([0, 0, 0.006, 0, 1, 0, 0.0]))
        for name in ("block_1", "bolt_1", "hammer")
    ]
    scenes = jax.tree.map(lambda *a: jnp.stack(a), *(c.scene for c in held))
    which = np.random.default_rng(count).integers(0, 3, count)
    q = configurations[np.arange(count) % len(configurations)]
    one = lambda scene, q: clearance(cell.replace(scene=scene), q)  # noqa: E731
    whole = np.asarray(jax.jit(jax.vmap(jax.vmap(one, (0, None)), (None, 0)))(scenes, q))
    wanted = np.minimum(whole[np.arange(count), which], 0.02)
    np.testing.assert_allclose(
        clearances_in_scenes(cell, scenes, which, q, 0.02), wanted, atol=1e-6
    )
    own = jax.tree.map(lambda a: a[which], scenes)
    near = lambda scene, q: clearance_up_to(cell.replace(scene=scene), q, 0.02)  # noqa: E731
    np.testing.assert_allclose(jax.jit(jax.vmap(near))(own, q), wanted, atol=1e-6)


def test_detach_undoes_attach(cell):
    held = attach(cell, "block_2", jnp.array([0, 0, 0.006, 0, 1, 0, 0.0]))
    pose = jnp.concatenate([jnp.array([0.49, -0.20, 0.020]), jnp.array([1.0, 0, 0, 0])])
    put = detach(held, "block_2", pose)
    q = jnp.asarray(cell.home)
    assert float(clearance(put, q)) == pytest.approx(float(clearance(cell, q)), abs=1e-6)
    np.testing.assert_array_equal(put.scene.objects.active, cell.scene.objects.active)


def test_vmap_equals_the_loop(cell, configurations):
    q = jnp.asarray(configurations[:5])
    batch = jax.vmap(lambda one: clearance(cell, one))(q)
    np.testing.assert_allclose(batch, [clearance(cell, one) for one in q], atol=1e-6)


def test_gradient_agrees_with_finite_differences(tmp_path):
    from hybrid_jax.workcell.load import load_workcell

    (tmp_path / "small.xml").write_text("""<mujoco><worldbody>
      <geom type="box" size=".1 .1 .1" pos=".6 0 0"/><geom type="sphere" size=".1" pos="0 0 .9"/>
      <body><joint name="a" axis="0 1 0" range="-3 3"/>
      <geom type="capsule" size=".03" fromto="0 0 0 .3 0 0"/>
      <body pos=".3 0 0"><joint name="b" axis="0 1 0" range="-3 3"/>
      <geom type="capsule" size=".03" fromto="0 0 0 .1 0 0"/><site name="tool" pos=".1 0 0"/>
      </body></body></worldbody></mujoco>""")
    small = load_workcell(tmp_path / "small.xml")
    grad = jax.jit(jax.grad(lambda q: clearance(small, q)))
    for q in ([0.1, 0.2], [-1.2, 0.4], [2.0, -0.5]):
        q = jnp.array(q)
        step = 1e-2
        wanted = [
            (clearance(small, q + step * e) - clearance(small, q - step * e)) / (2 * step)
            for e in jnp.eye(2)
        ]
        np.testing.assert_allclose(grad(q), wanted, atol=5e-3)
