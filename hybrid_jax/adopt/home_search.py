# SPDX-License-Identifier: MIT
"""A home that keeps a distance from everything."""

import copy

import mujoco
import numpy as np

from hybrid_jax.adopt.ready_pose import PLACES, configurations_at, ready_pose
from hybrid_jax.workcell.allowed_collisions import forbidden_contacts, overlaps, pierced
from hybrid_jax.workcell.layout import Layout, home_qpos

CLEARANCES = 0.01, 0.003
"""Distance that a home keeps from everything, and what suffices where none does [m]."""
WANTED = 0.1, 0.03
"""What a home over objects keeps where it can: an elbow that is up does [m]. The planner keeps 4 mm
along the way, and a home with less has a way out that is hard to find."""
TRIES = 1000
"""Configurations that are tried, further and further from where the model says."""
INSET = 0.05
"""Share of a joint's range that a home keeps from both ends."""


def find_home(
    model: mujoco.MjModel, layout: Layout, is_stated: bool, objects: list[int]
) -> tuple[np.ndarray | None, str]:
    """A free configuration over the objects, or else near the home of a model.

    Args:
        model: with a keyframe `home`.
        layout: of its arm.
        is_stated: whether that home is what the robot's file says; else it is zero.
        objects: bodies that the arm is to carry.

    Returns:
        The whole `qpos` `[nq]`, None where none is free, and a sentence; empty where the model's
        own home is kept.
    """
    if objects:
        home = _ready_home(model, layout, home_qpos(model), objects)
        if home is not None:
            return home, _sentence(layout, home, "the tool points down over the objects")
    home, note = _near_stated(model, layout, is_stated)
    missed = "no home is free whose tool points down over the objects" if objects else ""
    return home, "; ".join(filter(None, (note, missed)))


def _near_stated(
    model: mujoco.MjModel, layout: Layout, is_stated: bool
) -> tuple[np.ndarray | None, str]:
    """A free configuration near the home of a model; see `find_home`."""
    joints, address = list(layout.joints), list(layout.qpos)
    limited = model.jnt_limited[joints].astype(bool)[:, None]
    low, high = np.where(limited, model.jnt_range[joints], [-np.pi, np.pi]).T
    stated, inset = home_qpos(model), INSET * (high - low)
    first = stated[address]
    if ((first < low) | (first > high)).any():
        first = np.clip(first, low + inset, high - inset)
    rng = np.random.default_rng(0)
    tried = first + np.linspace(0, 1, TRIES)[:, None] * (
        rng.uniform(low + inset, high - inset, (TRIES, len(first))) - first
    )
    # links that a spherical wrist keeps close together leave less room than is wanted
    for clearance in CLEARANCES:
        home = _first_free(model, layout, stated, tried, clearance)
        if home is not None:
            if np.array_equal(home, stated):
                return home, ""
            old = "the stated one" if is_stated else "zero"
            reason = f"{old} touches something, or nearly, or is outside the limits"
            return home, _sentence(layout, home, reason)
    return None, f"no home is free: {TRIES} configurations touch something"


def _first_free(
    model: mujoco.MjModel, layout: Layout, stated: np.ndarray, tried: np.ndarray, clearance: float
) -> np.ndarray | None:
    """The first of some configurations `[n, joint]` that keeps a clearance [m], as `qpos`."""
    roomy = copy.deepcopy(model)
    roomy.geom_margin[:] = roomy.body_margin[:] = roomy.pair_margin[:] = clearance
    data, forbidden = mujoco.MjData(roomy), forbidden_contacts(model, layout)
    for q in tried:
        data.qpos[:] = stated
        data.qpos[list(layout.qpos)] = q
        close = overlaps(roomy, data, forbidden, clearance) or pierced(roomy, data, forbidden)
        if not close:
            return data.qpos.copy()
    return None


def _ready_home(
    model: mujoco.MjModel, layout: Layout, stated: np.ndarray, objects: list[int]
) -> np.ndarray | None:
    """A free configuration whose tool waits over the objects, as `qpos`; None where none is."""
    data = mujoco.MjData(model)
    data.qpos[:] = stated
    mujoco.mj_kinematics(model, data)
    base, found = data.xanchor[layout.joints[0]], []
    for place in PLACES:
        pose = ready_pose(base, data.xpos[objects], *place)
        found.append(configurations_at(model, layout, pose, stated))
        for clearance in WANTED:
            home = _first_free(model, layout, stated, found[-1], clearance)
            if home is not None:
                return home
    for clearance in CLEARANCES:
        home = _first_free(model, layout, stated, np.concatenate(found), clearance)
        if home is not None:
            return home
    return None


def _sentence(layout: Layout, home: np.ndarray, reason: str) -> str:
    """What home is, and why."""
    q = ", ".join(
        f"{name} {home[a]:.2f}" for name, a in zip(layout.joint_names, layout.qpos, strict=True)
    )
    return f"home is {q}: {reason}"
