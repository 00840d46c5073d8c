# SPDX-License-Identifier: MIT
"""The arm under its servos, on MJX: torque limits, payload, and the way that it really takes.

The model holds the arm and its gripper alone. Objects are welded where they are, and nothing
touches: whoever moves the arm checks its way (`mjx.collision`), so contact never comes about, and
a step costs little. What the gripper holds is a body at the tool whose mass a scene tells.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jax import Array
from jaxtyping import Float

from hybrid_jax.errors import WorkcellError
from hybrid_jax.runtime.quiet import import_mjx
from hybrid_jax.types import Record, Workcell, pytree
from hybrid_jax.workcell.layout import home_qpos
from hybrid_jax.workcell.load import compile_spec
from hybrid_jax.workcell.source import WorkcellSource

PAYLOAD = "hybrid_jax payload"
"""Name of the body that stands for what is held."""
RADIUS_OF_GYRATION = 0.03
"""Of a payload about its centre [m]; the arm feels its weight, and hardly how it is spread."""
LEAST_MASS = 1e-6
"""Mass of an empty gripper's payload: MuJoCo takes no body without [kg]."""
ITERATIONS, LINE_SEARCHES = 4, 8
"""Of the solver: limits of joints, their friction and coupled fingers are all that it solves."""


@pytree
class Body(Record):
    """Where one copy's joints are and how they move, as in MuJoCo."""

    qpos: Array
    """`[nq]` positions of the arm and the gripper [rad, m]."""
    qvel: Array
    """`[nv]` velocities [rad/s, m/s]."""


class ServoModel(NamedTuple):
    """The arm with its gripper, and where its joints are."""

    model: mujoco.MjModel
    joints: tuple[int, ...]
    """`qpos` of each joint of the arm."""
    fingers: tuple[int, ...]
    """`qpos` of each joint of the gripper's fingers."""
    payload: int
    """Number of the payload's body."""
    home: np.ndarray
    """`[nq]` positions of all joints at home [rad, m]."""


def _without_contact(spec: mujoco.MjSpec, source: WorkcellSource) -> mujoco.MjSpec:
    """A copy of a cell's spec whose objects are welded and in which nothing touches."""
    spec = spec.copy()
    for key in list(spec.keys):  # they are as long as all positions
        spec.delete(key)
    for name in source.layout.object_names:
        for joint in list(spec.body(name).joints):
            spec.delete(joint)
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    # MJX fails at elliptic cones where there are no contacts
    spec.option.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL
    spec.option.iterations, spec.option.ls_iterations = ITERATIONS, LINE_SEARCHES
    site = spec.site(source.model.site(source.layout.tool_site).name)
    body = site.parent.add_body(name=PAYLOAD, pos=site.pos, quat=site.quat)
    body.mass, body.explicitinertial = LEAST_MASS, True
    body.inertia = np.full(3, LEAST_MASS * RADIUS_OF_GYRATION**2)
    return spec


def servo_model(source: WorkcellSource) -> ServoModel:
    """The arm with its gripper as a model of its own; call it by `source.once(servo_model)`.

    Raises:
        WorkcellError: a joint of the arm has no servo, or the cell was read from a compiled model.
    """
    layout = source.layout
    for joint, actuator in zip(layout.joint_names, layout.actuators, strict=True):
        if actuator < 0:
            raise WorkcellError(
                f"{source.name}: joint {joint!r} has no position actuator, which "
                f"physics 'mjx' moves it by; give it one, or choose physics 'kinematic'"
            )
    if source.spec is None:
        raise WorkcellError(
            f"{source.name}: physics 'mjx' takes the arm out of the cell's MJCF or URDF file, and "
            f"this cell is a compiled model: load its source, or choose physics 'kinematic'"
        )
    model = compile_spec(_without_contact(source.spec, source))
    welded = np.isin(source.model.jnt_bodyid, source.layout.object_bodies)
    # joints keep their order: the n-th of those that are left is the n-th of the model
    address = dict(zip(source.model.jnt_qposadr[~welded], model.jnt_qposadr, strict=True))
    is_objects = np.zeros(source.model.nq, bool)
    for first in layout.object_qpos:
        is_objects[first : first + 7] = True
    return ServoModel(
        model,
        tuple(int(address[a]) for a in layout.qpos),
        tuple(int(address[source.model.jnt_qposadr[j]]) for j in layout.fingers),
        int(model.body(PAYLOAD).id),
        home_qpos(source.model)[~is_objects],
    )


def _mjx() -> Any:
    """MJX, imported when it is first needed: it takes seconds."""
    import_mjx()
    from mujoco import mjx

    return mjx


def _put(source: WorkcellSource) -> tuple[Any, Any]:
    """The servo model of a cell and a state of it on the device, made once."""
    model = source.once(servo_model).model
    # evaluated at once even where a caller is being traced: what is cached must hold no tracers
    with jax.ensure_compile_time_eval():
        return _mjx().put_model(model), _mjx().make_data(model)


def payload_mass(cell: Workcell) -> tuple[Float[Array, ""], Float[Array, "3"]]:
    """Mass `[]` [kg] and centre `[3]` in the tool's frame [m] of what the cell's gripper holds."""
    source, scene = cell.source, cell.scene
    if not source.layout.object_bodies or not scene.payload.count:
        return jnp.float32(0.0), jnp.zeros(3)
    owners = np.array(source.owners)
    is_object = owners[None] == np.arange(len(source.layout.object_bodies))[:, None]
    held = jnp.max(is_object * (1 - jnp.asarray(scene.objects.active)), axis=1)
    masses = source.model.body_subtreemass[list(source.layout.object_bodies)]
    share = scene.payload.active / jnp.maximum(jnp.sum(scene.payload.active), 1.0)
    return held @ jnp.asarray(masses, jnp.float32), share @ scene.payload.pose[:, :3]


class Servos:
    """Moves the arm by commanding its servos for a while."""

    def __init__(self, cell: Workcell, period: float):
        """Put the cell's arm on the device.

        Args:
            cell: any scene of the cell.
            period: time of a move [s].

        Raises:
            WorkcellError: see `servo_model`.
        """
        self.source, self.servo_model = cell.source, cell.source.once(servo_model)
        self.model, self._blank = cell.source.once(_put)
        self.steps = max(1, round(period / self.servo_model.model.opt.timestep))
        self.joints = jnp.array(self.servo_model.joints)

    def rest(self, cell: Workcell, q: Float[Array, " n"]) -> Body:
        """The arm at rest at `q` `[joint]` [rad or m], its gripper as in the cell's scene."""
        qpos = jnp.asarray(self.servo_model.home, jnp.float32)
        qpos = qpos.at[jnp.array(self.servo_model.fingers, int)].set(cell.scene.opening)
        return Body(qpos.at[self.joints].set(q), jnp.zeros(self.servo_model.model.nv))

    def configuration(self, body: Body) -> Float[Array, " n"]:
        """Configuration `[joint]` of the arm [rad or m]."""
        return body.qpos[self.joints]

    def _loaded(self, cell: Workcell) -> Any:
        """MJX's model with the payload of a scene."""
        mass, centre = payload_mass(cell)
        mass, body = jnp.maximum(mass, LEAST_MASS), self.servo_model.payload
        return self.model.replace(
            body_mass=self.model.body_mass.at[body].set(mass),
            body_inertia=self.model.body_inertia.at[body].set(mass * RADIUS_OF_GYRATION**2),
            body_ipos=self.model.body_ipos.at[body].set(centre),
        )

    def _command(self, cell: Workcell, wanted: Array) -> Array:
        """Controls `[nu]` that hold the arm at `wanted` `[joint]`, the gripper as in the scene."""
        layout = self.source.layout
        command = jnp.zeros(self.servo_model.model.nu)
        command = command.at[jnp.array(layout.actuators)].set(wanted)
        if layout.gripper_actuator >= 0:
            command = command.at[layout.gripper_actuator].set(cell.scene.opening)
        return command

    def move(
        self, cell: Workcell, body: Body, wanted: Float[Array, " n"], samples: int
    ) -> tuple[Body, Float[Array, "sample n"]]:
        """Command the servos for one period.

        Args:
            cell: what is held, and the opening of the fingers.
            body: before.
            wanted: `[joint]` configuration that the servos are told to reach [rad or m].
            samples: how many configurations on the way are looked at.

        Returns:
            The body afterwards, and configurations `[sample, joint]` that it passed [rad or m],
            evenly spaced in time, the last one at the end.
        """
        model, command = self._loaded(cell), self._command(cell, wanted)
        # only qpos and qvel go from move to move: whole data of all copies would not fit
        data = self._blank.replace(qpos=body.qpos, qvel=body.qvel, ctrl=command)
        steps = -(-self.steps // samples)

        def part(data, _):
            data = jax.lax.fori_loop(0, steps, lambda _, d: _mjx().step(model, d), data)
            return data, data.qpos[self.joints]

        data, passed = jax.lax.scan(part, data, length=samples)
        return Body(data.qpos, data.qvel), passed
