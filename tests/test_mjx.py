# SPDX-License-Identifier: MIT
"""The same cell on MJX: collision checks and physics agree with the kernels and with C MuJoCo."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hybrid_jax.errors import UnknownNameError
from hybrid_jax.feasibility.building import build_feasibility_map
from hybrid_jax.feasibility.grid import MapConfig
from hybrid_jax.feasibility.judging import Reason
from hybrid_jax.simulation import physics
from hybrid_jax.skills.task import sample_scene
from hybrid_jax.workcell.layout import home_qpos
from hybrid_jax.workcell.mjxcollision import BACKENDS
from hybrid_jax.workcell.scene import place_objects


def test_collision_backends_agree(cell, configurations):
    """Signs: MJX's depth is that of its contact points, not the smallest distance."""
    scene = sample_scene(cell, 3)
    moved = place_objects(cell, jnp.asarray(scene, jnp.float32))
    q = jnp.asarray(configurations[:48])
    found = {name: jax.jit(jax.vmap(lambda x, f=f: f(moved, x)))(q) for name, f in BACKENDS.items()}
    ours, engine = np.asarray(found["fused"][0]), np.asarray(found["mjx"][0])
    clear = np.abs(ours) > 1e-4
    assert (np.sign(engine) == np.sign(ours))[clear].all()
    assert 5 < (ours < 0).sum() < 45


def test_maps_of_both_backends_agree(cell):
    config = MapConfig(
        lower=(0.3, -0.2, 0.0), upper=(0.6, 0.2, 0.3), spacing=0.3, orientations=3, turns=2,
        samples=1, restarts=0, batch=32,
    )  # fmt: skip
    maps = [build_feasibility_map(cell, replace(config, backend=name)) for name in BACKENDS]
    feasible, engine = (np.asarray(m.reason) < Reason.NEAR_SINGULAR for m in maps)
    np.testing.assert_array_equal(feasible, engine)
    assert feasible.any()
    assert (np.asarray(maps[0].reason) == Reason.CELL_COLLISION).any()
    with pytest.raises(UnknownNameError, match="fused"):
        build_feasibility_map(cell, replace(config, backend="bullet"))


def test_a_batch_of_physics_agrees_with_the_engine(cell):
    model = physics.put_cell(cell)
    qpos = np.tile(home_qpos(cell.model), (2, 1)).astype(np.float32)
    qpos[1, cell.source.layout.qpos[0]] += 0.05
    qpos[1, cell.source.layout.object_qpos[3] + 2] += 0.01  # a block that falls 10 mm

    @jax.jit
    @jax.vmap
    def run(start):
        return physics.step(model, physics.start_state(cell, model, start), 10).qpos

    got = np.asarray(run(jnp.asarray(qpos)))
    for start, end in zip(qpos, got, strict=True):
        wanted = physics.settle_in_engine(cell, start, 10)
        np.testing.assert_allclose(end, wanted, atol=2e-3)
        assert np.abs(wanted - start).max() > 1e-5, "something moved"
