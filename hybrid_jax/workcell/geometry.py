# SPDX-License-Identifier: MIT
"""Collision geoms of an `MjModel` as the kernels' primitives. Host side, float64."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.spatial.transform import RigidTransform

from hybrid_jax.errors import WorkcellError
from hybrid_jax.kernels.collision.primitive_kinds import KINDS as KINDS_OF_PRIMITIVES
from hybrid_jax.kernels.collision.primitive_kinds import kind_of, rows_as_boxes, spans
from hybrid_jax.types import Shapes
from hybrid_jax.workcell import approximation
from hybrid_jax.workcell.convex_hulls import hull_volume_ratio, polytope
from hybrid_jax.workcell.poses import as_row, matrix_pose, pose_of

_G = mujoco.mjtGeom
KINDS = SPHERE, CAPSULE, BOX, PLANE, CYLINDER, MESH, ELLIPSOID = tuple(
    int(g)
    for g in (
        _G.mjGEOM_SPHERE,
        _G.mjGEOM_CAPSULE,
        _G.mjGEOM_BOX,
        _G.mjGEOM_PLANE,
        _G.mjGEOM_CYLINDER,
        _G.mjGEOM_MESH,
        _G.mjGEOM_ELLIPSOID,
    )
)
"""Kinds of geoms that the kernels can represent."""
PIERCEABLE = CAPSULE, BOX
"""Kinds of geoms of which the first can pierce the second unseen by C MuJoCo."""
PLANE_HALF = (50.0, 50.0, 5.0)
"""Half extents of the box that stands for an infinite plane [m]: no work cell is larger."""


@dataclass(frozen=True)
class Primitive:
    """One primitive in the frame that carries it; a geom may need several."""

    geom: int
    """Number of the geom in the model."""
    pose: RigidTransform
    """Pose of its centre in the frame that carries it."""
    half_extents: tuple[float, float, float]
    """Half extents of the box [m]."""
    radius: float
    """Radius of the ball that sweeps it [m]."""
    vertices: np.ndarray | None = None
    """`[n, 3]` of a polytope in its frame [m], the frame of a box around it; else None."""

    @property
    def kind(self) -> int:
        """Number of its kind in `kernels.collision.primitive_kinds`."""
        return kind_of(self.half_extents, self.vertices is not None)


def body_label(model: mujoco.MjModel, body: int) -> str:
    """Name of a body in messages."""
    return model.body(body).name or f"#{body}"


def geom_label(model: mujoco.MjModel, geom: int) -> str:
    """Name of a geom in messages, with its body."""
    body = int(model.geom_bodyid[geom])
    return f"{model.geom(geom).name or f'#{geom}'} (of body {body_label(model, body)!r})"


def touching_geoms(model: mujoco.MjModel) -> list[int]:
    """Geoms that can touch something, by their bit masks or by a `<pair>`."""
    paired = {*model.pair_geom1.tolist(), *model.pair_geom2.tolist()}
    return [
        g
        for g in range(model.ngeom)
        if model.geom_contype[g] or model.geom_conaffinity[g] or g in paired
    ]


def collision_geoms(model: mujoco.MjModel) -> list[int]:
    """Geoms that can touch something, if the kernels can represent all of them.

    Raises:
        WorkcellError: a geom of another kind.
    """
    geoms = touching_geoms(model)
    for g in geoms:
        kind = int(model.geom_type[g])
        if kind not in KINDS:
            # `name[7:]`: without the prefix mjGEOM_
            raise WorkcellError(
                f"geom {geom_label(model, g)} is a {_G(kind).name[7:].lower()}; collision geoms "
                "must be spheres, capsules, ellipsoids, boxes, cylinders, planes or convex meshes. "
                "Approximate it with those, or set contype and conaffinity to 0 if it is only for "
                "show."
            )
    return geoms


def pierces(model: mujoco.MjModel, data: mujoco.MjData, capsule: int, box: int) -> bool:
    """Does the axis of a capsule run through a box, at the configuration of `data`?

    It is the slab test of a segment: the parts of the axis between the three pairs of faces
    must have a point in common.
    """
    rotation = data.geom_xmat[box].reshape(3, 3)
    centre = rotation.T @ (data.geom_xpos[capsule] - data.geom_xpos[box])
    axis = rotation.T @ data.geom_xmat[capsule].reshape(3, 3)[:, 2] * model.geom_size[capsule, 1]
    low, high = -1.0, 1.0
    for offset, direction, half in zip(centre, axis, model.geom_size[box], strict=True):
        if abs(direction) < 1e-12:  # parallel to the faces: between them all along, or nowhere
            if abs(offset) >= half:
                return False
            continue
        enter, leave = sorted(((-half - offset) / direction, (half - offset) / direction))
        low, high = max(low, enter), min(high, leave)
    return low < high


def _has_meshes(model) -> bool:
    """Are there meshes among what can touch something?"""
    return any(model.geom_type[g] == MESH for g in touching_geoms(model))


def _local(model, geom: int, tolerance: float) -> list[tuple]:
    """Primitives of a geom in its own frame: pose, half extents `[3]` [m], radius [m], vertices."""
    kind, size = int(model.geom_type[geom]), model.geom_size[geom]
    identity = pose_of([0, 0, 0], [1, 0, 0, 0])
    if kind == SPHERE:
        return [(identity, (0.0, 0.0, 0.0), size[0])]
    if kind == CAPSULE:
        return [(identity, (0.0, 0.0, size[1]), size[0])]
    if kind == BOX:
        return [(identity, tuple(size), 0.0)]
    if kind == PLANE:
        return [(pose_of([0, 0, -PLANE_HALF[2]], [1, 0, 0, 0]), PLANE_HALF, 0.0)]
    if kind == CYLINDER and _has_meshes(model):
        # a cell of meshes has the programs for polytopes already: one is closer than many boxes
        corners = approximation.prism(float(size[0]), float(size[1]))
        return [(identity, (size[0], size[0], size[1]), 0.0, corners)]
    if kind == CYLINDER:
        return approximation.cylinder(size[0], size[1])
    if kind == ELLIPSOID:
        return approximation.ellipsoid(size)
    hull = polytope(_mesh_vertices(model, geom), tolerance, geom_label(model, geom))
    return [(hull.pose, hull.half_extents, hull.radius, hull.vertices)]


def _mesh_vertices(model, geom: int) -> np.ndarray:
    """`[n, 3]` vertices of a mesh geom in the geom's frame [m]."""
    mesh = int(model.geom_dataid[geom])
    first = int(model.mesh_vertadr[mesh])
    return model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])].astype(float)


def hull_ratio(model: mujoco.MjModel, geom: int) -> float:
    """Volume of the hull that a geom counts as over its mesh's; 1 where it is no closed mesh."""
    if model.geom_type[geom] != MESH:
        return 1.0
    mesh = int(model.geom_dataid[geom])
    first, count = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    return hull_volume_ratio(_mesh_vertices(model, geom), model.mesh_face[first : first + count])


def primitives(model, data, geom: int, frame: RigidTransform, tolerance: float) -> list[Primitive]:
    """Primitives of a geom, expressed in `frame` at the configuration of `data`.

    Args:
        model, data: the cell in C MuJoCo, its kinematics up to date.
        geom: number of the geom.
        frame: pose in the world of the frame that carries the geom.
        tolerance: how far the polytope of a mesh may stand out of its convex hull [m].
    """
    geom_pose = frame.inv() * matrix_pose(data.geom_xpos[geom], data.geom_xmat[geom])
    return [
        Primitive(geom, geom_pose * pose, tuple(float(h) for h in half), float(radius), *vertices)
        for pose, half, radius, *vertices in _local(model, geom, tolerance)
    ]


def in_order(items: list[Primitive]) -> list[Primitive]:
    """The same primitives in the order of the kernels, kind by kind."""
    return sorted(items, key=lambda p: p.kind)


def counts_of(items: list[Primitive]) -> tuple[int, ...]:
    """How many primitives there are of each kind."""
    return tuple(sum(p.kind == kind for p in items) for kind in range(len(KINDS_OF_PRIMITIVES)))


def hulls_of(items: list[Primitive]) -> list[np.ndarray]:
    """Vertices `[n, 3]` of the polytopes among some primitives, each hull once [m]."""
    return list({id(p.vertices): p.vertices for p in items if p.vertices is not None}.values())


def to_shapes(
    items: list[Primitive], slots: tuple[int, ...] = (), hulls: Sequence[np.ndarray] = ()
) -> Shapes:
    """Primitives as arrays `[n, ...]`, kind by kind, padded with empty slots.

    Args:
        items: the primitives, in any order.
        slots: least number of primitives of each kind; none if empty.
        hulls: `hulls_of` all primitives of the cell.
    """
    counts = counts_of(items)
    slots = tuple(map(max, counts, slots or counts))
    pose, half = np.zeros((sum(slots), 7)), np.zeros((sum(slots), 3))
    radius, active = np.zeros(sum(slots)), np.zeros(sum(slots))
    hull = np.zeros(sum(slots), np.int32)
    # the first of the tables is the cube
    number = {id(vertices): i for i, vertices in enumerate(hulls, start=1)}
    pose[:, 3] = 1.0  # empty slots are not rotated: the quaternion's w comes first
    half[rows_as_boxes(slots)] = 1e-3
    for kind, span in enumerate(spans(slots)):
        for i, p in enumerate((p for p in items if p.kind == kind), start=span.start):
            pose[i], half[i], radius[i], active[i] = as_row(p.pose), p.half_extents, p.radius, 1.0
            hull[i] = number.get(id(p.vertices), 0)
    pose, half, radius, active = (np.asarray(a, np.float32) for a in (pose, half, radius, active))
    # a row that is read as a box is no ball, be it an empty slot
    balls = not rows_as_boxes(slots) and not any(any(p.half_extents) for p in items)
    return Shapes(pose, half, radius, hull, active, counts=slots, all_spheres=balls)
