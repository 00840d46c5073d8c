# SPDX-License-Identifier: MIT
"""The ray sensor against `mj_ray`."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import oracles
import pytest

from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels.collision.ray_lengths import ray_box, ray_capsule
from hybrid_jax.kernels.kinematics import tool_pose
from hybrid_jax.kernels.rays import RAY_RANGE, fibonacci_directions, sense

pytestmark = pytest.mark.usefixtures("strict_promotion")


@pytest.mark.parametrize(
    "kind, size", [("sphere", (0.2,)), ("capsule", (0.1, 0.3)), ("box", (0.1, 0.2, 0.3))]
)
def test_single_rays(kind, size):
    model = mujoco.MjModel.from_xml_string(
        oracles.WORLD.format(
            f'<body><freejoint/><geom type="{kind}" size="{" ".join(map(str, size))}"/></body>'
        )
    )
    data, rng, hits = mujoco.MjData(model), np.random.default_rng(0), 0
    half = size[1] if kind == "capsule" else 0.0
    ball = jax.jit(ray_capsule)
    block = jax.jit(ray_box)
    for _ in range(500):
        data.qpos[:3], data.qpos[3:] = rng.uniform(-0.3, 0.3, 3), oracles.random_quat(rng)
        mujoco.mj_kinematics(model, data)
        origin, direction = rng.uniform(-0.4, 0.4, 3), rng.normal(size=3)
        direction /= np.linalg.norm(direction)
        wanted = mujoco.mj_ray(
            model, data, origin, direction, None, 1, -1, np.zeros(1, np.int32), None
        )
        o, d = jnp.asarray(origin, jnp.float32), jnp.asarray(direction, jnp.float32)
        if kind == "box":
            pose = jnp.asarray(np.concatenate([data.qpos[:3], data.qpos[3:]]), jnp.float32)
            got = float(block(o, d, pose, jnp.array(size)))
        else:
            axis = data.geom_xmat[0].reshape(3, 3)[:, 2] * half
            ends = jnp.asarray(np.stack([data.qpos[:3] - axis, data.qpos[:3] + axis]), jnp.float32)
            got = float(ball(o, d, ends, size[0]))
        if wanted < 0:
            assert got == np.inf
        else:
            assert got == pytest.approx(wanted, abs=2e-4)
            hits += 1
    assert hits > 30


def test_sensor_of_the_cell(cell, configurations):
    model = cell.model
    moved = np.zeros(model.nbody, bool)
    roots = {int(model.jnt_bodyid[j]) for j in cell.source.layout.joints}
    for body in range(1, model.nbody):
        moved[body] = moved[model.body_parentid[body]] or body in roots
    saved = model.geom_group.copy()
    model.geom_group[:] = np.where(moved[model.geom_bodyid], 5, 0)  # the robot is unseen
    groups = np.array([1, 1, 1, 1, 1, 0], np.uint8)
    try:
        for q in configurations[:40]:
            pose = tool_pose(cell, q)
            data = oracles.cell_data(cell, q)
            got = np.asarray(sense(cell, pose))
            turn = np.asarray(dq.quat_matrix(pose[:4]), float)
            for direction, length in zip(fibonacci_directions(25) @ turn.T, got, strict=True):
                wanted = mujoco.mj_ray(
                    model,
                    data,
                    np.asarray(dq.position(pose), float),
                    direction,
                    groups,
                    1,
                    -1,
                    np.zeros(1, np.int32),
                    None,
                )
                wanted = RAY_RANGE if wanted < 0 else min(wanted, RAY_RANGE)
                assert length == pytest.approx(wanted, abs=5e-4)
    finally:
        model.geom_group[:] = saved
