# SPDX-License-Identifier: MIT
"""A cell's collision primitives as a MuJoCo model of the arm alone, for MJX to test.

The cell's own model has every body and every pair that may touch. This one has the primitives that
the kernels have too (`types.Workcell`), the pairs that a motion must keep apart, and no free body:
what moves from scene to scene is a number in it, so that one program serves all scenes.
"""

import functools
from typing import NamedTuple

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from hybrid_jax.errors import WorkcellError
from hybrid_jax.kernels.collision.primitive_kinds import joined_order, rows_as_boxes
from hybrid_jax.types import Shapes, Workcell
from hybrid_jax.workcell.source import WorkcellSource

TILE = 0.3
"""Largest edge of a fixture's box [m]. MJX sorts pairs out by bounding spheres, and that of a wall
holds the whole cell; of its tiles few are near. Together they are the same box."""
NOWHERE = np.array([0.0, 0, 0, 1, 0, 0, 0])
"""Pose `[7]` of a slot before a scene says what is in it."""
PAIRS_PER_PRIMITIVE = 5
"""Pairs of each kind of geoms that MJX looks at closely, for each primitive of the robot: so
many that a gripper in a tray seldom has more pairs with overlapping bounding spheres."""


class CollisionModel(NamedTuple):
    """A model, and which primitive each of its geoms is."""

    model: mujoco.MjModel
    robot: np.ndarray
    """`[geom]` number in `RobotShapes`, -1 for others."""
    payload: np.ndarray
    """`[geom]` number in `Scene.payload`, -1 for others."""
    fixture: np.ndarray
    """`[geom]` number in `Workcell.fixtures`, -1 for others."""
    object: np.ndarray
    """`[geom]` number in `Scene.objects`, -1 for others."""


def _arm(spec: mujoco.MjSpec, cell: Workcell) -> list:
    """Add the arm's links and the tool to a spec; returns their bodies."""
    chain = cell.chain
    first = spec.worldbody.add_body(name="base", pos=chain.base[:3], quat=chain.base[3:])
    bodies, body = [], first
    for number, offset in enumerate(chain.offset):
        body = body.add_body(name=f"link_{number}", pos=offset[:3], quat=offset[3:])
        body.mass, body.inertia, body.explicitinertial = 1.0, np.ones(3), True
        kind = mujoco.mjtJoint.mjJNT_HINGE if chain.hinge[number] else mujoco.mjtJoint.mjJNT_SLIDE
        joint = body.add_joint(name=f"joint_{number}", type=kind, axis=chain.axis[number])
        joint.ref = float(chain.reference[number])
        bodies.append(body)
    tool = body.add_body(name="tool", pos=chain.tool[:3], quat=chain.tool[3:])
    return [*bodies, tool]


def _size(half_extents: np.ndarray, radius: float) -> tuple[mujoco.mjtGeom, list[float]]:
    """Type and size of the geom that a primitive with half extents `[3]` and a radius is [m]."""
    if half_extents[0] or half_extents[1]:
        return mujoco.mjtGeom.mjGEOM_BOX, list(half_extents + radius)
    if half_extents[2]:
        return mujoco.mjtGeom.mjGEOM_CAPSULE, [radius, half_extents[2], 0.0]
    return mujoco.mjtGeom.mjGEOM_SPHERE, [radius, 0.0, 0.0]


def tiles(pose: np.ndarray, half_extents: np.ndarray, edge: float = TILE) -> list[tuple]:
    """Boxes that together are one box.

    Args:
        pose: `[7]` centre [m], quaternion.
        half_extents: `[3]` [m].
        edge: largest edge of a tile [m].

    Returns:
        Pose `[7]` and half extents `[3]` of each [m].
    """
    counts = np.maximum(1, np.ceil(2 * half_extents / edge - 1e-6)).astype(int)
    rotation, half = Rotation.from_quat(pose[3:], scalar_first=True), half_extents / counts
    centres = [(2 * np.array(k) + 1) * half - half_extents for k in np.ndindex(*counts)]
    return [(np.concatenate([pose[:3] + rotation.apply(c), pose[3:]]), half) for c in centres]


def _add(body, name: str, pose, half_extents, radius: float, slot: bool = False) -> None:
    """Add a primitive to a body, under a name that tells what it is. It touches by pairs alone.

    In a `slot` another primitive of the same kind may stand: a capsule, also without length.
    """
    kind, size = _size(half_extents, radius)
    if slot and kind != mujoco.mjtGeom.mjGEOM_BOX:
        kind, size = mujoco.mjtGeom.mjGEOM_CAPSULE, [max(radius, 1e-3), 1e-3, 0.0]
    geom = body.add_geom(name=name, type=kind, size=size, pos=pose[:3], quat=pose[3:])
    geom.contype = geom.conaffinity = 0


def _slots(body, name: str, shapes: Shapes, used) -> None:
    """Add primitives whose pose and size a scene tells."""
    boxes = rows_as_boxes(shapes.counts)
    for number in np.flatnonzero(used):
        half_extents = np.full(3, 1e-3) if number in boxes else np.array([0, 0, 1e-3])
        _add(body, f"{name} {number} 0", NOWHERE, half_extents, 1e-3, slot=True)


def _refuse_hulls(source: WorkcellSource, hulls: int) -> None:
    if hulls:
        raise WorkcellError(
            f"the cell {source.name!r} has {hulls} convex hulls of meshes, and MJX tests hulls of "
            f"a few vertices only: choose the backend 'fused'"
        )


@functools.lru_cache(maxsize=4)
def collision_model(source: WorkcellSource) -> CollisionModel:
    """The collision model of a cell, whatever its scene.

    Args:
        source: of the cell.

    Raises:
        WorkcellError: the cell has convex hulls of meshes.
    """
    cell = source.arrays
    _refuse_hulls(source, len(cell.hulls.faces))
    spec = mujoco.MjSpec()
    bodies, shapes, world = _arm(spec, cell), cell.robot.shapes, spec.worldbody
    for number in np.flatnonzero(shapes.active):
        _add(
            bodies[cell.robot.link[number]],
            f"robot {number} 0",
            shapes.pose[number],
            shapes.half_extents[number],
            float(shapes.radius[number]),
        )
    payload = cell.scene.payload
    _slots(bodies[-1], "payload", payload, np.ones(payload.count, bool))
    fixtures = cell.fixtures
    for number in np.flatnonzero(fixtures.active):
        parts = tiles(fixtures.pose[number], fixtures.half_extents[number])
        for tile, (pose, half) in enumerate(parts):
            radius = float(fixtures.radius[number])
            _add(world, f"fixture {number} {tile}", pose, half, radius)
    _slots(world, "object", cell.objects, np.array(source.owners) >= 0)
    _add_pairs(spec, cell)
    rows = int(shapes.used) + payload.count
    spec.add_numeric(name="max_geom_pairs", data=[PAIRS_PER_PRIMITIVE * rows])
    model = spec.compile()
    return CollisionModel(model, *(_numbers(model, kind) for kind in CollisionModel._fields[1:]))


def _numbers(model: mujoco.MjModel, kind: str) -> np.ndarray:
    """`[geom]` number of the primitive of a kind that each geom is, -1 for others."""
    labels = [model.geom(g).name.split() for g in range(model.ngeom)]
    return np.array([int(number) if label == kind else -1 for label, number, _ in labels], int)


def _add_pairs(spec: mujoco.MjSpec, cell: Workcell) -> None:
    """Add the pairs of geoms that must be kept apart, see `types.ContactPairs`."""
    names = {}
    for body in spec.bodies:
        for geom in body.geoms:
            label, number, _ = geom.name.split()
            names.setdefault((label, int(number)), []).append(geom.name)
    shapes, payload = cell.robot.shapes, cell.scene.payload
    kinds = [("robot", i) for i in range(shapes.count)]
    kinds += [("payload", i) for i in range(payload.count)]
    rows = [kinds[i] for i in joined_order(shapes.counts, payload.counts)]
    columns = [("fixture", i) for i in range(cell.fixtures.count)]
    columns += [("object", i) for i in range(cell.objects.count)]
    pairs = [(rows[i], columns[j]) for i, j in np.argwhere(cell.pairs.world)]
    pairs += [(rows[i], rows[cell.pairs.cover[j]]) for i, j in np.argwhere(cell.pairs.own)]
    for first, second in pairs:
        for a in names.get(first, ()):
            for b in names.get(second, ()):
                spec.add_pair(geomname1=a, geomname2=b, condim=1)
