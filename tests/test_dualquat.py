# SPDX-License-Identifier: MIT
"""Dual quaternions against SciPy's RigidTransform and matrix exponential."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import RigidTransform, Rotation

from hybrid_jax.kernels import dualquat as dq

pytestmark = pytest.mark.usefixtures("strict_promotion")


def random_transform(rng):
    return RigidTransform.from_components(rng.normal(size=3), Rotation.random(rng=rng))


def to_dual(t):
    return jnp.asarray(
        dq.from_parts(
            jnp.asarray(t.translation), jnp.asarray(t.rotation.as_quat(scalar_first=True))
        )
    )


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


def test_product_inverse_and_action_agree_with_scipy():
    rng = np.random.default_rng(0)
    for _ in range(20):
        a, b, p = random_transform(rng), random_transform(rng), rng.normal(size=3)
        ab = dq.mul(to_dual(a), to_dual(b))
        np.testing.assert_allclose(dq.to_matrix(ab), (a * b).as_matrix(), atol=1e-12)
        np.testing.assert_allclose(
            dq.to_matrix(dq.conj(to_dual(a))), a.inv().as_matrix(), atol=1e-12
        )
        np.testing.assert_allclose(dq.act(to_dual(a), jnp.asarray(p)), a.apply(p), atol=1e-12)


ANGLES = [0.0, 1e-9, 1e-5, 1e-3, 0.05, 0.09, 0.11, 1.0, 3.1, np.pi]


def random_twist(angle, seed=1):
    """`(v, w)` with a given angle."""
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    return np.concatenate([rng.normal(size=3), angle * axis / np.linalg.norm(axis)])


def scipy_exp(twist):
    """SciPy puts the rotation first."""
    return RigidTransform.from_exp_coords(np.concatenate([twist[3:], twist[:3]]))


@pytest.mark.parametrize("angle", ANGLES)
def test_exp_is_the_matrix_exponential_and_log_its_inverse(angle):
    twist = random_twist(angle)
    hat = np.zeros((4, 4))
    hat[:3, :3] = np.cross(np.eye(3), twist[3:])
    hat[:3, 3] = twist[:3]
    pose = dq.exp(jnp.asarray(twist))
    np.testing.assert_allclose(dq.to_matrix(pose), expm(hat), atol=1e-12)
    np.testing.assert_allclose(dq.to_matrix(dq.exp(dq.log(pose))), expm(hat), atol=1e-12)


@pytest.mark.parametrize("angle", ANGLES[:-1])
def test_exp_and_log_agree_with_scipy(angle):
    twist = random_twist(angle, seed=4)
    pose = dq.exp(jnp.asarray(twist))
    np.testing.assert_allclose(dq.to_matrix(pose), scipy_exp(twist).as_matrix(), atol=1e-12)
    np.testing.assert_allclose(dq.log(to_dual(scipy_exp(twist))), twist, atol=1e-12)


@pytest.mark.parametrize("angle", ANGLES)
def test_single_precision_keeps_five_digits(angle):
    twist = random_twist(angle, seed=5)
    wanted = scipy_exp(twist)
    pose = dq.exp(jnp.asarray(twist, jnp.float32))
    assert pose.dtype == jnp.float32
    np.testing.assert_allclose(dq.to_matrix(pose), wanted.as_matrix(), atol=1e-5)
    np.testing.assert_allclose(dq.to_matrix(dq.exp(dq.log(pose))), wanted.as_matrix(), atol=1e-5)
    half = dq.sclerp(jnp.asarray(dq.IDENTITY, jnp.float32), pose, jnp.float32(0.5))
    found = np.asarray(dq.to_matrix(dq.mul(half, half)))
    np.testing.assert_allclose(found, wanted.as_matrix(), atol=1e-5)


def test_gradients_are_finite_at_the_identity():
    assert np.isfinite(jax.jacrev(dq.exp)(jnp.zeros(6))).all()
    assert np.isfinite(jax.jacrev(dq.log)(jnp.array(dq.IDENTITY))).all()


def test_sclerp_meets_its_ends_and_does_not_depend_on_the_frame():
    rng = np.random.default_rng(2)
    a, b, g = (to_dual(random_transform(rng)) for _ in range(3))
    np.testing.assert_allclose(
        dq.to_matrix(dq.sclerp(a, b, jnp.array(1.0))), dq.to_matrix(b), atol=1e-12
    )
    moved = dq.sclerp(dq.mul(g, a), dq.mul(g, b), jnp.array(0.3))
    np.testing.assert_allclose(
        dq.to_matrix(moved), dq.to_matrix(dq.mul(g, dq.sclerp(a, b, jnp.array(0.3)))), atol=1e-12
    )


def test_float32_keeps_five_digits():
    rng = np.random.default_rng(3)
    a, b = random_transform(rng), random_transform(rng)
    got = dq.to_matrix(dq.mul(to_dual(a).astype(jnp.float32), to_dual(b).astype(jnp.float32)))
    np.testing.assert_allclose(got, (a * b).as_matrix(), atol=1e-5)
