# SPDX-License-Identifier: MIT
"""Pair distances against `mj_geomDistance`; penetration against hulls of Minkowski differences.

For a capsule whose axis runs through a box MuJoCo reports the depth of an end, or none at all:
there the oracle is geometry itself.
"""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import oracles
import pytest

from hybrid_jax.kernels import distance
from hybrid_jax.kernels import dualquat as dq


def capsule_ends(position, quat, half_length):
    axis = np.zeros(3)
    mujoco.mju_rotVecQuat(axis, np.array([0.0, 0.0, half_length]), quat)
    return np.stack([position - axis, position + axis]).astype(np.float32)


def matrix(quat):
    out = np.zeros(9)
    mujoco.mju_quat2Mat(out, quat)
    return out.reshape(3, 3)


def in_frame(ends, position, quat):
    return ((ends - position) @ matrix(quat)).astype(np.float32)


def placed_pairs(model, data, count, spread, seed=0):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        for start in (0, 7):
            data.qpos[start : start + 3] = rng.uniform(-spread, spread, 3)
            data.qpos[start + 3 : start + 7] = oracles.random_quat(rng)
        mujoco.mj_kinematics(model, data)
        yield data.qpos[:3], data.qpos[3:7], data.qpos[7:10], data.qpos[10:14]


@pytest.mark.parametrize("length_a, length_b", [(0.2, 0.1), (0.0, 0.15), (0.0, 0.0)])
def test_capsules_and_spheres(length_a, length_b):
    kinds = ["capsule" if n else "sphere" for n in (length_a, length_b)]
    sizes = [(0.05, n) if n else (0.05,) for n in (length_a, length_b)]
    model, data = oracles.geom_pair(kinds[0], sizes[0], kinds[1], sizes[1])
    pair = jax.jit(distance.capsule_capsule)
    for pa, qa, pb, qb in placed_pairs(model, data, 200, 0.3):
        got = pair(capsule_ends(pa, qa, length_a), 0.05, capsule_ends(pb, qb, length_b), 0.05)
        wanted = mujoco.mj_geomDistance(model, data, 0, 1, 5.0, None)
        assert float(got) == pytest.approx(wanted, abs=2e-5)


def test_capsule_against_box_apart_and_shallow():
    half = np.array([0.2, 0.05, 0.3])
    model, data = oracles.geom_pair("capsule", (0.04, 0.1), "box", half)
    pair = jax.jit(distance.capsule_box)
    checked = 0
    for pa, qa, pb, qb in placed_pairs(model, data, 400, 0.35):
        ends = in_frame(capsule_ends(pa, qa, 0.1), pb, qb)
        gap = oracles.sampled_segment_box(ends, half)
        got = float(pair(ends, 0.04, half.astype(np.float32)))
        if gap > 1e-4:
            wanted = mujoco.mj_geomDistance(model, data, 0, 1, 5.0, None)
            assert got == pytest.approx(wanted, abs=5e-5)
            assert got == pytest.approx(gap - 0.04, abs=5e-5)
            checked += 1
    assert checked > 200


def test_capsule_through_box_has_the_depth_of_the_minkowski_difference():
    half = np.array([0.2, 0.01, 0.3])
    rng = np.random.default_rng(4)
    pair, checked = jax.jit(distance.capsule_box), 0
    for _ in range(300):
        ends = rng.uniform(-0.25, 0.25, (2, 3)).astype(np.float32)
        if oracles.sampled_segment_box(ends, half) > 0:
            continue
        depth = oracles.penetration(ends.astype(float), oracles.box_corners(half))
        assert float(pair(ends, 0.05, half.astype(np.float32))) == pytest.approx(
            -depth - 0.05, abs=2e-5
        )
        checked += 1
    assert checked > 50


def test_boxes():
    half_a, half_b = np.array([0.1, 0.2, 0.05]), np.array([0.15, 0.08, 0.12])
    model, data = oracles.geom_pair("box", half_a, "box", half_b)

    @jax.jit
    def pair(centre, rotation):
        return distance.box_box(
            centre, rotation, half_a.astype(np.float32), half_b.astype(np.float32)
        )

    apart = 0
    for pa, qa, pb, qb in placed_pairs(model, data, 300, 0.3, seed=2):
        rot_a, rot_b = matrix(qa), matrix(qb)
        got = float(
            pair((rot_b.T @ (pa - pb)).astype(np.float32), (rot_b.T @ rot_a).astype(np.float32))
        )
        wanted = mujoco.mj_geomDistance(model, data, 0, 1, 5.0, None)
        if got > 0:
            assert got == pytest.approx(wanted, abs=1e-4)
            apart += 1
        else:
            corners_a = oracles.box_corners(half_a) @ rot_a.T + pa
            depth = oracles.penetration(corners_a, oracles.box_corners(half_b) @ rot_b.T + pb)
            assert got == pytest.approx(-depth, abs=2e-5)
            assert wanted < 1e-4
    assert apart > 100


def test_planes():
    rng = np.random.default_rng(5)
    model = mujoco.MjModel.from_xml_string(
        oracles.WORLD.format(
            '<geom type="plane" size="1 1 1" pos="0 0 .1"/><body><freejoint/>'
            '<geom type="box" size=".1 .2 .3"/><geom type="capsule" size=".05 .2"/></body>'
        )
    )
    data = mujoco.MjData(model)
    plane = jnp.array([0.0, 0.0, 1.0, 0.1])
    for _ in range(50):
        data.qpos[:3], data.qpos[3:] = rng.uniform(-0.5, 1, 3), oracles.random_quat(rng)
        mujoco.mj_kinematics(model, data)
        box = distance.box_plane(
            jnp.asarray(data.geom_xpos[1]),
            jnp.asarray(data.geom_xmat[1].reshape(3, 3)),
            jnp.array([0.1, 0.2, 0.3]),
            plane,
        )
        lowest = (
            oracles.box_corners(np.array([0.1, 0.2, 0.3])) @ data.geom_xmat[1].reshape(3, 3).T
            + data.geom_xpos[1]
        )[:, 2].min() - 0.1
        assert float(box) == pytest.approx(lowest, abs=1e-6)
        ends = capsule_ends(data.qpos[:3], data.qpos[3:], 0.2)
        wanted = mujoco.mj_geomDistance(model, data, 0, 2, 5.0, None)
        assert float(distance.capsule_plane(ends, 0.05, plane)) == pytest.approx(wanted, abs=1e-5)


def test_gradient_of_a_distance_is_finite_where_it_is_zero():
    ends = jnp.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    grad = jax.grad(lambda e: distance.capsule_box(e, 0.05, jnp.array([0.1, 0.1, 0.1])))(ends)
    assert np.isfinite(grad).all()
    assert np.isfinite(jax.grad(lambda e: distance.segment_segment(e, ends))(ends)).all()


def test_quaternion_matrix_agrees_with_mujoco():
    quat = oracles.random_quat(np.random.default_rng(6))
    np.testing.assert_allclose(
        dq.quat_matrix(jnp.asarray(quat, jnp.float32)), matrix(quat), atol=1e-6
    )
