# SPDX-License-Identifier: MIT
"""Clearance by MJX's kinematics and collision functions: the other collision backend.

The distances are those of MJX's contact points: right in sign, but no smallest distance of
primitives, and only one number where primitives are far apart. Objects are where the scene has
them. A payload is not seen: the object that is held is far above.
"""

import functools

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float

from hybrid_jax.errors import UnknownNameError
from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels.collision import clearance as fused
from hybrid_jax.runtime.quiet import import_mjx
from hybrid_jax.types import Workcell
from hybrid_jax.workcell.allowed_collisions import forbidden_contacts
from hybrid_jax.workcell.layout import home_qpos, moved_geoms
from hybrid_jax.workcell.source import WorkcellSource

ALOFT = 1000.0
"""How far a held object is raised: where nothing is, also after falling for ten seconds [m]."""


def _mjx():
    """MJX, imported when it is first needed: it takes seconds."""
    import_mjx()
    from mujoco import mjx

    return mjx


@functools.cache
def _put(source: WorkcellSource):
    """The cell's model and a state of it on the device, made once."""
    # evaluated at once even where a caller is being traced: what is cached must hold no tracers
    with jax.ensure_compile_time_eval():
        return _mjx().put_model(source.model), _mjx().make_data(source.model)


def _object_poses(cell: Workcell) -> Float[Array, "object 7"]:
    """Poses of the objects' bodies, from where the scene has their first primitives."""
    # world frame of a body = pose of its primitive in the world, less that in the body's frame
    owners = cell.source.owners
    first = jnp.array([owners.index(k) for k in range(len(cell.source.layout.object_names))], int)
    in_scene, local = cell.scene.objects.pose[first], cell.objects.pose[first]
    rotation = dq.quat_mul(in_scene[:, 3:], dq.quat_conj(local[:, 3:]))
    position = in_scene[:, :3] - dq.quat_rotate(rotation, local[:, :3])
    held = cell.scene.objects.active[first, None] <= 0
    return jnp.concatenate([position + held * jnp.array([0.0, 0.0, ALOFT]), rotation], axis=1)


def scene_qpos(cell: Workcell, q: Array) -> Array:
    """MuJoCo's `qpos` of a configuration in the scene of the cell.

    Args:
        cell: robot and scene.
        q: `[joint]` configuration of the arm [rad or m].

    Returns:
        `[nq]` the arm at `q`, the fingers at the scene's opening, the objects where the scene has
        them; one that is held is `ALOFT` above.
    """
    model, layout = cell.source.model, cell.source.layout
    qpos = jnp.asarray(home_qpos(model), jnp.float32).at[jnp.array(layout.qpos)].set(q)
    fingers = jnp.array([int(model.jnt_qposadr[j]) for j in layout.fingers], int)
    qpos = qpos.at[fingers].set(cell.scene.opening)
    if layout.object_qpos:
        rows = jnp.array(layout.object_qpos)[:, None] + jnp.arange(7)
        qpos = qpos.at[rows].set(_object_poses(cell))
    return qpos


@jax.jit
def closest(cell: Workcell, q: Float[Array, " n"]) -> tuple[Float[Array, ""], Bool[Array, ""]]:
    """Smallest contact distance of the arm, and whether it is with the robot itself.

    The counterpart of `kernels.collision.clearance.closest`.

    Args:
        cell: robot and scene.
        q: `[joint]` configuration [rad or m].

    Returns:
        `[]` distance [m], `FAR` where nothing can touch, and `[]` True for robot against robot.
    """
    model, data = _put(cell.source)
    data = _mjx().kinematics(model, data.replace(qpos=scene_qpos(cell, q)))
    contact = _mjx().collision(model, data)._impl.contact
    model, layout = cell.source.model, cell.source.layout
    on_robot = jnp.asarray(moved_geoms(model, layout))[contact.geom]
    forbidden = jnp.asarray(forbidden_contacts(model, layout))
    gaps = jnp.where(forbidden[*contact.geom.T], contact.dist, fused.FAR)
    nearest = jnp.argmin(gaps)
    return gaps[nearest], on_robot[nearest].all()


BACKENDS = {"fused": fused.closest, "mjx": closest}
"""Collision backends by name. On a CPU `fused` is faster by two orders of magnitude or more."""


def backend(name: str):
    """Find a collision backend by its name.

    Returns:
        Function like `closest`: from a cell and a configuration `[joint]` to a distance `[]` [m],
        and whether it is that of the robot to itself `[]`.

    Raises:
        UnknownNameError: no such backend; the message lists them.
    """
    if name not in BACKENDS:
        raise UnknownNameError("collision backend", name, BACKENDS)
    return BACKENDS[name]
