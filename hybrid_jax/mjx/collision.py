# SPDX-License-Identifier: MIT
"""Clearance by MJX's kinematics and collision functions: the other collision backend.

MJX tells how deep primitives overlap, and hardly anything where they do not. So it tests primitives
that are inflated: those of the robot by as much as is to be seen. The depth that is left then tells
the distance (MuJoCo: contacts within a margin).
"""

import functools
from collections.abc import Callable
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jax import Array
from jaxtyping import Bool, Float

from hybrid_jax.errors import UnknownNameError
from hybrid_jax.kernels.collision import clearance as fused
from hybrid_jax.kernels.collision.distance import FAR
from hybrid_jax.kernels.collision.primitive_kinds import rows_as_boxes
from hybrid_jax.mjx.collision_model import CollisionModel, collision_model
from hybrid_jax.runtime.compiler_options import quick_options, vector_options
from hybrid_jax.runtime.quiet import import_mjx
from hybrid_jax.types import Shapes, Workcell
from hybrid_jax.workcell.source import WorkcellSource

SEEN = 0.02
"""Clearance beyond which `closest` tells nothing apart [m]."""
ALOFT = 1000.0
"""Where empty slots are: far above everything [m]."""
_BOX = int(mujoco.mjtGeom.mjGEOM_BOX)
LEAST = 1e-4
"""Least half length of a capsule [m]: MJX divides by it."""


def _mjx():
    """MJX, imported when it is first needed: it takes seconds."""
    import_mjx()
    from mujoco import mjx

    return mjx


class OnDevice(NamedTuple):
    """A cell's collision model on the device."""

    described: CollisionModel
    model: object
    """MJX's model."""
    data: object
    """A state of it."""


@functools.cache
def put_collision_model(source: WorkcellSource) -> OnDevice:
    """The collision model of a cell on the device, made once.

    Raises:
        WorkcellError: see `collision_model.collision_model`.
    """
    described = collision_model(source)
    # evaluated at once even where a caller is being traced: what is cached must hold no tracers
    with jax.ensure_compile_time_eval():
        return OnDevice(
            described, _mjx().put_model(described.model), _mjx().make_data(described.model)
        )


class _Geoms(NamedTuple):
    """What a scene changes of a model's geoms; fields are named as MuJoCo names them."""

    geom_pos: Array
    geom_quat: Array
    geom_size: Array
    geom_rbound: Array


def _put_slots(geoms: _Geoms, numbers: np.ndarray, shapes: Shapes) -> _Geoms:
    """Put a scene's primitives into the slots of a model.

    Args:
        geoms: `[geom, ...]`.
        numbers: `[geom]` number in `shapes` of each geom, -1 for others.
        shapes: `[n, ...]` in the frame of the geoms' body.
    """
    slots = np.flatnonzero(numbers >= 0)
    if not len(slots):
        return geoms
    picked = numbers[slots]
    pose, half, radius = (
        jnp.asarray(a)[picked] for a in (shapes.pose, shapes.half_extents, shapes.radius)
    )
    aloft = jnp.array([0.0, 0.0, ALOFT]) * (1 - jnp.asarray(shapes.active)[picked, None])
    is_box = np.isin(picked, rows_as_boxes(shapes.counts))[:, None]
    capsule = jnp.stack([radius, jnp.maximum(half[:, 2], LEAST), 0 * radius], axis=1)
    size = jnp.where(is_box, half + radius[:, None], capsule)
    return _Geoms(
        geoms.geom_pos.at[slots].set(pose[:, :3] + aloft),
        geoms.geom_quat.at[slots].set(pose[:, 3:]),
        geoms.geom_size.at[slots].set(size),
        geoms.geom_rbound.at[slots].set(jnp.linalg.norm(half, axis=1) + radius),
    )


def _growth(described: CollisionModel, enough: Array) -> Array:
    """`[geom]` by how much geoms are inflated: balls and capsules of robot and payload alone [m].

    A box that grows along its axes grows more at its corners: what is beside them would seem
    nearer than it is, at times within the robot itself.
    """
    moving = (described.robot >= 0) | (described.payload >= 0)
    return enough * (moving & (described.model.geom_type != _BOX))


def _inflated(geoms: _Geoms, growth: Array) -> _Geoms:
    """Balls and capsules inflated by `growth` `[geom]` [m]."""
    return geoms._replace(
        geom_size=geoms.geom_size.at[:, 0].add(growth), geom_rbound=geoms.geom_rbound + growth
    )


def _scene_geoms(cell: Workcell, on_device: OnDevice) -> _Geoms:
    """Geoms of the cell's scene."""
    described, model = on_device.described, on_device.model
    geoms = _Geoms(*(getattr(model, name) for name in _Geoms._fields))
    robot = np.flatnonzero(described.robot >= 0)
    stroke = jnp.asarray(cell.robot.stroke)[described.robot[robot]]
    opened = geoms.geom_pos.at[robot].add(cell.scene.opening * stroke)
    geoms = _put_slots(geoms._replace(geom_pos=opened), described.payload, cell.scene.payload)
    return _put_slots(geoms, described.object, cell.scene.objects)


def _counting(cell: Workcell, described: CollisionModel, first: Array, second: Array) -> Array:
    """`[contact]` False where a geom is an empty slot, or the payload rests on its support.

    Args:
        cell: robot and scene.
        described: its model.
        first, second: `[contact]` geoms.
    """
    active = jnp.ones(described.model.ngeom, bool)
    for numbers, shapes in (
        (described.payload, cell.scene.payload),
        (described.object, cell.scene.objects),
    ):
        slots = np.flatnonzero(numbers >= 0)
        active = active.at[slots].set(jnp.asarray(shapes.active)[numbers[slots]] > 0)
    is_payload = jnp.asarray(described.payload >= 0)
    supports = (described.fixture >= 0) & (
        jnp.asarray(cell.scene.support_on)[described.fixture] == 0
    )
    resting = (is_payload[first] & supports[second]) | (is_payload[second] & supports[first])
    return active[first] & active[second] & ~resting


def _many_near(model, data, described: CollisionModel) -> Array:
    """Do more pairs of one kind have overlapping bounding spheres than MJX looks at? `[]`"""
    limit, kinds = int(described.model.numeric_data[0]), described.model.geom_type
    pairs = np.stack([described.model.pair_geom1, described.model.pair_geom2])
    pair_kinds, many = np.sort(kinds[pairs], axis=0), jnp.zeros((), bool)
    for kind in np.unique(pair_kinds, axis=1).T:
        a, b = pairs[:, (pair_kinds == kind[:, None]).all(axis=0)]
        if len(a) > limit:
            apart = jnp.linalg.norm(data.geom_xpos[b] - data.geom_xpos[a], axis=1)
            near = apart - (model.geom_rbound[a] + model.geom_rbound[b]) < 0
            many = many | (jnp.sum(near) > limit)
    return many


@jax.jit
def nearest(
    cell: Workcell, q: Float[Array, " n"], enough: float | Array
) -> tuple[Float[Array, ""], Bool[Array, ""]]:
    """The smaller of the clearance and `enough`, and whether it is that of the robot to itself.

    Args:
        cell: robot and scene.
        q: `[joint]` configuration [rad or m].
        enough: `[]` clearance beyond which nothing is told apart [m].

    Returns:
        `[]` distance [m] and `[]` True for robot against robot. Of the robot's boxes it is known
        only whether they touch. Where more pairs are near than MJX looks at, the distance is no
        more than zero.
    """
    on_device = put_collision_model(cell.source)
    described = on_device.described
    growth = _growth(described, jnp.asarray(enough))
    geoms = _inflated(_scene_geoms(cell, on_device), growth)
    model = on_device.model.replace(**geoms._asdict())
    data = _mjx().kinematics(model, on_device.data.replace(qpos=q))
    contact = _mjx().collision(model, data)._impl.contact
    first, second = contact.geom.T
    # MJX tells that primitives do not overlap, and mostly not how far apart they are
    counts = _counting(cell, described, first, second) & (contact.dist < 0)
    distance = jnp.where(counts, contact.dist + growth[first] + growth[second], FAR)
    pair = jnp.argmin(distance)
    gap = jnp.minimum(distance[pair], enough)
    gap = jnp.where(_many_near(model, data, described), jnp.minimum(gap, 0.0), gap)
    is_robot = jnp.asarray((described.robot >= 0) | (described.payload >= 0))
    return gap, is_robot[first[pair]] & is_robot[second[pair]]


def clearance_up_to(
    cell: Workcell, q: Float[Array, " n"], enough: float | Array
) -> Float[Array, ""]:
    """The smaller of the clearance and `enough` `[]` [m] at a configuration `[joint]`.

    The counterpart of `kernels.collision.clearance.clearance_up_to`, see `nearest`.
    """
    return nearest(cell, q, enough)[0]


def closest(cell: Workcell, q: Float[Array, " n"]) -> tuple[Float[Array, ""], Bool[Array, ""]]:
    """Clearance `[]` [m], up to `SEEN`, and whether it is that of the robot to itself `[]`.

    The counterpart of `kernels.collision.clearance.closest`, see `nearest`.
    """
    return nearest(cell, q, SEEN)


Backend = Literal["fused", "mjx"]
"""Name of a collision backend: this package's kernels, or MJX."""
CLOSEST = {"fused": fused.closest, "mjx": closest}
"""`closest` of each backend. On a CPU `fused` is faster by two orders of magnitude."""
CLEARANCE_UP_TO = {"fused": fused.clearance_up_to, "mjx": clearance_up_to}
"""`clearance_up_to` of each backend."""


def find_backend(name: str) -> Backend:
    """The name of a collision backend.

    Raises:
        UnknownNameError: no such backend; the message lists them.
    """
    if name not in CLOSEST:
        raise UnknownNameError("collision backend", name, CLOSEST)
    return name  # type: ignore[return-value]


def compiler_options(backend: Backend) -> dict[str, int | bool]:
    """Options of XLA's compiler for a program that measures by a backend.

    Without them MJX computes shared values of its loops again and again on a CPU.
    """
    return quick_options() if backend == "mjx" else vector_options()


_BATCH = 64


@functools.cache
def _clearances() -> Callable:
    run = jax.vmap(clearance_up_to, (None, 0, None))
    return jax.jit(run, compiler_options=quick_options())


def smallest_clearance(cell: Workcell, q: Float[np.ndarray, "b n"]) -> float:
    """Smallest clearance at configurations `[b, joint]` [rad or m], up to `SEEN` [m]."""
    gap = SEEN
    for start in range(0, len(q), _BATCH):
        # the last batch repeats its last row: one size of batch needs one program
        rows = np.minimum(np.arange(start, start + _BATCH), len(q) - 1)
        found = _clearances()(cell, jnp.asarray(q[rows], jnp.float32), SEEN)
        gap = min(gap, float(found.min()))
    return gap
