# SPDX-License-Identifier: MIT
"""The same cell on MJX: collision checks and physics agree with the kernels and with C MuJoCo."""

import jax
import jax.numpy as jnp
import numpy as np

from hybrid_jax.kernels.collision import clearance
from hybrid_jax.simulation import physics
from hybrid_jax.workcell.layout import home_qpos


def test_collision_checks_agree_with_the_kernels(cell, configurations):
    model = physics.put_cell(cell)
    q = jnp.asarray(configurations[:48])
    engine = np.asarray(jax.jit(jax.vmap(lambda x: physics.clearance(cell, model, x)))(q))
    ours = np.asarray(jax.vmap(lambda x: clearance(cell, x))(q))
    # MJX's depth is that of its contact points, not the smallest distance: signs are comparable
    clear = np.abs(ours) > 1e-4
    assert (np.sign(engine) == np.sign(ours))[clear].all()
    assert 5 < (ours < 0).sum() < 45


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
