# SPDX-License-Identifier: MIT
"""Rates of the kernels on the handling cell, beside C MuJoCo on one thread in the same run."""

from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import tyro

from benchmarks.report import metric, rate, write
from hybrid_jax.ik import solve_ik
from hybrid_jax.kernels.collision import clearance
from hybrid_jax.kernels.kinematics import tool_pose
from hybrid_jax.kernels.rays import sense
from hybrid_jax.workcell.layout import home_qpos
from hybrid_jax.workcell.load import load_workcell

BATCH = 2048


def engine(cell, q: np.ndarray) -> int:
    """Kinematics and collision of C MuJoCo, configuration after configuration."""
    model, data = cell.model, mujoco.MjData(cell.model)
    data.qpos[:] = home_qpos(model)
    address, contacts = list(cell.source.layout.qpos), 0
    for row in q:
        data.qpos[address] = row
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        contacts += data.ncon
    return contacts


def main(json: Path | None = None) -> None:
    """Measure and print; write JSON if asked to."""
    cell = load_workcell("gen3_handling")
    low, high = np.asarray(cell.joint_limits).T
    q = np.random.default_rng(0).uniform(low, high, (BATCH, len(low))).astype(np.float32)
    over = lambda f: jax.jit(jax.vmap(f))  # noqa: E731
    pose, gap, rays = (over(lambda x, f=f: f(cell, x)) for f in (tool_pose, clearance, sense))
    poses = pose(q)
    keys = jax.random.split(jax.random.key(0), 256)
    solve = over(lambda p, k: solve_ik(cell, p, key=k))
    ours, first = rate(lambda: gap(q), BATCH)
    rival, _ = rate(lambda: engine(cell, q[:512]), 512)
    found = float(jnp.mean(solve(poses[:256], keys).found))
    write(
        [
            metric("kernels.fk", rate(lambda: pose(q), BATCH)[0], "1/s", "higher"),
            metric("kernels.clearance", ours, "1/s", "higher", f"first call {first:.1f} s"),
            metric("kernels.mujoco_one_thread", rival, "1/s", "higher", "Python loop"),
            metric("kernels.clearance_vs_mujoco", ours / rival, "1", "higher"),
            metric("kernels.rays", rate(lambda: rays(poses), BATCH)[0], "1/s", "higher", "25 each"),
            metric("kernels.ik", rate(lambda: solve(poses[:256], keys), 256)[0], "1/s", "higher",
                   f"16 seeds, {found:.3f} found"),
        ],
        json,
    )  # fmt: skip


if __name__ == "__main__":
    tyro.cli(main)
