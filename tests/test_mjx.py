# SPDX-License-Identifier: MIT
"""The same cell on MJX: collision checks and physics agree with the kernels and with C MuJoCo."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from hybrid_jax.contracts import Segments
from hybrid_jax.envs.reach import ReachConfig, ReachEnv
from hybrid_jax.errors import UnknownNameError, WorkcellError
from hybrid_jax.feasibility.building import build_feasibility_map
from hybrid_jax.feasibility.evaluation import Reason
from hybrid_jax.feasibility.grid import MapConfig
from hybrid_jax.mjx import physics
from hybrid_jax.mjx.collision import BACKENDS
from hybrid_jax.mjx.servos import Servos
from hybrid_jax.tasks.scene_sampling import sample_scene
from hybrid_jax.workcell.layout import home_qpos
from hybrid_jax.workcell.load import load_workcell
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


def test_maps_of_both_backends_agree(small_cell):
    config = MapConfig(
        lower=(0.3, -0.2, 0.0),
        upper=(0.6, 0.2, 0.3),
        spacing=0.3,
        orientations=3,
        turns=2,
        samples=1,
        restarts=0,
        batch=32,
    )
    maps = [build_feasibility_map(small_cell, replace(config, backend=name)) for name in BACKENDS]
    feasible, engine = (np.asarray(m.reason) < Reason.NEAR_SINGULAR for m in maps)
    np.testing.assert_array_equal(feasible, engine)
    assert feasible.any()
    assert (np.asarray(maps[0].reason) == Reason.CELL_COLLISION).any()
    with pytest.raises(UnknownNameError, match="fused"):
        build_feasibility_map(small_cell, replace(config, backend="bullet"))


def test_a_batch_of_physics_agrees_with_the_engine(cell):
    model = physics.put_cell(cell)
    qpos = np.tile(home_qpos(cell.model), (2, 1)).astype(np.float32)
    qpos[1, cell.source.layout.qpos[0]] += 0.05
    qpos[1, cell.source.layout.object_qpos[3] + 2] += 0.01  # a block that falls 10 mm

    @jax.jit
    @jax.vmap
    def run(start):
        return physics.step(model, physics.start_state(cell, start), 10).qpos

    got = np.asarray(run(jnp.asarray(qpos)))
    for start, end in zip(qpos, got, strict=True):
        wanted = physics.settle_in_engine(cell, start, 10)
        np.testing.assert_allclose(end, wanted, atol=2e-3)
        assert np.abs(wanted - start).max() > 1e-5, "something moved"


TWO_JOINTS = """<mujoco><compiler angle="radian"/>
<option timestep=".004" integrator="implicitfast"/><worldbody>
<geom name="post" type="box" size=".05 .05 .3" pos="-.3 .35 .2"/>
<body name="upper" pos="0 0 .2"><joint name="a" range="-3 3" armature=".1"/>
<geom name="upper" type="capsule" size=".03" mass="1" fromto="0 0 0 .3 0 0"/>
<body name="lower" pos=".3 0 0"><joint name="b" range="-2 2" armature=".1"/>
<geom name="lower" type="capsule" size=".03" mass=".5" fromto=".02 0 0 .2 0 0"/>
<site name="tool" pos=".2 0 0"/></body></body></worldbody>{actuators}</mujoco>"""
SERVOS = """<actuator><position joint="a" kp="200" kv="12"/>
<position joint="b" kp="100" kv="8"/></actuator>"""


def two_joints(tmp_path, actuators=SERVOS):
    (tmp_path / "arm.xml").write_text(TWO_JOINTS.format(actuators=actuators))
    return load_workcell(tmp_path / "arm.xml")


def test_the_joint_agents_env_in_dynamics(tmp_path):
    """The servos carry out each move as C MuJoCo says, and the straight step arrives."""
    cell = two_joints(tmp_path)
    scene = jax.tree.map(lambda a: a[None], cell.scene)
    start, goal = jnp.array([[0.3, -0.4]]), jnp.array([[1.0, 0.5]])
    config = ReachConfig(physics="mjx")
    env = ReachEnv(cell, Segments(scene, start, goal), config)
    step, state = jax.jit(env.step), env.start(jnp.int32(0), start[0])
    data, arrived = mujoco.MjData(cell.model), False
    data.qpos[:] = start[0]
    for _ in range(60):
        data.ctrl[:] = np.asarray(env.target(state, jnp.zeros(2)))
        mujoco.mj_step(cell.model, data, round(config.period / cell.model.opt.timestep))
        move = step(state, jnp.zeros(2))
        state, arrived = move.state, arrived or bool(move.success)
        np.testing.assert_allclose(state.q, data.qpos, atol=1e-3)
        np.testing.assert_allclose(state.body.qvel, data.qvel, atol=1e-2)
        assert not move.info["blocked"]
    assert arrived
    np.testing.assert_allclose(state.q, goal[0], atol=0.01)


def test_a_joint_without_a_servo_is_named(tmp_path):
    only_one = """<actuator><position joint="a" kp="200"/></actuator>"""
    with pytest.raises(WorkcellError, match="'b' has no position actuator"):
        Servos(two_joints(tmp_path, only_one), 0.1)
