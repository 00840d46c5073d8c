# SPDX-License-Identifier: MIT
"""Convex hulls of meshes as the kernels' polytopes. Host side, float64."""

import functools
import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import RigidTransform, Rotation

from hybrid_jax.errors import WorkcellError
from hybrid_jax.kernels.collision.support_map import SLICE, cell_corners
from hybrid_jax.types import ConvexHulls

TIE = 2e-6
"""Vertices that differ by less are as far along a direction [m]."""
MESH_TOLERANCE = 5e-4
"""How far a polytope may stand out of the convex hull of its mesh, unless the caller says [m]."""
_HULLS, _SLICES, _FACES = 4, 1024, 64
"""The tables have multiples of these sizes, so that cells share their programs."""
_SHARES = 0.4, 0.2, 0.1
"""Shares of the excess that is allowed, tried in turn while the hull has few vertices."""
_PLENTY = 800
"""Vertices from which on no smaller excess is tried: tables grow, and looks take longer."""
_AXES = np.eye(3)
_DIRECTIONS = np.random.default_rng(0).normal(size=(4000, 3))
_DIRECTIONS /= np.linalg.norm(_DIRECTIONS, axis=1, keepdims=True)
_CUBE = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))


@dataclass(frozen=True, eq=False)
class Polytope:
    """A convex hull swept by a ball, in the frame of its mesh."""

    pose: RigidTransform
    """Frame of a box around the hull."""
    half_extents: tuple[float, ...]
    """`[3]` of that box [m]; of the axis of a sphere or capsule, where it is one."""
    vertices: np.ndarray | None
    """`[n, 3]` of the hull in the box's frame [m]; None where a box swept by a ball is as good."""
    radius: float
    """Radius of the ball: how far vertices that were left out stand out of the hull [m]. Without
    vertices, that of a sphere or capsule."""


def distance_to_hull(point: np.ndarray, vertices: np.ndarray) -> float:
    """Distance of a point to the convex hull of some vertices [m].

    Args:
        point: `[3]` [m].
        vertices: `[n, 3]` [m].
    """
    # non-negative least squares; the last row, of large weight, makes the weights sum to one
    weight = 1e3 * np.ptp(vertices)
    system = np.vstack([vertices.T, np.full(len(vertices), weight)])
    weights, _ = nnls(system, np.append(point, weight), maxiter=100 * len(vertices))
    return float(np.linalg.norm(vertices.T @ weights - point))


def hull_volume_ratio(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Volume of a mesh's convex hull over its own; 1 where the mesh is open, flat or inside out.

    Args:
        vertices: `[n, 3]` [m].
        faces: `[m, 3]` numbers of vertices, counter-clockwise from outside.
    """
    starts, ends = faces.astype(np.int64).ravel(), np.roll(faces, -1, axis=1).ravel()
    there, back = starts * len(vertices) + ends, ends * len(vertices) + starts
    # without a surface that closes, each edge once in either direction, there is no volume
    if not np.array_equal(np.sort(there), np.sort(back)):
        return 1.0
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    own = float(np.einsum("nd,nd->", a, np.cross(b, c))) / 6  # the divergence theorem
    try:
        whole = ConvexHull(vertices).volume
    except QhullError:
        return 1.0
    return max(whole / own, 1.0) if own > 1e-3 * whole else 1.0


def _frame(hull: ConvexHull) -> np.ndarray:
    """Axes `[3, 3]` of the smallest box around a hull among the mesh's, the principal and those
    of its large faces."""
    points = hull.points[hull.vertices]
    frames = [np.eye(3), np.linalg.svd(points - points.mean(0), full_matrices=False)[2].T]
    corners = hull.points[hull.simplices]
    edges = corners[:, 1] - corners[:, 0]
    areas = np.linalg.norm(np.cross(edges, corners[:, 2] - corners[:, 0]), axis=1)
    for face in np.argsort(-areas)[:12]:
        normal, tangent = hull.equations[face, :3], edges[face] / np.linalg.norm(edges[face])
        frames.append(np.stack([tangent, np.cross(normal, tangent), normal], axis=1))
    frame = min(frames, key=lambda axes: np.prod(np.ptp(points @ axes, axis=0)))
    # axes of determinant -1 are no rotation; all reversed they are one
    return frame * np.sign(np.linalg.det(frame))


def _spread(points: np.ndarray) -> np.ndarray:
    """Numbers of some vertices `[n, 3]` that span a solid; of all, where the extremes do not."""
    extremes = np.concatenate([points.argmin(axis=0), points.argmax(axis=0)])
    far = np.argmax(np.linalg.norm(points[:, None] - points[extremes], axis=2).min(axis=1))
    chosen = np.unique([*extremes, far])
    spans = np.linalg.matrix_rank(points[chosen] - points[chosen].mean(axis=0), tol=1e-9) == 3
    return chosen if spans else np.arange(len(points))


def _round_solid(vertices: np.ndarray, excess: float) -> tuple[np.ndarray, float, float] | None:
    """Axis `[3]`, half length and radius [m] of a sphere or capsule that covers a hull closely.

    Args:
        vertices: `[n, 3]` of the hull, in the frame of a box around it [m].
        excess: how far it may stand out of the hull [m].

    Returns:
        None where none stands out by so little, in any of many directions.
    """
    reach = (_DIRECTIONS @ vertices.T).max(axis=1)
    radius = float(np.linalg.norm(vertices, axis=1).max())
    if (radius - reach).max() <= excess:
        return _AXES[2], 0.0, radius
    for axis in _AXES:
        along = vertices @ axis
        beside = np.linalg.norm(vertices - along[:, None] * axis, axis=1)
        radius = float(beside.max())
        half = max(float((np.abs(along) - np.sqrt(radius**2 - beside**2)).max()), 0.0)
        if (half * np.abs(_DIRECTIONS @ axis) + radius - reach).max() <= excess:
            return axis, half, radius
    return None


def _fewer(
    points: np.ndarray, excess: float, chosen: np.ndarray | None = None
) -> tuple[np.ndarray, float]:
    """Numbers of some vertices of a hull, and how far the others stand out of theirs [m].

    In each round every face of what was chosen gets the vertex that is farthest outside of it.

    Args:
        points: `[n, 3]` vertices of a hull [m].
        excess: how far they may stand out [m].
        chosen: vertices to begin with; a few if None.
    """
    chosen = _spread(points) if chosen is None else chosen
    while True:
        hull = ConvexHull(points[chosen])
        outside = points @ hull.equations[:, :3].T + hull.equations[:, 3]
        farthest, heights = outside.argmax(axis=0), outside.max(axis=0)
        added = np.setdiff1d(farthest[heights > excess], chosen)
        if not len(added):
            break
        chosen = np.append(chosen, added)
    left_out = np.flatnonzero(outside.max(axis=1) > 1e-9)
    nearest = hull.points[hull.simplices[outside[left_out].argmax(axis=1)]]
    distance = _triangle_distance(points[left_out], nearest)
    # beyond an edge another face may be nearer than the one that a point is highest above
    for i in np.flatnonzero(distance > excess):
        distance[i] = distance_to_hull(points[left_out[i]], points[chosen])
    radius = float(distance.max(initial=0.0))
    if radius > excess:
        return _fewer(points, 0.7 * excess, chosen)
    return chosen, radius


def _triangle_distance(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Distance `[n]` of points `[n, 3]`, each to its own triangle `[n, 3, 3]` [m]."""
    best = np.full(len(points), np.inf)
    for i in range(3):
        start, edge = triangles[:, i], triangles[:, (i + 1) % 3] - triangles[:, i]
        share = np.einsum("nd,nd->n", points - start, edge)
        share = np.clip(share / np.maximum(np.einsum("nd,nd->n", edge, edge), 1e-30), 0, 1)
        foot = start + share[:, None] * edge
        best = np.minimum(best, np.linalg.norm(points - foot, axis=1))
    first, second = (triangles[:, k] - triangles[:, 0] for k in (1, 2))
    normal = np.cross(first, second)
    area = np.maximum(np.einsum("nd,nd->n", normal, normal), 1e-30)
    offset = points - triangles[:, 0]
    v = np.einsum("nd,nd->n", np.cross(offset, second), normal) / area
    w = np.einsum("nd,nd->n", np.cross(first, offset), normal) / area
    height = np.abs(np.einsum("nd,nd->n", offset, normal)) / np.sqrt(area)
    return np.where((v >= 0) & (w >= 0) & (v + w <= 1), height, best)


@functools.lru_cache(maxsize=256)
def _polytope(content: bytes, excess: float) -> Polytope | None:
    """`polytope` of vertices given by the bytes of their array; None for a mesh without volume."""
    points = np.frombuffer(content).reshape(-1, 3)
    try:
        hull = ConvexHull(points)
    except QhullError:
        return None
    axes, corners = _frame(hull), hull.points[hull.vertices]
    inside = corners @ axes
    low, high = inside.min(axis=0), inside.max(axis=0)
    pose = RigidTransform.from_components(axes @ (low + high) / 2, Rotation.from_matrix(axes))
    half = tuple((high - low) / 2)
    vertices = inside - (low + high) / 2
    box = _CUBE * half
    if max(np.linalg.norm(vertices - corner, axis=1).min() for corner in box) <= excess:
        return Polytope(pose, half, None, 0.0)
    solid = _round_solid(vertices, excess)
    if solid is not None:
        axis, length, radius = solid
        turned = Rotation.from_rotvec(np.pi * (axis + _AXES[2]) / np.linalg.norm(axis + _AXES[2]))
        turned = RigidTransform.from_rotation(turned)
        return Polytope(pose * turned, (0.0, 0.0, length), None, radius)
    kept, radius = _fewer(vertices, excess - 2 * TIE)
    for share in _SHARES:
        if len(kept) > _PLENTY or share * excess < 10 * TIE:
            break
        kept, radius = _fewer(vertices, share * excess - 2 * TIE, kept)
    # along a direction between corners of a cell a tie counts a little more than along these
    return Polytope(pose, half, vertices[kept], radius + 2 * TIE)


def polytope(vertices: np.ndarray, excess: float, label: str) -> Polytope:
    """The convex hull of a mesh, without vertices that its excess can spare.

    The excess is smaller than asked for where few vertices suffice for that. What is left out lies
    within the ball that sweeps the hull: nothing of the mesh stands out.

    Args:
        vertices: `[n, 3]` [m].
        excess: how far the polytope may stand out of the hull [m].
        label: how to name the mesh in a message.

    Raises:
        WorkcellError: the mesh is flat.
    """
    found = _polytope(np.ascontiguousarray(vertices, float).tobytes(), excess)
    if found is None:
        raise WorkcellError(f"the mesh of geom {label} has no volume: give it a thickness")
    return found


def _candidates(vertices: np.ndarray) -> list[np.ndarray]:
    """Vertices that can be the farthest along a direction of each cell, `[CELLS]` arrays `[k, 3]`.

    A vertex cannot be where another one is as far, but for `TIE`, along all four corners of the
    cell: directions in it are sums of these.
    """
    corners = cell_corners()
    corners /= np.linalg.norm(corners, axis=2, keepdims=True)
    along = np.einsum("ckd,vd->cvk", corners, vertices)
    # most vertices are nowhere as far as the one that is farthest along all corners together
    best = along.sum(axis=2).argmax(axis=1)
    covered = (along[np.arange(len(along)), best][:, None] >= along - TIE).all(axis=2)
    chosen = []
    for values, flags, first in zip(along, covered, best, strict=True):
        rows = np.flatnonzero(~flags)
        rows = np.append(first, rows[np.argsort(-values[rows].sum(axis=1))])
        covers = (values[rows] >= values[rows, None] - TIE).all(axis=2)
        kept = [0]
        for place, by_whom in enumerate(covers[1:], start=1):
            if not by_whom[kept].any():
                kept.append(place)
        chosen.append(vertices[rows[kept]])
    return chosen


def _faces(vertices: np.ndarray) -> np.ndarray:
    """Outward normals and distances `[face, 4]` of the faces of a hull, each plane once [m]."""
    planes = ConvexHull(vertices).equations
    _, first = np.unique(planes.round(7), axis=0, return_index=True)
    return planes[np.sort(first)] * [1, 1, 1, -1]


def _multiple(count: int, size: int) -> int:
    return -(-count // size) * size


def hull_tables(meshes: Sequence[np.ndarray]) -> ConvexHulls:
    """Tables of the cube and of the hulls of vertices `[n, 3]` [m]; empty without any mesh."""
    if not meshes:
        return ConvexHulls(
            np.zeros((0, 3, SLICE), np.float32),
            np.zeros(0, np.int32),
            np.zeros((0, 0, 4), np.float32),
        )
    # their number too is one of few: the last one stands again for those that are missing
    missing = -(len(meshes) + 1) % _HULLS
    meshes = [*meshes, *[meshes[-1]] * missing]
    cells = [cell for vertices in (_CUBE, *meshes) for cell in _candidates(vertices)]
    sizes = [-(-len(cell) // SLICE) for cell in cells]
    first = np.cumsum([0, *sizes], dtype=np.int32)
    # a slice that is not full has its vertices several times
    full = [np.resize(cell, (size * SLICE, 3)) for cell, size in zip(cells, sizes, strict=True)]
    slices = np.concatenate(full).reshape(-1, SLICE, 3).swapaxes(1, 2)
    candidates = np.zeros((_multiple(len(slices), _SLICES), 3, SLICE), np.float32)
    candidates[: len(slices)] = slices
    planes = [_faces(vertices) for vertices in (_CUBE, *meshes)]
    faces = np.zeros((len(planes), _multiple(max(map(len, planes)), _FACES), 4), np.float32)
    faces[:, :, 3] = 1.0  # a face without a normal holds everything
    for own, slots in zip(planes, faces, strict=True):
        slots[: len(own)] = own
    return ConvexHulls(candidates, first, faces)
