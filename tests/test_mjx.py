# SPDX-License-Identifier: MIT
"""The same cell on MJX: collision checks and physics agree with the kernels and with C MuJoCo."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hybrid_jax.contracts import Segments
from hybrid_jax.envs.reach import ReachConfig, ReachEnv
from hybrid_jax.errors import UnknownNameError, WorkcellError
from hybrid_jax.feasibility.building import build_feasibility_map
from hybrid_jax.feasibility.evaluation import Reason
from hybrid_jax.feasibility.grid import MapConfig
from hybrid_jax.kernels.collision.clearance import clearance
from hybrid_jax.kernels.dualquat import position as pose_position
from hybrid_jax.kernels.kinematics import tool_pose
from hybrid_jax.mjx.collision import CLEARANCE_UP_TO, CLOSEST, SEEN
from hybrid_jax.mjx.collision_model import tiles
from hybrid_jax.mjx.executed_motion import make_executor
from hybrid_jax.mjx.servos import Servos, payload_mass, servo_model
from hybrid_jax.tasks.scene_sampling import sample_scene
from hybrid_jax.workcell.load import load_workcell
from hybrid_jax.workcell.scene import attach, place_objects, with_support


@pytest.mark.parametrize("held", [False, True])
def test_collision_backends_agree(cell, configurations, held):
    """Signs, and up to `SEEN` distances; an object is held, or lies somewhere."""
    scene = place_objects(cell, jnp.asarray(sample_scene(cell, 3), jnp.float32))
    if held:
        scene = attach(scene, "hammer", jnp.array([0.0, 0.05, 0.02, 1, 0, 0, 0]))
    q = jnp.asarray(configurations[:96])
    measured = {n: jax.jit(jax.vmap(f, (None, 0)))(scene, q) for n, f in CLOSEST.items()}
    ours, engine = (np.asarray(measured[name][0]) for name in ("fused", "mjx"))
    clear = np.abs(ours) > 1e-4
    assert (np.sign(engine) == np.sign(ours))[clear].all()
    assert 10 < (ours < 0).sum() < 90
    near = (ours > 0) & (ours < SEEN)
    assert near.any()
    # beside corners of boxes, and boxes of the robot, MJX does not see how near it is
    assert np.median(np.abs(engine - ours)[near]) < 1e-5
    assert (engine >= np.minimum(ours, SEEN) - 1e-5)[near].all()


def test_what_the_payload_rests_on_does_not_count_on_mjx(cell):
    """The arm is low over the table, which the hammer that it holds goes through."""
    q = jnp.asarray(cell.home)
    pose = tool_pose(cell, q)
    through_table = jnp.array([0.0, 0.0, float(pose_position(pose)[2]), 1, 0, 0, 0])
    held = attach(cell, "hammer", through_table)
    bodies = tuple({body for body in cell.source.fixture_bodies if body} - {"base_link"})
    for name, measure in CLEARANCE_UP_TO.items():
        assert measure(held, q, 0.004) < 0, name
        assert measure(with_support(held, bodies), q, 0.004) > 0, name


def test_tiles_are_the_box_that_they_come_from():
    rng = np.random.default_rng(0)
    quat = Rotation.random(rng=rng).as_quat(scalar_first=True)
    pose = np.concatenate([rng.normal(size=3), quat])
    half, whole = np.array([0.5, 0.1, 0.31]), Rotation.from_quat(quat, scalar_first=True)

    def inside(p, h, points):
        return (np.abs(whole.inv().apply(points - p[:3])) <= h).all(axis=1)

    points = pose[:3] + whole.apply(rng.uniform(-1.2, 1.2, (2000, 3)) * half)
    parts = tiles(pose, half, 0.3)
    assert all((2 * part <= 0.3 + 1e-9).all() for _, part in parts) and len(parts) == 4 * 1 * 3
    covered = np.any([inside(p, h + 1e-12, points) for p, h in parts], axis=0)
    np.testing.assert_array_equal(covered, inside(pose, half, points))


def test_a_cell_with_hulls_is_refused_by_name(tmp_path):
    vertices = "0 0 0 .1 0 0 0 .1 0 0 0 .1"
    text = TWO_JOINTS.format(actuators=SERVOS).replace(
        "<worldbody>", f'<asset><mesh name="m" vertex="{vertices}"/></asset><worldbody>'
        '<geom name="tetra" type="mesh" mesh="m" pos="1 1 1"/>', 1
    )  # fmt: skip
    (tmp_path / "arm.xml").write_text(text)
    cell = load_workcell(tmp_path / "arm.xml")
    with pytest.raises(WorkcellError, match="'arm' has 4 convex hulls.*backend 'fused'"):
        CLOSEST["mjx"](cell, cell.home)


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
    maps = [build_feasibility_map(small_cell, replace(config, backend=name)) for name in CLOSEST]
    feasible, engine = (np.asarray(m.reason) < Reason.NEAR_SINGULAR for m in maps)
    np.testing.assert_array_equal(feasible, engine)
    assert feasible.any()
    assert (np.asarray(maps[0].reason) == Reason.CELL_COLLISION).any()
    with pytest.raises(UnknownNameError, match="fused"):
        build_feasibility_map(small_cell, replace(config, backend="bullet"))


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
    # as many steps as the samples of the way divide evenly
    steps = 3 * -(-round(config.period / cell.model.opt.timestep) // 3)
    for _ in range(60):
        data.ctrl[:] = np.asarray(env.target(state, jnp.zeros(2)))
        mujoco.mj_step(cell.model, data, steps)
        move = step(state, jnp.zeros(2))
        state, arrived = move.state, arrived or bool(move.success)
        np.testing.assert_allclose(state.q, data.qpos, atol=1e-3)
        np.testing.assert_allclose(state.body.qvel, data.qvel, atol=1e-2)
        assert not move.info["blocked"]
    assert arrived
    np.testing.assert_allclose(state.q, goal[0], atol=0.01)


def test_a_move_whose_way_hits_something_is_taken_back(tmp_path):
    """The straight step leads through the post; the arm stands where it stood, as it moved."""
    cell = two_joints(tmp_path)
    scene = jax.tree.map(lambda a: a[None], cell.scene)
    start, goal = jnp.array([[1.7, 0.3]]), jnp.array([[3.0, 0.3]])
    env = ReachEnv(cell, Segments(scene, start, goal), ReachConfig(backend="mjx", physics="mjx"))
    step, state, blocked = jax.jit(env.step), env.start(jnp.int32(0), start[0]), 0
    for _ in range(20):
        before, move = state, step(state, jnp.zeros(2))
        state = move.state
        if move.info["blocked"]:
            blocked += 1
            np.testing.assert_array_equal(state.body.qvel, before.body.qvel)
            np.testing.assert_array_equal(state.q, before.q)
        assert clearance(cell, state.q) >= env.config.margin - 1e-4
    assert blocked > 5 and not move.success


def test_the_arm_feels_what_it_holds(cell):
    """The servos of one arm sag by the weight of the hammer, as C MuJoCo says."""
    servos, q = Servos(cell, 0.4), jnp.asarray(cell.home)
    held = attach(cell, "hammer", jnp.array([0.0, 0, 0, 1, 0, 0, 0]))
    moved = jax.jit(lambda scene: servos.move(scene, servos.rest(scene, q), q, 1)[0].qpos)
    described = cell.source.once(servo_model)
    joints = list(described.joints)
    empty, loaded = (np.asarray(moved(scene))[joints] for scene in (cell, held))
    model, mass = described.model, float(payload_mass(held)[0])
    assert mass == pytest.approx(cell.model.body("hammer").subtreemass[0])
    model.body_mass[described.payload] = mass
    data = mujoco.MjData(model)
    data.qpos[:], data.ctrl[:] = servos.rest(held, q).qpos, servos._command(held, q)
    mujoco.mj_step(model, data, servos.steps)
    np.testing.assert_allclose(loaded, data.qpos[joints], atol=2e-4)
    assert np.abs(loaded - empty).max() > 2e-4


def test_a_motion_is_judged_by_what_becomes_of_it(tmp_path):
    """A motion faster than its servos ends short of its goal; one through the post touches it."""
    cell = two_joints(tmp_path)
    through = np.linspace([1.2, 0.3], [2.9, 0.3], 40)
    jump = np.repeat([[0.0, 0.0], [0.6, 0.0]], [1, 39], axis=0)
    planned, hits = make_executor(cell, "mjx", "kinematic")(cell.scene, np.stack([through, jump]))
    np.testing.assert_allclose(planned[0], through, atol=1e-6)
    gaps = np.asarray(jax.vmap(clearance, (None, 0))(cell, jnp.asarray(through, jnp.float32)))
    np.testing.assert_array_equal(hits[0], gaps < 0)
    assert hits[0].any() and not hits[1].any()
    executed, _ = make_executor(cell, "mjx", "mjx")(cell.scene, np.stack([through, jump]))
    lag = np.abs(executed[1] - jump).max(axis=1)
    assert lag[1] > 0.1 > 0.02 > lag[-1]


def test_a_joint_without_a_servo_is_named(tmp_path):
    only_one = """<actuator><position joint="a" kp="200"/></actuator>"""
    with pytest.raises(WorkcellError, match="'b' has no position actuator"):
        Servos(two_joints(tmp_path, only_one), 0.1)
