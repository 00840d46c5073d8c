# SPDX-License-Identifier: MIT
"""MJX's kinematics and collision on the handling cell, in a process of its own."""

import os
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from packaging.version import Version

from benchmarks import rivals
from benchmarks.report import rate
from hybrid_jax.runtime.quiet import import_mjx

CELL = "gen3_handling"
ROOT = Path(__file__).resolve().parents[1]


def mjx_rate(cell, q: np.ndarray) -> float:
    """Configurations per second of MJX kinematics and collision."""
    import_mjx()
    from mujoco import mjx

    model = rivals.welded_model(CELL)
    put, start = mjx.put_model(model), mjx.make_data(model)
    address = jnp.array(rivals.Engine(cell).address)

    def touch(q):
        data = start.replace(qpos=start.qpos.at[address].set(q))
        data = mjx.com_pos(put, mjx.kinematics(put, data))
        return jnp.min(mjx.collision(put, data)._impl.contact.dist)

    run = jax.jit(jax.vmap(touch))
    return rate(lambda: run(q), len(q))[0]


MJX_FLAGS = (
    "--xla_cpu_use_fusion_emitters=false" if Version(version("jaxlib")) < Version("0.11") else ""
)
"""Without it older XLA computes shared values of MJX's loops again and again."""


def mjx_in_its_process(count: int, flags: str) -> float:
    """`mjx_rate` under options of XLA, which a process takes once."""
    code = (
        "from benchmarks.kernels import configurations; "
        "from benchmarks.mjx_rival import CELL, mjx_rate; "
        "from hybrid_jax.workcell.load import load_workcell; "
        f"cell = load_workcell(CELL); print(mjx_rate(cell, configurations(cell, {count})))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
        env={**os.environ, "XLA_FLAGS": flags},
    )
    return float(done.stdout.split()[-1])
