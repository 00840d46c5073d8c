# SPDX-License-Identifier: MIT
"""Pairs of geoms that touch, or nearly, in every configuration: what a model should exclude."""

import copy
from collections import defaultdict
from dataclasses import dataclass

import mujoco
import numpy as np

from hybrid_jax.workcell.allowed_collisions import forbidden_contacts, overlaps
from hybrid_jax.workcell.chain import reference_data
from hybrid_jax.workcell.layout import Layout

SAMPLES = 200
"""Random configurations in which a pair is looked at."""
CLOSE = 0.004
"""A pair of bodies that is never further apart leaves no clearance to any motion [m]."""


@dataclass(frozen=True)
class TouchingPair:
    """Two geoms that are close in a share of all configurations."""

    geoms: tuple[int, int]
    """Numbers of the geoms, the lower one first."""
    share: float
    """Of random configurations, those in which they are close."""
    least_depth: float
    """How deep they overlap at least where they are close; negative: how far apart [m]."""


def touching_pairs(model: mujoco.MjModel, layout: Layout) -> list[TouchingPair]:
    """Pairs of geoms that must be kept apart and are close in some random configuration."""
    model = copy.deepcopy(model)
    # MuJoCo reports contacts of geoms that are closer than their margins, not overlaps alone
    model.geom_margin[:] = model.body_margin[:] = model.pair_margin[:] = CLOSE
    rng, data = np.random.default_rng(0), reference_data(model, layout)
    forbidden, joints = forbidden_contacts(model, layout), list(layout.joints)
    limited = model.jnt_limited[joints].astype(bool)[:, None]
    low, high = np.sort(np.where(limited, model.jnt_range[joints], [-np.pi, np.pi]), axis=1).T
    depths = defaultdict(list)
    for _ in range(SAMPLES):
        data.qpos[list(layout.qpos)] = rng.uniform(low, high)
        for pair, depth in overlaps(model, data, forbidden, CLOSE).items():
            depths[pair].append(depth)
    return [TouchingPair(pair, len(d) / SAMPLES, min(d)) for pair, d in depths.items()]
