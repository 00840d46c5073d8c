# SPDX-License-Identifier: MIT
"""Convex meshes for tests, and their distance by `coal`."""

import numpy as np
from test_approximation import wedge


def round_points(count, seed, half=(0.2, 0.1, 0.05)):
    """Points of an ellipsoid's surface."""
    points = np.random.default_rng(seed).normal(size=(count, 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True) * half


def can(count=40, radius=0.08, height=0.3):
    """A prism with rims of many corners, as links have."""
    angle = np.arange(count) * 2 * np.pi / count
    ring = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.vstack([np.c_[ring, np.full(count, z)] for z in (0, height)])


MESHES = [round_points(8, 1), round_points(40, 2), can(), wedge()]


def coal_points(coal, vertices):
    points = coal.StdVec_Vec3s()
    for vertex in vertices:
        points.append(vertex)
    return points


def signed_distance(coal, one, other):
    request = coal.DistanceRequest()
    request.enable_signed_distance = True
    return coal.distance(*one, *other, request, coal.DistanceResult())


def write_stl(path, vertices):
    """The hull of some vertices as a binary STL file."""
    import trimesh

    path.parent.mkdir(parents=True, exist_ok=True)
    trimesh.convex.convex_hull(vertices).export(path)
