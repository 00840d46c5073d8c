# SPDX-License-Identifier: MIT
"""What becomes of a planned motion on MJX: where the servos bring the arm, and what it touches.

The paper's switching agent is rewarded by the executed trajectory (section on switching: man' and
COL of its states).
"""

from collections.abc import Callable
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from hybrid_jax.mjx.collision import CLEARANCE_UP_TO, Backend
from hybrid_jax.mjx.servos import Servos
from hybrid_jax.runtime.compiler_options import quick_options
from hybrid_jax.types import Scene, Workcell

Physics = Literal["kinematic", "mjx"]
"""Where an arm gets to: just where it is told to, or where its servos bring it in dynamics."""
PERIOD = 0.05
"""Time from one point of a motion to the next [s]: 200 points take ten seconds."""
TOUCHING = 0.004
"""Clearances are measured up to this [m]; contact is what counts."""


def _follow(cell: Workcell, servos: Servos, motion: Array) -> Array:
    """Configurations `[point, joint]` that the servos reach on a motion `[point, joint]`."""

    def step(body, wanted):
        body, _ = servos.move(cell, body, wanted, 1)
        return body, servos.configuration(body)

    return jax.lax.scan(step, servos.rest(cell, motion[0]), motion)[1]


def make_executor(
    cell: Workcell, backend: Backend, physics: Physics
) -> Callable[[Scene, np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """A function that judges motions by what becomes of them.

    Args:
        cell: robot and fixtures.
        backend: what tells collisions.
        physics: `mjx` for an arm under its servos.

    Returns:
        An `Executor` of `contracts`: from a scene and motions `[motion, point, joint]` [rad or m]
        to the configurations that the arm passes, of the same shape, and `[motion, point]` whether
        it touches there what it must not.

    Raises:
        WorkcellError: the cell is not one for MJX.
    """
    servos = Servos(cell, PERIOD) if physics == "mjx" else None

    def judge(scene: Scene, motion: Array) -> tuple[Array, Array]:
        placed, measure = cell.replace(scene=scene), CLEARANCE_UP_TO[backend]
        executed = _follow(placed, servos, motion) if servos else motion
        gaps = jax.lax.map(lambda q: measure(placed, q, TOUCHING), executed, batch_size=32)
        return executed, gaps < 0

    program = jax.jit(jax.vmap(judge, (None, 0)), compiler_options=quick_options())

    def execute(scene: Scene, motions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return jax.device_get(program(scene, jnp.asarray(motions, jnp.float32)))

    return execute
