# SPDX-License-Identifier: MIT
"""Convex hulls as primitives: nothing of a mesh stands out, and distances are those of `coal`."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hull_shapes import MESHES, can, coal_points, round_points, signed_distance
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from test_approximation import wedge

from hybrid_jax.errors import WorkcellError
from hybrid_jax.kernels.collision import gjk, support_map
from hybrid_jax.workcell import convex_hulls

BODIES = 300


@pytest.fixture(scope="module")
def tables():
    return jax.tree.map(jnp.asarray, convex_hulls.hull_tables(MESHES))


def bodies(rng, boxes):
    """Poses and hulls of random bodies near one another."""
    hull = np.zeros(BODIES, int) if boxes else rng.integers(1, len(MESHES) + 1, BODIES)
    scale = rng.uniform(0.02, 0.2, (BODIES, 3)) if boxes else np.ones((BODIES, 3))
    rotation = Rotation.from_quat(rng.normal(size=(BODIES, 4)))
    return hull, scale, rotation, rng.uniform(-0.25, 0.25, (BODIES, 3))


def as_blocks(hull, scale, rotation, centre):
    parts = lambda a: [jnp.asarray(a[:, i], jnp.float32) for i in range(a.shape[1])]  # noqa: E731
    matrix = rotation.as_matrix()
    return SimpleNamespace(
        centre=parts(centre),
        rotation=[parts(matrix[:, i]) for i in range(3)],
        scale=parts(scale),
        hull=jnp.asarray(hull, jnp.int32),
        radius=jnp.zeros(len(hull)),
    )


def in_coal(coal, hull, scale, rotation, centre):
    """The same bodies as those of a public library, float64."""
    meshes = [coal.Convex.convexHull(coal_points(coal, m), True, "Qt") for m in MESHES]
    return [
        (coal.Box(*(2 * s)) if not h else meshes[h - 1], coal.Transform3s(r.as_matrix(), c))
        for h, s, r, c in zip(hull, scale, rotation, centre, strict=True)
    ]


@pytest.mark.parametrize("boxes", [True, False], ids=["hull and box", "two hulls"])
def test_distance_is_that_of_a_public_library(tables, boxes):
    coal = pytest.importorskip("coal")
    rng = np.random.default_rng(3)
    first, second = bodies(rng, False), bodies(rng, boxes)
    measure = jax.jit(
        lambda a, b: gjk.convex_distance(tables, SimpleNamespace(**a), SimpleNamespace(**b))
    )
    ours = np.asarray(measure(vars(as_blocks(*first)), vars(as_blocks(*second))))
    pairs = zip(in_coal(coal, *first), in_coal(coal, *second), strict=True)
    wanted = np.array([signed_distance(coal, *pair) for pair in pairs])
    apart, overlapping = wanted > 1e-4, wanted < -1e-4
    assert apart.sum() > 50 and overlapping.sum() > 20
    # never more than the true distance, but for rounding and ties
    assert (ours - wanted).max() < 1e-6 + 2 * convex_hulls.TIE
    assert (ours - wanted)[apart].min() > -1e-4
    assert (ours[overlapping] < 0).all()
    assert np.median(ours[overlapping] / wanted[overlapping]) < 2


@settings(max_examples=30, deadline=None)
@given(st.integers(0, len(MESHES)), st.integers(0, 2**32 - 1))
def test_the_table_knows_the_farthest_vertex(tables, hull, seed):
    rng = np.random.default_rng(seed)
    directions = np.concatenate([rng.normal(size=(60, 3)), np.eye(3), -np.eye(3)])
    # along an edge of a cell, and nearly along an axis
    directions = np.concatenate([directions, [[1, 1, 0.5], [1e-4, 1, 0], [0, 0, 1e-12]]])
    vertices = MESHES[hull - 1] if hull else convex_hulls._CUBE
    point = support_map.farthest_vertex(
        tables, jnp.full(len(directions), hull), jnp.asarray(directions.T, jnp.float32)
    )
    found = np.sum(np.stack(point, axis=1) * directions, axis=1)
    best = (directions @ vertices.T).max(axis=1)
    length = np.linalg.norm(directions, axis=1)
    assert (found >= best - length * (2 * convex_hulls.TIE + 1e-6)).all()


@pytest.mark.parametrize("points", [round_points(800, 4), can(300, 0.3), wedge()])
@pytest.mark.parametrize("excess", [5e-4, 3e-3])
def test_nothing_of_a_mesh_stands_out_of_its_polytope(points, excess):
    found = convex_hulls.polytope(points, excess, "m")
    inside = found.pose.inv().apply(points)
    kept = inside if found.vertices is None else found.vertices
    assert len(kept) <= len(points)
    out = [convex_hulls.distance_to_hull(p, kept) for p in inside]
    assert max(out) <= found.radius + 1e-6
    assert found.radius <= excess
    assert (np.abs(inside) <= np.array(found.half_extents) + 1e-9).all()
    # in every direction it reaches no farther than the mesh and the excess
    directions = Rotation.random(500, rng=0).apply([1, 0, 0])
    reach = (directions @ kept.T).max(axis=1) + found.radius
    assert (reach <= (directions @ inside.T).max(axis=1) + excess + 1e-9).all()


def test_fewer_vertices_suffice_where_more_is_allowed():
    excesses = 1e-4, 1e-3, 5e-3
    found = [convex_hulls._fewer(round_points(800, 4), excess) for excess in excesses]
    counts = [len(vertices) for vertices, _ in found]
    assert counts[0] > counts[1] > counts[2] > 4
    assert all(radius <= e for (_, radius), e in zip(found, excesses, strict=True))


def test_a_hull_of_few_vertices_stands_out_by_less_than_it_may():
    few, many = (
        convex_hulls.polytope(round_points(n, 4, (0.3, 0.3, 0.3)), 5e-4, "m") for n in (150, 4000)
    )
    assert few.radius <= 5e-5 + 1e-9 < 1e-4 < many.radius <= 5e-4


def test_a_box_as_a_mesh_is_a_box(tmp_path):
    corners = np.array(list(np.ndindex(2, 2, 2))) * [0.1, 0.05, 0.02]
    found = convex_hulls.polytope(Rotation.from_rotvec([0.3, 0.5, 0.7]).apply(corners), 1e-4, "m")
    assert found.vertices is None
    assert sorted(found.half_extents) == pytest.approx([0.01, 0.025, 0.05], abs=1e-6)


@pytest.mark.parametrize("length", [0.0, 0.1, 0.4])
def test_a_sphere_or_capsule_as_a_mesh_is_one(length):
    trimesh = pytest.importorskip("trimesh")
    solid = trimesh.creation.capsule(height=length, radius=0.05, count=[64, 64])
    turn = Rotation.from_rotvec([0.3, 0.5, 0.7])
    points = turn.apply(solid.vertices) + [0.1, 0, 0]
    found = convex_hulls.polytope(points, 5e-4, "m")
    assert found.vertices is None
    assert found.radius == pytest.approx(0.05, abs=1e-4)
    np.testing.assert_allclose(found.half_extents, [0, 0, length / 2], atol=1e-3)
    inside = found.pose.inv().apply(points)
    nearest = np.clip(inside, -np.array(found.half_extents), found.half_extents)
    assert (np.linalg.norm(inside - nearest, axis=1) <= found.radius + 1e-9).all()
    # a coarse one stands too far within its sphere to be taken for it
    coarse = trimesh.creation.capsule(height=length, radius=0.05, count=[8, 8])
    assert convex_hulls.polytope(coarse.vertices, 5e-4, "m").vertices is not None


def test_a_mesh_that_is_far_from_convex_is_said():
    """An L of three cubes: its hull has half a cube more."""
    trimesh = pytest.importorskip("trimesh")
    plan = [[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]]
    ell = trimesh.creation.extrude_triangulation(
        plan, [[0, 1, 3], [1, 2, 3], [0, 3, 5], [3, 4, 5]], 1.0
    )
    ratio = convex_hulls.hull_volume_ratio(ell.vertices, ell.faces)
    assert ratio == pytest.approx(3.5 / 3)
    assert convex_hulls.hull_volume_ratio(ell.vertices, ell.faces[1:]) == 1.0
    hull = trimesh.convex.convex_hull(can())
    assert convex_hulls.hull_volume_ratio(hull.vertices, hull.faces) == pytest.approx(1.0)


def test_a_flat_mesh_is_refused_by_name():
    flat = round_points(20, 5) * [1, 1, 0]
    with pytest.raises(WorkcellError, match="plate has no volume"):
        convex_hulls.polytope(flat, 1e-4, "plate")
