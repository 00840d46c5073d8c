# SPDX-License-Identifier: MIT
"""Everything that is wrong with a cell's model at once; `load_workcell` stops at the first."""

import copy
import itertools
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from hybrid_jax.errors import HybridJaxError, WorkcellError
from hybrid_jax.quiet import engine_messages
from hybrid_jax.workcell import geometry
from hybrid_jax.workcell.chain import DEFAULT_ACCELERATION, DEFAULT_VELOCITY, reference_data
from hybrid_jax.workcell.compile import MESH_TOLERANCE
from hybrid_jax.workcell.contacts import home_overlaps, overlaps
from hybrid_jax.workcell.description import read_task_data
from hybrid_jax.workcell.layout import Layout, body_path, find_layout, home_qpos, moved_geoms
from hybrid_jax.workcell.load import read_model

WRONG, DOUBTFUL = "wrong", "doubtful"
SAMPLES = 200
"""Random configurations in which pairs are tried that touch always."""
CLOSE = 0.004
"""A pair that is never further apart leaves no clearance that a motion could keep [m]."""
NARROW = 0.2
"""A hinge that turns by less was probably meant in other units [rad]."""
_HINGE = int(mujoco.mjtJoint.mjJNT_HINGE)


@dataclass(frozen=True)
class Finding:
    """One sentence about a model."""

    level: str
    """`wrong`: nothing can be planned; `doubtful`: it can, but perhaps not what you want."""
    text: str


def diagnose(path: Path, mesh_tolerance: float = MESH_TOLERANCE) -> list[Finding]:
    """What is wrong with a cell, worst first; empty if nothing is.

    Args:
        path: MJCF, URDF or MJB file; the task data beside it are read as well.
        mesh_tolerance: see `load_workcell`.
    """
    try:
        model = read_model(path)
    except HybridJaxError as error:
        return [Finding(WRONG, str(error))]
    found = list(_geoms(model, mesh_tolerance))
    try:
        layout = find_layout(model, read_task_data(path.with_suffix(".toml")))
    except HybridJaxError as error:
        found.append(Finding(WRONG, str(error)))
        # the rest needs an arm: look for one without the task data
        try:
            layout = find_layout(model, None)
        except HybridJaxError:
            return found
    checks = (
        _joints(model, layout), _masses(path, model, layout), _home(model, layout),
        _always_touching(model, layout),
    )  # fmt: skip
    found += itertools.chain(*checks)
    return sorted(found, key=lambda finding: finding.level != WRONG)


def _geoms(model: mujoco.MjModel, tolerance: float) -> Iterator[Finding]:
    """Geoms that the kernels refuse."""
    try:
        geoms = geometry.collision_geoms(model)
    except WorkcellError as error:
        yield Finding(WRONG, str(error))
        return
    data, world = mujoco.MjData(model), geometry.pose_of([0, 0, 0], [1, 0, 0, 0])
    mujoco.mj_kinematics(model, data)
    for g in geoms:
        try:
            geometry.primitives(model, data, g, world, tolerance)
        except WorkcellError as error:
            yield Finding(WRONG, str(error))


def _joints(model: mujoco.MjModel, layout: Layout) -> Iterator[Finding]:
    """Limits and servos of the arm."""
    rates = (("velocity", DEFAULT_VELOCITY, 0), ("acceleration", DEFAULT_ACCELERATION, 1))
    for name, j, actuator in zip(layout.joint_names, layout.joints, layout.actuators, strict=True):
        if not model.jnt_limited[j] and model.jnt_type[j] == _HINGE:
            text = f"joint {name!r} has no range: it is planned within two turns"
            yield Finding(DOUBTFUL, f"{text}; add range='low high'")
        elif model.jnt_type[j] == _HINGE and np.ptp(model.jnt_range[j]) < NARROW:
            yield Finding(
                DOUBTFUL,
                f"joint {name!r} turns by {np.degrees(np.ptp(model.jnt_range[j])):.1f} deg only: "
                "ranges are read as degrees unless <compiler angle='radian'/> says otherwise",
            )
        elif not model.jnt_limited[j]:
            yield Finding(WRONG, f"slide joint {name!r} has no range: add range='low high'")
        for what, default, column in rates:
            if model.nuser_jnt <= column or model.jnt_user[j, column] <= 0:
                yield Finding(
                    DOUBTFUL,
                    f"joint {name!r} states no {what} limit: {default:g} is used; add "
                    "user='velocity acceleration' to it and <size nuser_jnt='2'/> to the model",
                )
        if actuator < 0:
            yield Finding(
                DOUBTFUL,
                f"joint {name!r} has no position actuator: plans can be made, not carried out",
            )


def _masses(path: Path, model: mujoco.MjModel, layout: Layout) -> Iterator[Finding]:
    """Links whose mass nobody stated, and things without any."""
    links = {b for j in layout.joints for b in body_path(model, int(model.jnt_bodyid[j]))}
    links = {model.body(b).name for b in links if model.body_weldid[b]}
    if path.suffix == ".xml":
        with engine_messages(path.name):
            spec = mujoco.MjSpec.from_file(str(path))
        for body in spec.bodies:
            if body.name in links and not body.explicitinertial:
                mass = model.body(body.name).mass[0]
                yield Finding(
                    DOUBTFUL,
                    f"link {body.name!r} has no <inertial>: its {mass:.2f} kg are what its geoms "
                    "weigh at their density",
                )
    for name, body in zip(layout.object_names, layout.object_bodies, strict=True):
        if model.body_subtreemass[body] < 1e-4:
            yield Finding(WRONG, f"object {name!r} weighs nothing: give its geoms a mass")


def _home(model: mujoco.MjModel, layout: Layout) -> Iterator[Finding]:
    """The home configuration: is there one, within the limits, free?"""
    if not model.nkey:
        yield Finding(DOUBTFUL, "there is no keyframe 'home': the arm starts with all joints at 0")
    home = home_qpos(model)
    for name, j, address in zip(layout.joint_names, layout.joints, layout.qpos, strict=True):
        low, high = model.jnt_range[j]
        if model.jnt_limited[j] and not low <= home[address] <= high:
            yield Finding(
                WRONG,
                f"the home configuration has joint {name!r} at {home[address]:.3f}, outside its "
                f"limits {low:.3f} to {high:.3f}; change the keyframe 'home'",
            )
    for sentence in home_overlaps(model, layout):
        yield Finding(WRONG, sentence)


def _always_touching(model: mujoco.MjModel, layout: Layout) -> Iterator[Finding]:
    """Bodies that touch, or nearly, in every configuration: a missing exclusion, or a bad geom."""
    model = copy.deepcopy(model)
    model.geom_margin[:] = model.body_margin[:] = CLOSE  # contacts are reported from this on
    rng, data = np.random.default_rng(0), reference_data(model, layout)
    robot, joints = moved_geoms(model, layout), list(layout.joints)
    limited = model.jnt_limited[joints].astype(bool)[:, None]
    low, high = np.where(limited, model.jnt_range[joints], [-np.pi, np.pi]).T
    depths = defaultdict(list)
    for _ in range(SAMPLES):
        data.qpos[list(layout.qpos)] = rng.uniform(low, high)
        for pair, depth in overlaps(model, data, robot, CLOSE).items():
            depths[pair].append(depth)
    for (a, b), found in depths.items():
        if len(found) < SAMPLES:
            continue
        pair = f"{geometry.geom_label(model, a)} and {geometry.geom_label(model, b)}"
        bodies = [model.body(model.geom_bodyid[g]).name for g in (a, b)]
        how = (
            "overlap in every configuration" if min(found) > 0 else
            f"are never further apart than {max(0.0, -1e3 * min(found)):.1f} mm, and no motion "
            "keeps a margin"
        )  # fmt: skip
        yield Finding(
            WRONG,
            f"{pair} {how}: add <exclude body1='{bodies[0]}' body2='{bodies[1]}'/>, or make one "
            "of them smaller",
        )
