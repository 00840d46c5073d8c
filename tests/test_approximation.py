# SPDX-License-Identifier: MIT
"""Cylinders, meshes and planes: never smaller than the solid, larger by no more than stated."""

import itertools

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import oracles
import pytest
from scipy.spatial import ConvexHull

from hybrid_jax.kernels.collision.clearance import clearance
from hybrid_jax.workcell import approximation
from hybrid_jax.workcell.assets import robots_folder
from hybrid_jax.workcell.load import load_workcell

ARM = """<mujoco>{asset}<worldbody>{world}<body name="arm" pos="0 0 .5">
<joint name="a" axis="0 0 1" range="-3 3"/><joint name="b" axis="0 1 0" range="-2 2"/>
<geom name="link" type="capsule" size=".02" fromto="0 0 0 .4 0 0"/>
<body pos=".4 0 0"><joint name="c" axis="0 1 0" range="-2.5 2.5"/>
<geom type="capsule" size=".02" fromto=".03 0 0 .3 0 0"/><site name="tool" pos=".3 0 0"/></body>
</body></worldbody></mujoco>"""


def arm_cell(tmp_path, world, asset="", **kwargs):
    (tmp_path / "cell.xml").write_text(ARM.format(world=world, asset=asset))
    return load_workcell(tmp_path / "cell.xml", **kwargs)


def inside_box(points, box):
    pose, half, _ = box
    return np.all(np.abs(pose.inv().apply(points)) <= np.array(half) + 1e-9, axis=1)


@pytest.mark.parametrize("radius", [0.02, 0.1, 0.5])
def test_boxes_of_a_cylinder_contain_it_and_little_more(radius):
    boxes = approximation.cylinder(radius, 0.2)
    rng = np.random.default_rng(0)
    angle, r = rng.uniform(0, 2 * np.pi, 20000), radius * np.sqrt(rng.uniform(0, 1, 20000))
    points = np.stack([r * np.cos(angle), r * np.sin(angle), rng.uniform(-0.2, 0.2, 20000)], 1)
    assert np.any([inside_box(points, b) for b in boxes], axis=0).all()
    corners = np.array(list(itertools.product((-1, 1), repeat=3)))
    reach = max(np.linalg.norm(b[0].apply(corners * b[1])[:, :2], axis=1).max() for b in boxes)
    excess = approximation.cylinder_excess(radius, len(boxes))
    assert reach == pytest.approx(radius + excess, abs=1e-9)
    assert excess <= max(1e-3, 0.0087 * radius)


@pytest.mark.parametrize("radius", [0.02, 0.1, 0.5])
def test_a_prism_contains_its_cylinder_and_little_more(radius):
    corners = approximation.prism(radius, 0.2)
    assert approximation.prism(radius, 0.2) is corners
    np.testing.assert_allclose(np.abs(corners).max(axis=0), [radius, radius, 0.2], rtol=1e-9)
    planes = ConvexHull(corners).equations
    sides = planes[np.abs(planes[:, 2]) < 0.5]
    # the axis is as far from every side as the cylinder's surface, and no corner is much farther
    np.testing.assert_allclose(-sides[:, 3], radius, rtol=1e-9)
    assert np.linalg.norm(corners[:, :2], axis=1).max() < 1.0022 * radius


@pytest.mark.parametrize("half", [(0.1, 0.05, 0.05), (0.03, 0.08, 0.05), (0.04, 0.04, 0.04)])
def test_the_solid_around_an_ellipsoid_contains_it_and_little_more(half):
    ((_, box, radius),) = approximation.ellipsoid(np.array(half))
    surface = np.random.default_rng(0).normal(size=(5000, 3))
    surface = half * surface / np.linalg.norm(surface, axis=1, keepdims=True)
    outside = np.maximum(np.abs(surface) - box, 0)
    assert (np.linalg.norm(outside, axis=1) <= radius + 1e-9).all()
    # a point of the solid is this far from the ellipsoid, by brute force over its surface
    corner = np.array(box) + radius * np.array([1, 1, 1]) / np.sqrt(3)
    away = np.linalg.norm(surface - corner, axis=1).min()
    assert away <= approximation.ellipsoid_excess(np.array(half)) + 2e-3
    assert approximation.ellipsoid_excess(np.array(half)) < 0.2 * max(half)


def test_clearance_of_an_ellipsoid_is_that_of_the_solid_around_it(tmp_path):
    cell = arm_cell(tmp_path, '<geom type="ellipsoid" size=".1 .05 .05" pos=".2 .4 .5"/>')
    model, data = cell.model, mujoco.MjData(cell.model)
    excess = approximation.ellipsoid_excess(np.array([0.1, 0.05, 0.05]))
    for q in np.random.default_rng(1).uniform([-3, -2, -2.5], [3, 2, 2.5], (40, 3)):
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        gaps = [mujoco.mj_geomDistance(model, data, 0, g, 5.0, None) for g in (1, 2)]
        ours = float(clearance(cell, jnp.asarray(q, jnp.float32)))
        if min(gaps) > 0:
            assert min(gaps) - excess - 1e-3 < ours < min(gaps) + 1e-3


def wedge():
    """A tapered prism: no primitive."""
    x = np.linspace(0, 0.2, 2)
    return np.array(
        [[a, s * (0.05 - 0.1 * a), t * 0.02] for a in x for s in (-1, 1) for t in (-1, 1)]
    )


WEDGE = '<asset><mesh name="m" vertex="{}"/></asset>'.format(
    " ".join(f"{v:.5f}" for v in wedge().ravel())
)


@pytest.mark.parametrize(
    "world, asset, excess",
    [
        ('<geom type="cylinder" size=".1 .3" pos=".5 .45 .3" euler="20 30 0"/>', "", 1.1e-3),
        ('<geom type="plane" size="1 1 1" pos="0 0 .1"/>', "", 1e-5),
        (
            '<geom type="mesh" mesh="m" pos=".5 -.35 .4" euler="10 50 0"/>',
            WEDGE,
            1e-3,
        ),
        (
            '<geom type="cylinder" size=".1 .3" pos=".5 .45 .3" euler="20 30 0"/>'
            '<geom type="mesh" mesh="m" pos=".5 -.35 .4" euler="10 50 0"/>',
            WEDGE,
            3e-4,
        ),
    ],
    ids=["cylinder", "plane", "mesh", "cylinder beside a mesh"],
)
def test_clearance_is_at_most_the_engines_and_less_by_no_more_than_stated(
    tmp_path, world, asset, excess
):
    cell = arm_cell(tmp_path, world, asset)
    rng = np.random.default_rng(0)
    low, high = np.asarray(cell.joint_limits).T
    q = rng.uniform(low, high, (150, 3)).astype(np.float32)
    got = np.asarray(jax.jit(jax.vmap(lambda one: clearance(cell, one)))(jnp.asarray(q)))
    fixtures, links = np.split(np.arange(cell.model.ngeom), [-2])
    apart = 0
    for row, gap in zip(q, got, strict=True):
        data = oracles.cell_data(cell, row)
        wanted = min(
            mujoco.mj_geomDistance(cell.model, data, fixture, link, 5.0, None)
            for fixture, link in itertools.product(fixtures, links)
        )
        if wanted > excess:
            assert wanted - excess - 2e-4 <= gap <= wanted + 2e-4
            apart += 1
    assert apart > 50


@pytest.mark.slow
def test_the_second_robots_links_are_covered(shared):
    """Each by 99.5 %, and its kinematics agree; the checker fails otherwise only if strict."""
    import subprocess
    import sys

    mapping = shared / "robots" / "examples" / "fanuc_lrmate200id_map.json"
    checker = shared / "robots" / "check_collision_model.py"
    name = "fanuc_lrmate200id_brush"
    xml = robots_folder() / name / f"{name}.xml"
    done = subprocess.run(
        [
            sys.executable,
            str(checker),
            str(xml),
            "fanuc_lrmate200id",
            str(mapping),
            "--samples",
            "5000",
            "--strict",
        ],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout[-1500:] + done.stderr[-500:]
