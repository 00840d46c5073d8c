# SPDX-License-Identifier: MIT
"""The nouns of the library: every record that passes from one stage to the next.

Units are metres, radians, seconds, kilograms. Quaternions are `(w, x, y, z)`. A pose is a unit
dual quaternion `[8]` (see `kernels.dualquat`). Records hold one configuration; `jax.vmap` batches.
"""

import enum
from typing import Any, TypeVar, dataclass_transform, no_type_check

import mujoco
import numpy as np
from flax import struct
from jax import Array

T = TypeVar("T")
AnyArray = Array | np.ndarray
"""Numbers on a device or on the host."""


@dataclass_transform(frozen_default=True, field_specifiers=(struct.field,))
def pytree(cls: type[T]) -> type[T]:
    """Frozen dataclass, registered with JAX.

    Field annotations are for readers: JAX also rebuilds these classes around axis numbers,
    `None` and shape structs, so runtime type checkers must leave fields alone.
    """
    return no_type_check(struct.dataclass(cls))


class Record:
    """Base of the classes that are `pytree`s."""

    def replace(self: T, **fields) -> T:
        """The same record with other values of some fields."""
        raise NotImplementedError(f"{type(self).__name__} is no pytree: {', '.join(fields)}")


@pytree
class KinematicChain(Record):
    """A serial arm as the kernels read it; fixed bodies are merged into the joint before them."""

    base: Array
    """`[7]` frame that carries the first joint, in the world: position [m], quaternion."""
    offset: Array
    """`[joint, 7]` joint frame in the frame before it at zero motion: position [m], quaternion."""
    axis: Array
    """`[joint, 3]` unit axis in the joint's own frame."""
    hinge: Array
    """`[joint]` 1 for a hinge, 0 for a slide."""
    reference: Array
    """`[joint]` joint value at which the motion is zero [rad or m]."""
    tool: Array
    """`[7]` tool frame in the last joint's frame."""
    limits: Array
    """`[joint, 2]` lower and upper limit [rad or m]."""
    velocity_limits: Array
    """`[joint]` [rad/s or m/s]."""
    acceleration_limits: Array
    """`[joint]` [rad/s^2 or m/s^2]."""


@pytree
class Shapes(Record):
    """Collision primitives in one frame: boxes swept by a ball.

    A capsule is a box without width (half extents `0, 0, l`) and a radius, a sphere one without
    any extent, a plain box has radius 0. A polytope is a convex hull swept by a ball; its half
    extents are those of a box around the hull. Arrays may have a batch axis in front.
    """

    pose: Array
    """`[n, 7]` centre [m], quaternion."""
    half_extents: Array
    """`[n, 3]` half extents of the box [m]."""
    radius: Array
    """`[n]` radius of the ball [m]."""
    hull: Array
    """`[n]` number in `ConvexHulls`: the cube, or of a polytope its own hull."""
    active: Array
    """`[n]` 1, or 0 for a slot that is empty: it is at distance `FAR`."""
    counts: tuple[int, ...] = struct.field(pytree_node=False)
    """Number of primitives of each kind of `kernels.collision.primitive_kinds`, in their order."""
    all_spheres: bool = struct.field(pytree_node=False, default=False)
    """Whether every primitive is a sphere."""

    @property
    def count(self) -> int:
        """Number of primitives, empty slots among them."""
        return self.radius.shape[-1]

    @property
    def used(self) -> int:
        """Number of primitives without empty slots; on the host."""
        return int(np.count_nonzero(np.asarray(self.active)))


PRIMITIVE_AXIS = {"pose": -2, "half_extents": -2, "radius": -1, "hull": -1, "active": -1}
"""Axis of the primitives in each array of `Shapes`."""


@pytree
class ConvexHulls(Record):
    """Convex hulls as the kernels read them: the cube from -1 to 1, then those of meshes."""

    candidates: Array
    """`[slice, 3, SLICE]` vertices, cell by cell of `kernels.collision.support_map`: those that can
    be the farthest along a direction of the cell, in the hull's frame [m]."""
    first: Array
    """`[hull * cell + 1]` the first slice of each cell, and their number."""
    faces: Array
    """`[hull, face, 4]` outward unit normals, and distances of the planes from the origin [m]."""


@pytree
class RobotShapes(Record):
    """Primitives of links and fingers; the payload's slots stand in the scene."""

    shapes: Shapes
    """Each in the frame of the link that carries it, sorted by link within each kind."""
    stroke: Array
    """`[n, 3]` displacement per metre of gripper opening, in the same frame; 0 but for fingers."""
    link: AnyArray
    """`[n]` number of the joint whose frame carries each primitive."""


@pytree
class ContactPairs(Record):
    """Which primitives may touch which: 1 where a pair counts.

    Rows are the robot's primitives and the payload's slots in the order of
    `kernels.collision.rounded_boxes.join`, columns the fixtures, then the objects.
    """

    world: Array
    """`[row, column]` robot and payload against fixtures and objects."""
    own: Array
    """`[row, cover]` against the robot's own primitives `cover`; each pair stands once."""
    payload: Array
    """`[row]` 1 for the slots of the payload."""
    cover: AnyArray
    """`[cover]` rows that together belong to every pair of robot primitives that may touch."""


@pytree
class Scene(Record):
    """What changes from task to task without a new trace."""

    objects: Shapes
    """Movable objects, in the world."""
    payload: Shapes
    """The grasped object, in the tool frame; all slots are empty when nothing is held."""
    opening: Array
    """`[]` distance of each finger from its closed position [m]."""
    support_on: Array
    """`[fixture]` 0 where the payload may touch (the surface it is lifted from or put on)."""


@pytree
class Workcell(Record):
    """A robot among fixtures and movable objects. Built by `load_workcell`."""

    chain: KinematicChain
    """Joints, limits and tool frame."""
    hulls: ConvexHulls
    """Of the polytopes among its primitives; empty where there are none."""
    robot: RobotShapes
    """Primitives of links and fingers."""
    fixtures: Shapes
    """Everything welded to the world, in the world."""
    objects: Shapes
    """Movable objects, each in its own body's frame."""
    owners: AnyArray
    """`[n]` number of the object that each primitive of `objects` belongs to; -1 of empty slots."""
    pairs: ContactPairs
    """What may touch what."""
    scene: Scene
    """Objects, payload and opening of the fingers."""
    home: Array
    """`[joint]` configuration to start from [rad or m]."""
    source: Any = struct.field(pytree_node=False)
    """`workcell.source.WorkcellSource`: model, names, task data. None inside of kept programs."""

    def for_programs(self) -> "Workcell":
        """The cell without its host side: cells of one class have equal programs (`kept`)."""
        return self.replace(source=None)

    @property
    def model(self) -> mujoco.MjModel:
        """The same cell for C MuJoCo and MJX."""
        return self.source.model

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Joints in the order of `q`."""
        return self.source.joint_names

    @property
    def joint_units(self) -> tuple[str, ...]:
        """Unit of each joint's value: rad of a hinge, m of a slide."""
        return self.source.layout.joint_units

    @property
    def joint_limits(self) -> Array:
        """`[joint, 2]` lower and upper limit [rad or m]."""
        return self.chain.limits

    @property
    def velocity_limits(self) -> Array:
        """`[joint]` [rad/s or m/s]."""
        return self.chain.velocity_limits


class Status(enum.IntEnum):
    """How a plan ended. Only `OK` comes with a trajectory."""

    OK = 0
    NEED_DEMO = 1
    TASK_INFEASIBLE = 2
    NO_PATH = 3
    SEAM_FAILED = 4
    COLLISION = 5
    INVALID_TASK = 6
    START_INVALID = 7

    @property
    def sentence(self) -> str:
        """What the status means, in words."""
        return _SENTENCES[self]


_SENTENCES = {
    Status.OK: "the trajectory was found and checked",
    Status.NEED_DEMO: "no demonstrated skill is close enough to a part of the task",
    Status.TASK_INFEASIBLE: "a key pose of the task cannot be reached free of collision",
    Status.SEAM_FAILED: "the parts do not join into one continuous joint motion",
    Status.COLLISION: "the assembled trajectory failed its final check",
    Status.INVALID_TASK: "the task does not belong to this cell or holds bad numbers",
    Status.START_INVALID: "the arm cannot start where it is said to stand",
    Status.NO_PATH: "no path was found",
}


class Source(enum.IntEnum):
    """Where a way point came from."""

    LFD = 0
    """A skill."""
    DRL = 1
    """The joint agent."""
    RRT = 2
    """The sampling-based planner, in the place of a joint agent that found no path."""


@pytree
class Trajectory(Record):
    """A timed joint motion of one phase of a task (between two gripper events)."""

    times: np.ndarray
    """`[point]` from the start of the phase [s]."""
    positions: np.ndarray
    """`[point, joint]` configurations [rad or m]."""
    velocities: np.ndarray
    """`[point, joint]` [rad/s or m/s]."""
    accelerations: np.ndarray
    """`[point, joint]` [rad/s^2 or m/s^2]; zero at both ends."""
    sources: np.ndarray
    """`[point]` `Source` of each point."""
