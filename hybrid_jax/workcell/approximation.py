# SPDX-License-Identifier: MIT
"""Round solids that the kernels do not know, as unions of boxes that contain them.

Never smaller than the solid, and larger by no more than is stated: a plan that is free of
collision stays so for the solid itself.
"""

import functools

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

CYLINDER_TOLERANCE = 1e-3
"""How far the boxes of a cylinder may stand out of it [m], unless that takes too many boxes."""
CYLINDER_BOXES = 12
"""Most boxes for one cylinder: they stand out by 0.9 % of the radius then."""
PRISM_EDGES = 48
"""Edges of the polygon of a prism, a multiple of four: it stands out by 0.2 % of the radius. Of a
round end seen along its axis, four cells of the support map share the corners: 12 are one slice."""


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


@functools.lru_cache(maxsize=256)
def prism(radius: float, half_length: float) -> np.ndarray:
    """Corners `[2 * PRISM_EDGES, 3]` of the prism of a regular polygon around a cylinder [m].

    The same array for the same cylinder, and no wider along x and y than the cylinder.

    Args:
        radius: of the cylinder [m].
        half_length: along its axis z [m].
    """
    angle = np.pi * (2 * np.arange(PRISM_EDGES) + 1) / PRISM_EDGES
    ring = radius / np.cos(np.pi / PRISM_EDGES) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.vstack(
        [np.column_stack([ring, np.full(PRISM_EDGES, z)]) for z in (-half_length, half_length)]
    )


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
