# SPDX-License-Identifier: MIT
"""The arm of the joint agent's environment under its servos, on MJX: for accelerators.

One copy's whole state is `qpos` and `qvel`; the engine's other arrays are made anew in each step,
so thousands of copies fit into memory. A held object is out of the way, far above: it counts for
the checks alone.
"""

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from hybrid_jax.errors import WorkcellError
from hybrid_jax.mjx import physics
from hybrid_jax.mjx.collision import scene_qpos
from hybrid_jax.types import Record, Workcell, pytree


@pytree
class Body(Record):
    """Where one copy's bodies are and how they move, as in MuJoCo."""

    qpos: Array
    """`[nq]` positions [m, rad] and quaternions of objects."""
    qvel: Array
    """`[nv]` velocities [m/s, rad/s]."""


class Servos:
    """Moves the arm by commanding its servos for a while."""

    def __init__(self, cell: Workcell, period: float):
        """Put the cell's model on the device.

        Args:
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

    def rest(self, cell: Workcell, q: Float[Array, " n"]) -> Body:
        """The bodies of a cell's scene at rest, the arm at `q` `[joint]` [rad or m]."""
        return Body(scene_qpos(cell, q), jnp.zeros(cell.model.nv))

    def move(self, body: Body, wanted: Float[Array, " n"], opening: Float[Array, ""]) -> Body:
        """The bodies after one period under a constant command.

        Args:
            body: before.
            wanted: `[joint]` configuration that the servos are told to reach [rad or m].
            opening: `[]` of the gripper: how far each finger is from its closed position [m].
        """
        command = physics.hold_command(self.cell, body.qpos.at[self.joints].set(wanted))
        if self.gripper >= 0:
            command = command.at[self.gripper].set(opening)
        # only qpos and qvel go from move to move: whole data of all copies would not fit
        data = physics.start_state(self.cell, body.qpos)
        data = physics.step(self.model, data.replace(qvel=body.qvel, ctrl=command), self.steps)
        return Body(data.qpos, data.qvel)

    def configuration(self, body: Body) -> Float[Array, " n"]:
        """Configuration `[joint]` of the arm [rad or m]."""
        return body.qpos[self.joints]
