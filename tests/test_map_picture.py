# SPDX-License-Identifier: MIT
"""Geometry of the map's picture: the faces that are seen, and fixtures in a slice."""

import jax.numpy as jnp
import numpy as np
import pytest

from hybrid_jax.feasibility.building import FeasibilityMap
from hybrid_jax.feasibility.evaluation import Reason
from hybrid_jax.reports.map_picture import draw_map, exposed_faces, fixture_edges, outline


def test_only_outer_faces_of_voxels_are_drawn():
    """Brute force: each of the six sides of each voxel, without one that two of them share."""
    filled = np.random.default_rng(3).random((4, 3, 5)) < 0.5
    wanted = set()
    for voxel in np.argwhere(filled):
        for axis in range(3):
            for side in (0, 1):
                beside = voxel.copy()
                beside[axis] += 2 * side - 1
                inside = (beside >= 0).all() and (beside < filled.shape).all()
                if not (inside and filled[tuple(beside)]):
                    centre = voxel + 0.5
                    centre[axis] = voxel[axis] + side
                    wanted.add((*voxel, *centre))
    faces, owners = exposed_faces(filled)
    found = {(*o, *f) for o, f in zip(owners, faces.mean(axis=1), strict=True)}
    assert found == wanted and len(faces) == len(wanted)
    assert all(len(np.unique(face, axis=0)) == 4 for face in faces)


def test_outlines_of_fixtures_in_a_slice(cell):
    """The area of an axis-parallel wall's outline is that of its cross section."""
    edges = fixture_edges(cell)
    assert len(edges) == cell.fixtures.used
    for box in edges:
        low, high = box.reshape(-1, 3).min(axis=0), box.reshape(-1, 3).max(axis=0)
        lengths = np.linalg.norm(box[:, 0] - box[:, 1], axis=1)
        if not np.isclose(np.sort(lengths)[::4], np.sort(high - low), atol=1e-5).all():
            continue  # turned against the axes
        u, v = outline(box, 2, float((low + high)[2] / 2)).T
        area = abs(np.dot(u, np.roll(v, 1)) - np.dot(v, np.roll(u, 1))) / 2
        assert area == pytest.approx((high - low)[0] * (high - low)[1], rel=1e-4)
        assert not len(outline(box, 2, float(high[2] + 0.01)))


@pytest.mark.parametrize("reason", [Reason.UNREACHABLE, Reason.FEASIBLE])
@pytest.mark.parametrize("fixtures", [True, False])
def test_a_map_of_nothing_is_drawn_too(cell, tmp_path, reason, fixtures):
    if not fixtures:
        active = jnp.zeros_like(cell.fixtures.active)
        cell = cell.replace(fixtures=cell.fixtures.replace(active=active))
    zeros, turns = np.zeros((2, 3, 1, 1), np.float32), np.eye(4, dtype=np.float32)[:1]
    fmap = FeasibilityMap(
        lower=np.zeros(3),
        spacing=np.float32(0.1),
        orientations=turns,
        feasibility=zeros,
        reason=np.full(zeros.shape, reason, np.uint8),
        configuration=zeros[..., None],
        manipulability=zeros,
        clearance=zeros,
        manipulability_scale=np.float32(1.0),
    )
    draw_map(tmp_path / "map.png", cell, fmap)
    assert (tmp_path / "map.png").stat().st_size > 10_000
