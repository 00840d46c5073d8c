# SPDX-License-Identifier: MIT
"""The arm of the joint agent's world under its servos, on MJX: for accelerators.

One copy's whole state is `qpos` and `qvel`; the engine's other arrays are made anew in each step,
so thousands of copies fit into memory. A held object is out of the way, far above: it counts for
the checks alone.
"""

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from hybrid_jax.errors import WorkcellError
from hybrid_jax.simulation import physics
from hybrid_jax.types import Workcell, pytree
from hybrid_jax.workcell.mjxcollision import scene_qpos


@pytree
class Body:
    """Where one copy's bodies are and how they move."""

    qpos: Array
    """`[nq]`"""
    qvel: Array
    """`[nv]`"""


class Servos:
    """Moves the arm by commanding its servos for a while."""

    def __init__(self, cell: Workcell, period: float):
        """Args:
            cell: any scene of the cell.
            period: time of a move [s].

        Raises:
            WorkcellError: a joint of the arm has no servo.
        """
        layout = cell.source.layout
        for joint, actuator in zip(cell.joint_names, layout.actuators, strict=True):
            if actuator < 0:
                raise WorkcellError(
                    f"{cell.source.name}: joint {joint!r} has no position actuator, which "
                    f"physics 'mjx' moves it by; give it one, or choose physics 'kinematic'"
                )
        self.cell, self.model = cell, physics.put_cell(cell)
        self.steps = max(1, round(period / cell.model.opt.timestep))
        self.joints, self.gripper = jnp.array(layout.qpos), layout.gripper_actuator

    def rest(self, cell: Workcell, q: Float[Array, "n"]) -> Body:
        """The bodies of a scene at rest, the arm at `q`."""
        return Body(scene_qpos(cell, q), jnp.zeros(cell.model.nv))

    def move(self, body: Body, wanted: Float[Array, "n"], opening: Float[Array, ""]) -> Body:
        """After a period under the command to go to `wanted`, the fingers `opening` from closed."""
        command = physics.hold_command(self.cell, body.qpos.at[self.joints].set(wanted))
        if self.gripper >= 0:
            command = command.at[self.gripper].set(opening)
        data = physics.start_state(self.cell, self.model, body.qpos)
        data = physics.step(self.model, data.replace(qvel=body.qvel, ctrl=command), self.steps)
        return Body(data.qpos, data.qvel)

    def configuration(self, body: Body) -> Float[Array, "n"]:
        """Of the arm."""
        return body.qpos[self.joints]
