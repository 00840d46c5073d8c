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

from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels.collision import distance
from hybrid_jax.kernels.collision.rounded_boxes import RoundedBoxes

pytestmark = pytest.mark.usefixtures("strict_promotion")


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


SIZES = {"sphere": (0.05,), "capsule": (0.04, 0.15), "box": (0.1, 0.2, 0.05)}


def block(kind, position, quat):
    """A geom as a box swept by a ball."""
    size = SIZES[kind]
    half = {"sphere": (0, 0, 0), "capsule": (0, 0, size[-1]), "box": size}[kind]
    radius = 0.0 if kind == "box" else size[0]
    fields = (position, matrix(quat), half, half, radius)
    return RoundedBoxes(*(jnp.asarray(f, jnp.float32) for f in fields))


@pytest.mark.parametrize("kind_b", SIZES)
@pytest.mark.parametrize("kind_a", SIZES)
def test_swept_boxes_stand_for_every_kind(kind_a, kind_b):
    model, data = oracles.geom_pair(kind_a, SIZES[kind_a], kind_b, SIZES[kind_b])
    pair, capsule = jax.jit(distance.rounded_box_rounded_box), jax.jit(distance.capsule_rounded_box)
    apart = 0
    for pa, qa, pb, qb in placed_pairs(model, data, 60, 0.35):
        a, b = block(kind_a, pa, qa), block(kind_b, pb, qb)
        got = float(pair(a, b))
        assert got == pytest.approx(float(pair(b, a)), abs=2e-5)
        if kind_a != "box":
            axis = a.rotation[:, 2] * a.half_extents[2]
            assert got == pytest.approx(float(capsule(a.centre, axis, a.radius, b)), abs=2e-5)
        wanted = mujoco.mj_geomDistance(model, data, 0, 1, 5.0, None)
        if got > 0:
            assert got == pytest.approx(wanted, abs=1e-4)
            apart += 1
    assert apart > 20


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


def test_gradient_of_a_distance_is_finite_where_it_is_zero():
    ends = jnp.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    grad = jax.grad(lambda e: distance.capsule_box(e, 0.05, jnp.array([0.1, 0.1, 0.1])))(ends)
    assert np.isfinite(grad).all()


def test_quaternion_matrix_agrees_with_mujoco():
    quat = oracles.random_quat(np.random.default_rng(6))
    np.testing.assert_allclose(
        dq.quat_matrix(jnp.asarray(quat, jnp.float32)), matrix(quat), atol=1e-6
    )
