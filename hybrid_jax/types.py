# SPDX-License-Identifier: MIT
"""The nouns of the library: every record that passes from one stage to the next.

Units are metres, radians, seconds, kilograms. Quaternions are `(w, x, y, z)`. A pose is a unit
dual quaternion `[8]` (see `kernels.dualquat`). Records hold one configuration; `jax.vmap` batches.
"""

import enum
from typing import TypeVar, dataclass_transform, no_type_check

import mujoco
import numpy as np
from flax import struct
from jax import Array

T = TypeVar("T")


@dataclass_transform(frozen_default=True, field_specifiers=(struct.field,))
def pytree(cls: type[T]) -> type[T]:
    """Frozen dataclass, registered with JAX.

    Field annotations are for readers: JAX also rebuilds these classes around axis numbers,
    `None` and shape structs, so runtime type checkers must leave fields alone.
    """
    return no_type_check(struct.dataclass(cls))


@pytree
class KinematicChain:
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
class Shapes:
    """Collision primitives in one frame. A sphere is a capsule of length zero.

    `capsule_on` and `box_on` are 0 for a slot that is empty: it is at distance infinity.
    """

    capsule_ends: Array
    """`[capsule, 2, 3]` end points of the axis [m]."""
    capsule_radius: Array
    """`[capsule]` [m]."""
    capsule_on: Array
    """`[capsule]` 1 or 0."""
    box_pose: Array
    """`[box, 7]` centre [m], quaternion."""
    box_half: Array
    """`[box, 3]` half extents [m]."""
    box_on: Array
    """`[box]` 1 or 0."""


@pytree
class RobotShapes:
    """Primitives that move with the arm: links, fingers, then the payload's slots."""

    shapes: Shapes
    """In the frame of the link that carries each."""
    capsule_stroke: Array
    """`[capsule, 3]` displacement per metre of gripper opening (fingers; else 0)."""
    box_stroke: Array
    """`[box, 3]` the same for boxes."""
    capsule_link: tuple[int, ...] = struct.field(pytree_node=False)
    """Joint whose frame carries each capsule."""
    box_link: tuple[int, ...] = struct.field(pytree_node=False)
    """The same for boxes."""
    payload_capsules: int = struct.field(pytree_node=False)
    """How many slots at the end of the capsules belong to the payload."""
    payload_boxes: int = struct.field(pytree_node=False)
    """The same for boxes."""


@pytree
class ContactPairs:
    """Which primitives may touch which. Masks are 1 where a pair counts."""

    capsule_capsule: Array
    """`[robot capsule, world capsule]`; world = fixtures, then objects."""
    capsule_box: Array
    """`[robot capsule, world box]`."""
    capsule_plane: Array
    """`[robot capsule, plane]`."""
    box_capsule: Array
    """`[robot box, world capsule]`."""
    box_box: Array
    """`[robot box, world box]`."""
    box_plane: Array
    """`[robot box, plane]`."""
    self_capsules: tuple[tuple[int, int], ...] = struct.field(pytree_node=False)
    """Pairs of robot capsules that may collide."""
    self_boxes: tuple[tuple[int, int], ...] = struct.field(pytree_node=False)
    """Pairs (robot box, robot capsule)."""
    self_box_boxes: tuple[tuple[int, int], ...] = struct.field(pytree_node=False)
    """Pairs of robot boxes."""


@pytree
class Scene:
    """What changes from task to task without a new trace."""

    objects: Shapes
    """Movable objects, in the world."""
    payload: Shapes
    """The grasped object, in the tool frame; all slots off when nothing is held."""
    opening: Array
    """Distance of each finger from the closed position [m]."""
    payload_support_on: Array
    """`[world box]` 0 where the payload may touch (the surface it is lifted from or put on)."""


@pytree
class Workcell:
    """A robot among fixtures and movable objects. Built by `load_workcell`."""

    chain: KinematicChain
    robot: RobotShapes
    fixtures: Shapes
    """Everything welded to the world, in the world."""
    planes: Array
    """`[plane, 4]` unit normal and offset: a point p is in front where n.p > offset."""
    objects: Shapes
    """Movable objects, each in its own body's frame."""
    pairs: ContactPairs
    scene: Scene
    home: Array
    """`[joint]` configuration to start from."""
    source: "WorkcellSource" = struct.field(pytree_node=False)
    """The host side of the cell: model, names, task data."""

    @property
    def model(self) -> mujoco.MjModel:
        """The same cell for C MuJoCo and MJX."""
        return self.source.model

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Joints in the order of `q`."""
        return self.source.joint_names

    @property
    def joint_limits(self) -> Array:
        """`[joint, 2]` lower and upper limit [rad]."""
        return self.chain.limits

    @property
    def velocity_limits(self) -> Array:
        """`[joint]` [rad/s]."""
        return self.chain.velocity_limits


class WorkcellSource:
    """Host-side half of a cell. Two loads of one file are equal, so they share compiled code."""

    def __init__(self, *, name, digest, model, layout, task, owners, fixture_bodies):
        self.name: str = name
        self.digest: str = digest
        """Hash of everything the model was compiled from: it identifies the cell in files."""
        self.model: mujoco.MjModel = model
        self.layout = layout
        """`workcell.layout.Layout`: where joints, geoms and objects stand in the model."""
        self.task = task
        """`workcell.description.Handling` or None: objects, grasps and trays."""
        self.owners: tuple[tuple[int, ...], tuple[int, ...]] = owners
        """Object of each capsule and of each box of `Workcell.objects`."""
        self.fixture_bodies: tuple[str, ...] = fixture_bodies
        """Body of each box of `Workcell.fixtures`."""

    @property
    def joint_names(self) -> tuple[str, ...]:
        return self.layout.joint_names

    def __eq__(self, other):
        return isinstance(other, WorkcellSource) and self.digest == other.digest

    def __hash__(self):
        return hash(self.digest)

    def __repr__(self):
        return f"WorkcellSource({self.name!r}, {self.digest[:12]})"


class Status(enum.IntEnum):
    """How a plan ended. Only `OK` comes with a trajectory."""

    OK = 0
    NEED_DEMO = 1
    TASK_INFEASIBLE = 2
    DRL_TIMEOUT = 3
    SEAM_FAILED = 4
    COLLISION = 5

    @property
    def sentence(self) -> str:
        return _SENTENCES[self]


_SENTENCES = {
    Status.OK: "the trajectory was found and checked",
    Status.NEED_DEMO: "no demonstrated skill is close enough to a part of the task",
    Status.TASK_INFEASIBLE: "a key pose of the task cannot be reached free of collision",
    Status.DRL_TIMEOUT: "the joint-space agent did not find a way around the infeasible part",
    Status.SEAM_FAILED: "the parts do not join into one continuous joint motion",
    Status.COLLISION: "the assembled trajectory failed its final check",
}


@pytree
class Trajectory:
    """A timed joint motion of one phase of a task (between two gripper events)."""

    times: np.ndarray
    """`[point]` from the start of the phase [s]."""
    positions: np.ndarray
    """`[point, joint]` [rad]."""
    velocities: np.ndarray
    """`[point, joint]` [rad/s]."""
    accelerations: np.ndarray
    """`[point, joint]` [rad/s^2]."""
    sources: np.ndarray
    """`[point]` 0 where the point came from a skill (LfD), 1 from the joint agent (DRL)."""
