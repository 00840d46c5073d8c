# SPDX-License-Identifier: MIT
"""Solids that the kernels do not know, as unions of boxes and capsules that contain them.

Never smaller than the solid, and larger by no more than is stated: a plan that is free of
collision stays so for the solid itself.
"""

import itertools

import numpy as np
from scipy.optimize import nnls
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import RigidTransform, Rotation

from hybrid_jax.errors import WorkcellError

CYLINDER_TOLERANCE = 1e-3
"""How far the boxes of a cylinder may stand out of it [m], as far as `CYLINDER_BOXES` suffice."""
CYLINDER_BOXES = 12
"""At most so many: they stand out by 0.9 % of the radius then."""
MESH_PIECES = 16
"""At most so many boxes for one convex mesh."""


def cylinder_excess(radius: float, boxes: int) -> float:
    """How far that many boxes stand out of a cylinder [m]."""
    return radius * (1 / np.cos(np.pi / (2 * boxes)) - 1)


def cylinder(radius: float, half_length: float) -> list[tuple]:
    """Boxes whose union is the prism of a regular polygon around the cylinder.

    The polygon has two edges for each box: opposite edges bound one rectangle, and each triangle
    from the centre to an edge lies in the rectangle of that edge.
    """
    boxes = 2
    while boxes < CYLINDER_BOXES and cylinder_excess(radius, boxes) > CYLINDER_TOLERANCE:
        boxes += 1
    half = (radius, radius * np.tan(np.pi / (2 * boxes)), half_length)
    turns = [Rotation.from_euler("z", np.pi * k / boxes) for k in range(boxes)]
    return [(RigidTransform.from_rotation(turn), half, 0.0) for turn in turns]


def ellipsoid(half: np.ndarray) -> list[tuple]:
    """The box that its shortest half axis, as a ball, sweeps into a solid around the ellipsoid.

    Exact for a sphere, a capsule around a ball that is stretched along one axis.
    """
    radius = float(np.min(half))
    identity = RigidTransform.identity()
    return [(identity, tuple(float(h) - radius for h in half), radius)]


def ellipsoid_excess(half: np.ndarray, samples: int = 4000) -> float:
    """How far that solid stands out of the ellipsoid, by samples of its surface [m]."""
    radius, rng = float(np.min(half)), np.random.default_rng(0)
    outwards = rng.normal(size=(samples, 3))
    outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
    corner = np.sign(outwards) * (np.asarray(half) - radius)
    surface = corner + radius * outwards
    # the point of an ellipsoid below a point outside: one multiplier, found by bisection
    low, high = np.zeros(samples), np.full(samples, float(np.max(half)) ** 2 * 10)
    squared = np.asarray(half, float) ** 2
    for _ in range(60):
        middle = (low + high) / 2
        inside = np.sum(squared * (surface / (squared + middle[:, None])) ** 2, axis=1) < 1
        low, high = np.where(inside, low, middle), np.where(inside, middle, high)
    below = squared * surface / (squared + low[:, None])
    return float(np.linalg.norm(surface - below, axis=1).max())


def distance_to_hull(point: np.ndarray, vertices: np.ndarray) -> float:
    """Distance of a point and the convex hull of some vertices [m]."""
    weight = 1e3 * np.ptp(vertices)  # the weights of the vertices sum to one
    system = np.vstack([vertices.T, np.full(len(vertices), weight)])
    weights, _ = nnls(system, np.append(point, weight), maxiter=100 * len(vertices))
    return float(np.linalg.norm(vertices.T @ weights - point))


def _frames(hull: ConvexHull) -> list[np.ndarray]:
    """Candidate axes for boxes around a hull: its principal axes, and those of its large faces."""
    points = hull.points[hull.vertices]
    frames = [np.eye(3), np.linalg.svd(points - points.mean(0), full_matrices=False)[2].T]
    corners = hull.points[hull.simplices]
    edges = corners[:, 1] - corners[:, 0]
    areas = np.linalg.norm(np.cross(edges, corners[:, 2] - corners[:, 0]), axis=1)
    for face in np.argsort(-areas)[:12]:
        normal, along = hull.equations[face, :3], edges[face] / np.linalg.norm(edges[face])
        frames.append(np.stack([along, np.cross(normal, along), normal], axis=1))
    return [f * np.sign(np.linalg.det(f)) for f in frames]


def _slab(points: np.ndarray, hull: ConvexHull, axis: int, low: float, high: float) -> np.ndarray:
    """Vertices of the part of a hull between two planes across an axis."""
    inside = points[(points[:, axis] >= low) & (points[:, axis] <= high)]
    found = [inside]
    for a, b in itertools.combinations(range(3), 2):
        start, end = points[hull.simplices[:, a]], points[hull.simplices[:, b]]
        run = end[:, axis] - start[:, axis]
        for cut in (low, high):
            crossing = (start[:, axis] - cut) * (end[:, axis] - cut) < 0
            t = (cut - start[crossing, axis]) / run[crossing]
            found.append(start[crossing] + t[:, None] * (end[crossing] - start[crossing]))
    return np.concatenate(found)


def _boxes(points: np.ndarray, hull: ConvexHull, axis: int, count: int) -> list[np.ndarray]:
    """Bounds `[2, 3]` of the slabs of a hull, cut across an axis."""
    cuts = np.linspace(points[:, axis].min(), points[:, axis].max(), count + 1)
    slabs = [_slab(points, hull, axis, *c) for c in itertools.pairwise(cuts)]
    return [np.stack([s.min(0), s.max(0)]) for s in slabs if len(s)]


def _excess(bounds: np.ndarray, points: np.ndarray) -> float:
    """Largest distance of a box and a hull: distance is convex, so a corner has it."""
    corners = np.array(list(itertools.product(*bounds.T)))
    return max(distance_to_hull(c, points) for c in corners)


def convex_mesh(vertices: np.ndarray, tolerance: float, label: str) -> list[tuple]:
    """Boxes around the convex hull of a mesh, cut into slabs where one box is too coarse.

    Args:
        vertices: `[n, 3]` [m].
        tolerance: how far they may stand out of the hull [m].
        label: how to name the mesh in a message.

    Raises:
        WorkcellError: the mesh is flat, or no more than `MESH_PIECES` boxes keep the tolerance.
    """
    try:
        hull = ConvexHull(vertices)
    except QhullError:
        raise WorkcellError(
            f"the mesh of geom {label} has no volume: give it a thickness"
        ) from None
    outer = vertices[hull.vertices]
    frames = sorted(_frames(hull), key=lambda f: np.prod(np.ptp(outer @ f, axis=0)))
    best = np.inf
    for count in (1, 2, 3, 4, 6, 8, 12, MESH_PIECES):
        for frame, axis in itertools.product(frames[:3], range(1 if count == 1 else 3)):
            turned = vertices @ frame
            boxes = _boxes(turned, hull, axis, count)
            excess = max(_excess(b, outer @ frame) for b in boxes)
            best = min(best, excess)
            if excess <= tolerance:
                rotation = Rotation.from_matrix(frame)
                return [
                    (RigidTransform.from_components(frame @ b.mean(0), rotation),
                     tuple(np.ptp(b, axis=0) / 2), 0.0)
                    for b in boxes
                ]  # fmt: skip
    raise WorkcellError(
        f"the mesh of geom {label} stands {1e3 * best:.1f} mm within its {MESH_PIECES} best boxes "
        f"({1e3 * tolerance:.1f} mm are allowed): replace it by primitives or convex pieces, or "
        "allow more with mesh_tolerance"
    )
