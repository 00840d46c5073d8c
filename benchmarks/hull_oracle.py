# SPDX-License-Identifier: MIT
"""Distances of a cell by `coal`, a public library, on the convex hulls of its meshes, float64."""

import mujoco
import numpy as np
from scipy.spatial import ConvexHull

from hybrid_jax.workcell import geometry
from hybrid_jax.workcell.allowed_collisions import forbidden_contacts
from hybrid_jax.workcell.convex_hulls import MESH_TOLERANCE, distance_to_hull

_KIND = mujoco.mjtGeom


class HullOracle:
    """Smallest signed distance of the pairs that a motion must keep apart."""

    def __init__(self, cell):
        import coal

        self._coal, self._model, self._layout = coal, cell.model, cell.source.layout
        self._data = mujoco.MjData(cell.model)
        forbidden = forbidden_contacts(cell.model, self._layout)
        self._pairs = np.argwhere(np.triu(forbidden)).tolist()
        self._shapes = {g: self._shape(g) for g in {g for pair in self._pairs for g in pair}}
        self._request = coal.DistanceRequest()
        self._request.enable_signed_distance = True

    def _shape(self, geom: int):
        coal, size = self._coal, self._model.geom_size[geom]
        kind = self._model.geom_type[geom]
        if kind == _KIND.mjGEOM_MESH:
            points = coal.StdVec_Vec3s()
            for vertex in mesh_vertices(self._model, geom):
                points.append(vertex)
            return coal.Convex.convexHull(points, True, "Qt")
        makers = {
            _KIND.mjGEOM_BOX: lambda: coal.Box(*(2 * size)),
            _KIND.mjGEOM_SPHERE: lambda: coal.Sphere(size[0]),
            _KIND.mjGEOM_CAPSULE: lambda: coal.Capsule(size[0], 2 * size[1]),
            _KIND.mjGEOM_CYLINDER: lambda: coal.Cylinder(size[0], 2 * size[1]),
            _KIND.mjGEOM_ELLIPSOID: lambda: coal.Ellipsoid(*size),
            _KIND.mjGEOM_PLANE: lambda: coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0),
        }
        return makers[_KIND(int(kind))]()

    def distance(self, q: np.ndarray) -> float:
        """Smallest signed distance at a configuration `[joint]` [m]; infinity without a pair."""
        coal, data = self._coal, self._data
        if self._model.nkey:
            data.qpos[:] = self._model.key_qpos[0]
        data.qpos[list(self._layout.qpos)] = q
        mujoco.mj_kinematics(self._model, data)
        poses = {
            g: coal.Transform3s(data.geom_xmat[g].reshape(3, 3), data.geom_xpos[g])
            for g in self._shapes
        }
        best = np.inf
        for a, b in self._pairs:
            pair = (self._shapes[a], poses[a], self._shapes[b], poses[b])
            best = min(best, coal.distance(*pair, self._request, coal.DistanceResult()))
        return best


def mesh_vertices(model: mujoco.MjModel, geom: int) -> np.ndarray:
    """`[n, 3]` vertices of a mesh geom in its frame [m]."""
    mesh = int(model.geom_dataid[geom])
    first = int(model.mesh_vertadr[mesh])
    return model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])].astype(float)


def links_outside(cell, count: int) -> np.ndarray:
    """How far random points of each link's hull stand out of its polytope [m].

    Args:
        cell: whose robot is looked at.
        count: points of each mesh.

    Returns:
        `[mesh * count]`: height above the polytope's faces, less its ball.
    """
    model, data = cell.model, mujoco.MjData(cell.model)
    mujoco.mj_kinematics(model, data)
    world = geometry.pose_of([0, 0, 0], [1, 0, 0, 0])
    rng, heights = np.random.default_rng(0), []
    for geom in geometry.touching_geoms(model):
        if model.geom_type[geom] != _KIND.mjGEOM_MESH:
            continue
        (primitive,) = geometry.primitives(model, data, geom, world, MESH_TOLERANCE)
        vertices = mesh_vertices(model, geom)
        hull = ConvexHull(vertices)
        points = vertices[rng.choice(hull.simplices.ravel(), (count, 3))]
        points = np.einsum("nk,nkd->nd", rng.dirichlet(np.ones(3), count), points)
        points = np.concatenate([points, vertices[hull.vertices]])
        placed = points @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
        own = primitive.pose.inv().apply(placed)
        if primitive.vertices is None:
            over = np.maximum(np.abs(own) - primitive.half_extents, 0)
            heights.append(np.maximum(np.linalg.norm(over, axis=1) - primitive.radius, 0))
            continue
        planes = ConvexHull(primitive.vertices).equations
        above = (own @ planes[:, :3].T + planes[:, 3]).max(axis=1)
        # beyond an edge a point is farther than above the faces beside it. Distance is convex: no
        # point of the hull is farther than the farthest vertex, so these are measured exactly
        corners = np.arange(count, len(own))
        above[corners] = [distance_to_hull(p, primitive.vertices) for p in own[corners]]
        heights.append(np.maximum(above - primitive.radius, 0))
    return np.concatenate(heights) if heights else np.zeros(0)
