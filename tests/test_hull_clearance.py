# SPDX-License-Identifier: MIT
"""An arm of meshes: clearances, slopes, proofs and rays are those of the convex hulls."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from arms import load
from hull_shapes import MESHES, coal_points, signed_distance
from scipy.spatial import ConvexHull

from hybrid_jax.kernels import rays
from hybrid_jax.kernels.collision.clearance import clearance, clearance_up_to, clearances
from hybrid_jax.kernels.collision.motion_validation import edge_is_free
from hybrid_jax.workcell import convex_hulls
from hybrid_jax.workcell.scene import attach_object


def mesh_asset(name, vertices):
    numbers = " ".join(f"{v:.6f}" for v in vertices.ravel())
    return f'<mesh name="{name}" vertex="{numbers}"/>'


ARM = """<mujoco><compiler angle="radian"/><asset>{meshes}</asset><worldbody>
<geom type="box" size=".15 .1 .2" pos=".35 .2 .4"/><geom type="sphere" size=".15" pos=".1 -.4 .5"/>
<geom name="rock" type="mesh" mesh="m1" pos="-.3 .1 .5" euler=".2 .4 1"/>
<body name="base"><geom type="mesh" mesh="m2"/>
<body name="upper" pos="0 0 .32"><joint name="a" axis="0 0 1" range="-3 3"/>
<joint name="b" axis="0 1 0" range="-2 2"/><geom type="mesh" mesh="m2"/>
<body name="lower" pos="0 0 .33"><joint name="c" axis="0 1 0" range="-2.5 2.5"/>
<geom type="mesh" mesh="m3" pos="0 0 .02" euler="0 -1.57 0"/>
<geom type="capsule" size=".02" fromto=".05 0 .1 .05 0 .2"/>
<site name="tool" pos="0 0 .25"/></body></body></body>{more}</worldbody>
<contact><exclude body1="base" body2="upper"/></contact>{key}</mujoco>"""


def hull_cell(tmp_path, more="", key=""):
    meshes = "".join(mesh_asset(f"m{i}", m) for i, m in enumerate(MESHES))
    return load(tmp_path, ARM.format(meshes=meshes, more=more, key=key), "hulls.xml")


def configurations(cell, count, seed=0):
    low, high = np.asarray(cell.joint_limits).T
    return np.random.default_rng(seed).uniform(low, high, (count, len(low))).astype(np.float32)


def shapes_in_coal(coal, model):
    kinds = mujoco.mjtGeom
    shapes = []
    for g in range(model.ngeom):
        size, mesh = model.geom_size[g], int(model.geom_dataid[g])
        if model.geom_type[g] == kinds.mjGEOM_MESH:
            first = model.mesh_vertadr[mesh]
            vertices = model.mesh_vert[first : first + model.mesh_vertnum[mesh]].astype(float)
            shapes.append(coal.Convex.convexHull(coal_points(coal, vertices), True, "Qt"))
        elif model.geom_type[g] == kinds.mjGEOM_BOX:
            shapes.append(coal.Box(*(2 * size)))
        elif model.geom_type[g] == kinds.mjGEOM_SPHERE:
            shapes.append(coal.Sphere(size[0]))
        else:
            shapes.append(coal.Capsule(size[0], 2 * size[1]))
    return shapes


def test_clearance_of_an_arm_of_meshes_is_that_of_their_hulls(tmp_path):
    """Less by no more than both polytopes stand out, and never free where the hulls touch."""
    coal = pytest.importorskip("coal")
    from hybrid_jax.workcell.allowed_collisions import forbidden_contacts

    cell = hull_cell(tmp_path)
    model, data, shapes = cell.model, mujoco.MjData(cell.model), shapes_in_coal(coal, cell.model)
    forbidden = np.argwhere(np.triu(forbidden_contacts(model, cell.source.layout)))
    q = configurations(cell, 400)
    batch = np.asarray(jax.jit(jax.vmap(clearance, (None, 0)))(cell, q))
    wanted = []
    for row in q:
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        poses = [
            coal.Transform3s(m.reshape(3, 3), p)
            for m, p in zip(data.geom_xmat, data.geom_xpos, strict=True)
        ]
        wanted.append(
            min(
                signed_distance(coal, (shapes[a], poses[a]), (shapes[b], poses[b]))
                for a, b in forbidden
            )
        )
    wanted = np.array(wanted)
    apart = wanted > 1e-4
    assert 0.2 < apart.mean() < 0.95
    assert (batch <= wanted + 1e-5).all()
    assert (batch - wanted)[apart].min() > -2 * convex_hulls.MESH_TOLERANCE - 1e-4
    single = np.array([clearance(cell, row) for row in q[:6]])
    np.testing.assert_allclose(single, batch[:6], atol=1e-5)
    near = np.asarray(jax.jit(jax.vmap(clearance_up_to, (None, 0, None)))(cell, q, 0.03))
    np.testing.assert_allclose(near, np.minimum(batch, 0.03), atol=1e-4)


def test_slope_of_hulls_is_that_of_differences(tmp_path):
    cell = hull_cell(tmp_path)
    q = configurations(cell, 120, 1)
    gaps = jax.jit(jax.vmap(clearance, (None, 0)))
    slope = np.asarray(jax.jit(jax.vmap(jax.grad(clearance, 1), (None, 0)))(cell, q))
    step = 1e-3
    differences = np.stack(
        [
            (gaps(cell, q + step * np.eye(3, dtype=np.float32)[i]) - gaps(cell, q)) / step
            for i in range(3)
        ],
        axis=1,
    )
    free = np.asarray(gaps(cell, q)) > 0.01
    error = np.abs(slope - differences).max(axis=1)[free]
    # a few configurations stand where the nearest pair changes, where there is no slope
    assert np.isfinite(slope).all() and np.quantile(error, 0.85) < 0.02


def test_a_proven_edge_of_hulls_is_free_all_along(tmp_path):
    cell = hull_cell(tmp_path)
    q = configurations(cell, 60, 2)
    free, _ = jax.jit(jax.vmap(edge_is_free, (None, 0, 0)))(cell, q[:-1], q[1:])
    assert 5 < np.asarray(free).sum() < 55
    share = np.linspace(0, 1, 50, dtype=np.float32)[:, None]
    for k in np.flatnonzero(free):
        points = q[k] + share * (q[k + 1] - q[k])
        assert np.asarray(jax.vmap(clearance, (None, 0))(cell, points)).min() >= 0


def test_rays_meet_hulls_where_their_faces_are(tmp_path):
    cell = hull_cell(tmp_path)
    data = mujoco.MjData(cell.model)
    mujoco.mj_kinematics(cell.model, data)
    rock = cell.model.geom("rock").id
    origin = np.array([0.1, 0.3, 0.6])
    directions = data.geom_xpos[rock] - origin + np.random.default_rng(6).normal(size=(800, 3)) / 5
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    model, mesh = cell.model, int(cell.model.geom_dataid[rock])
    first = model.mesh_vertadr[mesh]
    vertices = model.mesh_vert[first : first + model.mesh_vertnum[mesh]]
    world = vertices @ data.geom_xmat[rock].reshape(3, 3).T + data.geom_xpos[rock]
    planes = ConvexHull(world).equations
    slopes, heights = directions @ planes[:, :3].T, planes[:, :3] @ origin + planes[:, 3]
    entry = np.where(slopes < 0, -heights / slopes, -np.inf).max(axis=1)
    leave = np.where(slopes > 0, -heights / slopes, np.inf).min(axis=1)
    hits = (entry <= leave) & (leave > 0)
    ours = np.asarray(
        rays.cast(cell, jnp.asarray(origin, jnp.float32), jnp.asarray(directions, jnp.float32))
    )
    assert 50 < hits.sum() < 790
    # another obstacle may stand before it, and the rounded hull begins a little earlier
    assert (ours[hits] <= entry[hits] + 1e-4).all()
    assert np.median(entry[hits] - ours[hits]) < 2e-3


HAND = """<mujoco><compiler angle="radian"/><asset>{meshes}</asset><worldbody>
<geom type="box" size=".05 .1 .05" pos=".5 .3 .2"/>
<geom type="mesh" mesh="m2" pos=".5 -.3 -.2" euler=".2 .4 1"/>
<body name="arm"><joint name="a" axis="0 0 1" range="-1 1"/><joint name="b" axis="0 1 0"
range="-1 1"/><geom type="sphere" size=".01"/><site name="tool" pos=".3 0 0"/></body>
<body name="part" pos="0 0 2"><freejoint/><geom type="mesh" mesh="m0"/></body>
</worldbody></mujoco>"""


def test_a_held_mesh_is_measured_at_the_tool(tmp_path):
    coal = pytest.importorskip("coal")
    meshes = "".join(mesh_asset(f"m{i}", m) for i, m in enumerate(MESHES))
    cell = load(tmp_path, HAND.format(meshes=meshes), "hand.xml")
    assert cell.scene.payload.counts[-1] == 1
    held = attach_object(cell, 0, jnp.array([0.1, 0, 0, 1.0, 0, 0, 0]))
    model, data, shapes = cell.model, mujoco.MjData(cell.model), shapes_in_coal(coal, cell.model)
    part, tool, apart = int(model.body("part").geomadr[0]), model.site("tool").id, 0
    turn = np.empty(9)
    # the compiler moves a mesh to its centre of mass: the geom's pose is that in the body
    mujoco.mju_quat2Mat(turn, model.geom_quat[part])
    for q in configurations(cell, 40, 4):
        data.qpos[:2] = q
        mujoco.mj_kinematics(model, data)
        rotation = data.site_xmat[tool].reshape(3, 3)
        centre = data.site_xpos[tool] + rotation @ (model.geom_pos[part] + [0.1, 0, 0])
        pose = coal.Transform3s(rotation @ turn.reshape(3, 3), centre)
        wanted = min(
            signed_distance(
                coal,
                (shapes[part], pose),
                (shapes[g], coal.Transform3s(data.geom_xmat[g].reshape(3, 3), data.geom_xpos[g])),
            )
            for g in (0, 1)
        )
        ours = float(clearances(held, q)[0])
        assert ours <= wanted + 1e-5
        if wanted > 0:
            assert ours > wanted - 2 * convex_hulls.MESH_TOLERANCE - 1e-4
            apart += 1
    assert 5 < apart < 40
