# SPDX-License-Identifier: MIT
"""Answers that share no code with the package: C MuJoCo, SciPy, brute force."""

import mujoco
import numpy as np
from scipy.spatial import ConvexHull

WORLD = "<mujoco><worldbody>{}</worldbody></mujoco>"


def geom_pair(kind_a, size_a, kind_b, size_b):
    """Model and data of two free geoms."""
    body = '<body><freejoint/><geom type="{}" size="{}"/></body>'
    text = WORLD.format(
        body.format(kind_a, " ".join(map(str, size_a)))
        + body.format(kind_b, " ".join(map(str, size_b)))
    )
    model = mujoco.MjModel.from_xml_string(text)
    return model, mujoco.MjData(model)


def random_quat(rng):
    q = rng.normal(size=4)
    return q / np.linalg.norm(q)


def cell_data(cell, q):
    """C MuJoCo's kinematics of the cell at an arm configuration, the rest at home."""
    from hybrid_jax.workcell.layout import home_qpos

    model, data = cell.model, mujoco.MjData(cell.model)
    data.qpos[:] = home_qpos(model)
    data.qpos[list(cell.source.layout.qpos)] = q
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    return data


def box_corners(half):
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    return signs * half


def penetration(points_a, points_b):
    """Depth of two overlapping polytopes: distance of 0 to the hull of their difference."""
    difference = (points_a[:, None] - points_b[None]).reshape(-1, 3)
    return float(np.min(-ConvexHull(difference).equations[:, 3]))


def sampled_segment_box(ends, half, samples=20001):
    """Distance of a segment and a box by dense sampling."""
    t = np.linspace(0, 1, samples)[:, None]
    points = ends[0] + t * (ends[1] - ends[0])
    return float(np.linalg.norm(np.maximum(np.abs(points) - half, 0), axis=1).min())
