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
"""How far the boxes of a cylinder may stand out of it [m], unless that takes too many boxes."""
CYLINDER_BOXES = 12
"""Most boxes for one cylinder: they stand out by 0.9 % of the radius then."""
MESH_PIECES = 16
"""Most boxes for one convex mesh."""


def cylinder_excess(radius: float, boxes: int) -> float:
    """How far a given number of boxes stand out of a cylinder [m], at the polygon's corners."""
    return radius * (1 / np.cos(np.pi / (2 * boxes)) - 1)


def cylinder(radius: float, half_length: float) -> list[tuple]:
    """Boxes whose union is the prism of a regular polygon around the cylinder.

    The polygon has two edges for each box: opposite edges bound one rectangle, and each triangle
    from the centre to an edge lies in the rectangle of that edge.

    Args:
        radius: of the cylinder [m].
        half_length: along its axis z [m].

    Returns:
        (pose in the cylinder's frame, half extents `[3]` [m], radius 0 [m]) of each box.
    """
    boxes = 2
    while boxes < CYLINDER_BOXES and cylinder_excess(radius, boxes) > CYLINDER_TOLERANCE:
        boxes += 1
    half = (radius, radius * np.tan(np.pi / (2 * boxes)), half_length)
    rotations = [Rotation.from_euler("z", np.pi * k / boxes) for k in range(boxes)]
    return [(RigidTransform.from_rotation(rotation), half, 0.0) for rotation in rotations]


def ellipsoid(half: np.ndarray) -> list[tuple]:
    """A box swept by a ball around an ellipsoid: the ball's radius is the shortest half axis.

    Exact for a sphere. With one long half axis it is a capsule.

    Args:
        half: `[3]` half axes [m].

    Returns:
        One (pose in the ellipsoid's frame, half extents `[3]` [m], radius [m]).
    """
    radius = float(np.min(half))
    identity = RigidTransform.identity()
    return [(identity, tuple(float(h) - radius for h in half), radius)]


def ellipsoid_excess(half: np.ndarray, samples: int = 4000) -> float:
    """How far the solid of `ellipsoid` stands out of the ellipsoid [m].

    Args:
        half: `[3]` half axes [m].
        samples: points of the solid's surface at which the distance is measured.
    """
    radius, rng = float(np.min(half)), np.random.default_rng(0)
    directions = rng.normal(size=(samples, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    corner = np.sign(directions) * (np.asarray(half) - radius)
    surface = corner + radius * directions
    # nearest point of the ellipsoid: squared * p / (squared + t) of a point p, t by bisection
    low, high = np.zeros(samples), np.full(samples, float(np.max(half)) ** 2 * 10)
    squared = np.asarray(half, float) ** 2
    for _ in range(60):
        middle = (low + high) / 2
        foot_inside = np.sum(squared * (surface / (squared + middle[:, None])) ** 2, axis=1) < 1
        low, high = np.where(foot_inside, low, middle), np.where(foot_inside, middle, high)
    feet = squared * surface / (squared + low[:, None])
    return float(np.linalg.norm(surface - feet, axis=1).max())


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


def _frames(hull: ConvexHull) -> list[np.ndarray]:
    """Frames for boxes around a hull: the mesh's own, its principal axes, and its large faces."""
    points = hull.points[hull.vertices]
    frames = [np.eye(3), np.linalg.svd(points - points.mean(0), full_matrices=False)[2].T]
    corners = hull.points[hull.simplices]
    edges = corners[:, 1] - corners[:, 0]
    areas = np.linalg.norm(np.cross(edges, corners[:, 2] - corners[:, 0]), axis=1)
    for face in np.argsort(-areas)[:12]:
        normal, tangent = hull.equations[face, :3], edges[face] / np.linalg.norm(edges[face])
        frames.append(np.stack([tangent, np.cross(normal, tangent), normal], axis=1))
    # a frame of determinant -1 is no rotation; with all axes reversed it is one
    return [f * np.sign(np.linalg.det(f)) for f in frames]


def _slab(points: np.ndarray, hull: ConvexHull, axis: int, low: float, high: float) -> np.ndarray:
    """Vertices `[n, 3]` of the part of a hull between two planes across an axis.

    They are the hull's points between the planes, and the points where its edges cross a plane.
    """
    between = points[(points[:, axis] >= low) & (points[:, axis] <= high)]
    vertices = [between]
    for a, b in itertools.combinations(range(3), 2):
        start, end = points[hull.simplices[:, a]], points[hull.simplices[:, b]]
        run = end[:, axis] - start[:, axis]
        for cut in (low, high):
            crossing = (start[:, axis] - cut) * (end[:, axis] - cut) < 0
            t = (cut - start[crossing, axis]) / run[crossing]
            vertices.append(start[crossing] + t[:, None] * (end[crossing] - start[crossing]))
    return np.concatenate(vertices)


def _boxes(points: np.ndarray, hull: ConvexHull, axis: int, count: int) -> list[np.ndarray]:
    """Bounds `[2, 3]` of the slabs of a hull, cut across an axis."""
    cuts = np.linspace(points[:, axis].min(), points[:, axis].max(), count + 1)
    slabs = [_slab(points, hull, axis, *c) for c in itertools.pairwise(cuts)]
    return [np.stack([s.min(0), s.max(0)]) for s in slabs if len(s)]


def _excess(bounds: np.ndarray, points: np.ndarray) -> float:
    """How far a box stands out of a hull [m]: distance is convex, so a corner is farthest."""
    corners = np.array(list(itertools.product(*bounds.T)))
    return max(distance_to_hull(c, points) for c in corners)


def convex_mesh(vertices: np.ndarray, tolerance: float, label: str) -> list[tuple]:
    """Boxes around the convex hull of a mesh, cut into slabs where one box is too coarse.

    Args:
        vertices: `[n, 3]` [m].
        tolerance: how far the boxes may stand out of the hull [m].
        label: how to name the mesh in a message.

    Returns:
        (pose in the mesh's frame, half extents `[3]` [m], radius 0 [m]) of each box.

    Raises:
        WorkcellError: the mesh is flat, or even `MESH_PIECES` boxes exceed the tolerance.
    """
    try:
        hull = ConvexHull(vertices)
    except QhullError:
        raise WorkcellError(
            f"the mesh of geom {label} has no volume: give it a thickness"
        ) from None
    hull_points = vertices[hull.vertices]
    frames = sorted(_frames(hull), key=lambda f: np.prod(np.ptp(hull_points @ f, axis=0)))
    least_excess = np.inf
    for count in (1, 2, 3, 4, 6, 8, 12, MESH_PIECES):
        for frame, axis in itertools.product(frames[:3], range(1 if count == 1 else 3)):
            rotated = vertices @ frame
            boxes = _boxes(rotated, hull, axis, count)
            excess = max(_excess(b, hull_points @ frame) for b in boxes)
            least_excess = min(least_excess, excess)
            if excess <= tolerance:
                rotation = Rotation.from_matrix(frame)
                return [
                    (
                        RigidTransform.from_components(frame @ b.mean(0), rotation),
                        tuple(np.ptp(b, axis=0) / 2),
                        0.0,
                    )
                    for b in boxes
                ]
    raise WorkcellError(
        f"the mesh of geom {label} stands {1e3 * least_excess:.1f} mm within its {MESH_PIECES} "
        f"best boxes ({1e3 * tolerance:.1f} mm are allowed): replace it by primitives or convex "
        "pieces, or allow more with mesh_tolerance"
    )
