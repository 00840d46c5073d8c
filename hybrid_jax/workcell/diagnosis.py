# SPDX-License-Identifier: MIT
"""All faults of a cell's model at once, where `load_workcell` stops at the first."""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import mujoco
import numpy as np

from hybrid_jax.errors import WorkcellError
from hybrid_jax.runtime.quiet import engine_messages
from hybrid_jax.workcell import geometry
from hybrid_jax.workcell.allowed_collisions import home_overlaps
from hybrid_jax.workcell.always_touching import touching_pairs
from hybrid_jax.workcell.approximation import ellipsoid_excess
from hybrid_jax.workcell.chain import (
    DEFAULT_ACCELERATION,
    DEFAULT_VELOCITY,
    joint_frames,
    reference_data,
)
from hybrid_jax.workcell.compile import require_geometry
from hybrid_jax.workcell.convex_hulls import MESH_TOLERANCE
from hybrid_jax.workcell.description import TaskData, read_task_data
from hybrid_jax.workcell.findings import DOUBTFUL, WRONG, Finding, tried
from hybrid_jax.workcell.layout import Layout, body_path, find_layout, home_qpos
from hybrid_jax.workcell.load import as_spec, compile_spec, is_urdf, read_model
from hybrid_jax.workcell.tool_frame import longest_chain, set_tool
from hybrid_jax.workcell.urdf import read_urdf

NARROW = 0.2
"""Range of a hinge below which it was probably meant in other units [rad]."""
FASTEST = {"rad": 30.0, "m": 20.0}
"""Speed above which another unit was probably meant [rad/s, m/s]: some five turns a second."""
SLOWEST = 1e-4
"""Speed below which a joint takes hours for any motion [rad/s, m/s]."""
LONGEST = 20.0
"""Length above which an arm was probably drawn in millimetres [m]."""
HOLLOW = 2.0
"""Volume of a hull over that of its mesh from which on it is said."""
_HINGE = int(mujoco.mjtJoint.mjJNT_HINGE)


def diagnose(
    path: Path,
    mesh_tolerance: float = MESH_TOLERANCE,
    tool: str = "",
    package_paths: Sequence[Path] = (),
    xacro_arguments: Mapping[str, str] | None = None,
) -> list[Finding]:
    """Faults of a cell, the worst first; empty if there is none.

    Args:
        path: MJCF, URDF or MJB file; the task data beside it are read as well.
        mesh_tolerance, tool, package_paths, xacro_arguments: see `load_workcell`.
    """
    findings: list[Finding] = []
    task = tried(findings, lambda: read_task_data(path.with_suffix(".toml")))
    model, layout = _look(findings, path, task, tool, package_paths, xacro_arguments)
    if model is not None:
        findings += _geoms(model, mesh_tolerance)
    if layout is not None:
        tried(findings, lambda: require_geometry(model, layout))
        findings += itertools.chain(
            _joints(path, model, layout),
            _lengths(model, layout),
            _masses(path, model, layout),
            _home(path, model, layout),
            _always_touching(model, layout),
        )
    return sorted(dict.fromkeys(findings), key=lambda finding: finding.level != WRONG)


def _look(found: list[Finding], path: Path, task: TaskData | None, tool: str, packages, arguments):
    """Model and layout, None where there is none; what prevents them is added to `found`."""
    model = tried(found, lambda: read_model(path, tool, packages, arguments))
    layout = model and tried(found, lambda: find_layout(model, task, tool))
    if layout is None and model is not None and task:
        layout = tried([], lambda: find_layout(model, None, tool))
    if layout is None and not tool:
        # where nothing tells the tool, all else is checked with the end of the longest chain
        end = tried([], lambda: longest_chain(as_spec(path, packages, arguments)))
        model = (end and tried([], lambda: read_model(path, end, packages, arguments))) or model
        layout = model and end and tried([], lambda: find_layout(model, None, end))
    if model is None and is_urdf(path):
        found += _but_for_meshes(path, tool, packages, arguments)
    return model, layout or None


def _but_for_meshes(path: Path, tool: str, packages, arguments) -> list[Finding]:
    """What is wrong with the tool and the joints of a URDF whose meshes cannot be read."""
    found: list[Finding] = []
    spec = tried([], lambda: read_urdf(path, packages, arguments, with_meshes=False))
    if spec is None:
        return []
    tried(found, lambda: set_tool(spec, tool))
    end = longest_chain(spec) if found else tool
    if found and end:
        set_tool(spec, end)
    model = tried([], lambda: compile_spec(spec))
    if model is not None:
        tried(found, lambda: find_layout(model, None, end))
    return found


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
        if model.geom_type[g] == geometry.ELLIPSOID:
            excess = 1e3 * ellipsoid_excess(model.geom_size[g])
            text = f"the ellipsoid {geometry.geom_label(model, g)} is taken as a rounded box"
            yield Finding(DOUBTFUL, f"{text} around it, up to {excess:.1f} mm larger")
        if model.geom_type[g] == geometry.MESH and model.geom_rbound[g] > LONGEST:
            text = f"the mesh of geom {geometry.geom_label(model, g)} has a radius of"
            yield Finding(
                DOUBTFUL,
                f"{text} {model.geom_rbound[g]:.0f} m: was it drawn in millimetres? Then give it "
                "scale='0.001 0.001 0.001'",
            )
        ratio = geometry.hull_ratio(model, g)
        if ratio > HOLLOW:
            label = geometry.geom_label(model, g)
            text = f"the mesh of geom {label} is far from convex: its hull has {ratio:.1f} times"
            yield Finding(DOUBTFUL, f"{text} its volume, and blocks all of it; split the mesh")
        try:
            geometry.primitives(model, data, g, world, tolerance)
        except WorkcellError as error:
            yield Finding(WRONG, str(error))


def _joints(path: Path, model: mujoco.MjModel, layout: Layout) -> Iterator[Finding]:
    """Limits and servos of the arm."""
    arm_joints = zip(
        layout.joint_names, layout.joint_units, layout.joints, layout.actuators, strict=True
    )
    for name, unit, j, actuator in arm_joints:
        low, high = model.jnt_range[j]
        if low > high or model.jnt_limited[j] and low == high:
            text = f"joint {name!r} has the range {low:g} to {high:g}"
            yield Finding(WRONG, f"{text}: the lower limit comes first")
        elif not model.jnt_limited[j] and unit == "rad":
            text = f"joint {name!r} has no range: it turns as often as it likes"
            yield Finding(DOUBTFUL, f"{text}; add range='low high' if it must not")
        elif not model.jnt_limited[j]:
            yield Finding(WRONG, f"slide joint {name!r} has no range: add range='low high'", True)
        elif unit == "rad" and high - low < NARROW:
            yield Finding(
                DOUBTFUL,
                f"joint {name!r} turns by {np.degrees(high - low):.1f} deg only: "
                "ranges are read as degrees unless <compiler angle='radian'/> says otherwise",
            )
        yield from _rates(path, model, name, unit, j)
        if actuator < 0:
            yield Finding(
                DOUBTFUL,
                f"joint {name!r} has no position actuator: plans can be made, not carried out",
            )


def _rates(path: Path, model: mujoco.MjModel, name: str, unit: str, j: int) -> Iterator[Finding]:
    """Velocity and acceleration limits of one joint."""
    remedy = "add user='velocity acceleration' to it and <size nuser_jnt='2'/> to the model"
    if is_urdf(path):
        remedy = "a URDF states velocities in <limit>; what else there is to say takes an MJCF"
    rates = (("velocity", DEFAULT_VELOCITY, "s"), ("acceleration", DEFAULT_ACCELERATION, "s^2"))
    for column, (quantity, default, per) in enumerate(rates):
        value = model.jnt_user[j, column] if model.nuser_jnt > column else 0.0
        if not np.isfinite(value):
            text = f"joint {name!r} has the {quantity} limit {value}: it must be finite"
            yield Finding(WRONG, text)
        elif value <= 0:
            yield Finding(
                DOUBTFUL,
                f"joint {name!r} states no {quantity} limit: {default:g} {unit}/{per} is used; "
                f"{remedy}",
                mended=True,
            )
        elif value < SLOWEST:
            text = f"joint {name!r} has the {quantity} limit {value:g} {unit}/{per}"
            yield Finding(WRONG, f"{text}: every motion would take hours")
        elif column == 0 and value > FASTEST[unit]:
            meant = "deg/s" if unit == "rad" else "mm/s"
            text = f"joint {name!r} has the velocity limit {value:g} {unit}/s"
            yield Finding(DOUBTFUL, f"{text}: was it meant in {meant}?")


def _lengths(model: mujoco.MjModel, layout: Layout) -> Iterator[Finding]:
    """Warning about an arm that is as long as one that was drawn in millimetres."""
    data = reference_data(model, layout)
    points = [frame.translation for frame in joint_frames(model, data, layout)]
    points.append(data.site_xpos[layout.tool_site])
    length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    slides = [j for j, unit in zip(layout.joints, layout.joint_units, strict=True) if unit == "m"]
    length = max([length, *(np.ptp(model.jnt_range[j]) for j in slides)])
    if length > LONGEST:
        yield Finding(
            DOUBTFUL,
            f"the arm is {length:.0f} m long: lengths are in metres; was it meant in mm? Then "
            "scale the model by 0.001",
        )


def _masses(path: Path, model: mujoco.MjModel, layout: Layout) -> Iterator[Finding]:
    """Links without a stated mass, and objects without any mass."""
    links = {b for j in layout.joints for b in body_path(model, int(model.jnt_bodyid[j]))}
    links = {model.body(b).name for b in links if model.body_weldid[b]}
    if path.suffix.lower() == ".xml":
        with engine_messages(path.name):
            spec = as_spec(path)
        for body in spec.bodies:
            if body.name and body.name in links and not body.explicitinertial:
                mass = model.body(body.name).mass[0]
                yield Finding(
                    DOUBTFUL,
                    f"link {body.name!r} has no <inertial>: its {mass:.2f} kg are what its geoms "
                    "weigh at their density",
                )
    for name, body in zip(layout.object_names, layout.object_bodies, strict=True):
        if model.body_subtreemass[body] < 1e-4:
            yield Finding(WRONG, f"object {name!r} weighs nothing: give its geoms a mass")


def _home(path: Path, model: mujoco.MjModel, layout: Layout) -> Iterator[Finding]:
    """Faults of the home configuration: missing, outside the limits, in collision."""
    home, has_keyframe = home_qpos(model), _states_home(path)
    if not has_keyframe:
        q = ", ".join(
            f"{name} {home[address]:.3g} {unit}"
            for name, address, unit in zip(
                layout.joint_names, layout.qpos, layout.joint_units, strict=True
            )
        )
        yield Finding(DOUBTFUL, f"there is no keyframe 'home': the arm starts at {q}")
    remedy = (
        "change the keyframe 'home'" if has_keyframe else "write an MJCF with a keyframe 'home'"
    )
    arm_joints = zip(
        layout.joint_names, layout.joint_units, layout.joints, layout.qpos, strict=True
    )
    for name, unit, j, address in arm_joints:
        low, high = model.jnt_range[j]
        if model.jnt_limited[j] and low < high and not low <= home[address] <= high:
            yield Finding(
                WRONG,
                f"the home configuration has joint {name!r} at {home[address]:.3f} {unit}, outside "
                f"its limits {low:.3f} to {high:.3f}; {remedy}",
                mended=True,
            )
    for sentence in home_overlaps(model, layout):
        yield Finding(WRONG, sentence, mended=True)


def _states_home(path: Path) -> bool:
    """Does the file itself hold a keyframe?"""
    if is_urdf(path):
        return False
    if path.suffix.lower() == ".mjb":
        return mujoco.MjModel.from_binary_path(str(path)).nkey > 0
    with engine_messages(path.name):
        return len(list(as_spec(path).keys)) > 0


def _always_touching(model: mujoco.MjModel, layout: Layout) -> Iterator[Finding]:
    """Bodies that touch, or nearly, in every configuration: a missing exclusion, or a bad geom."""
    for found in touching_pairs(model, layout):
        if found.share < 1:
            continue
        a, b = found.geoms
        pair = f"{geometry.geom_label(model, a)} and {geometry.geom_label(model, b)}"
        bodies = [geometry.body_label(model, int(model.geom_bodyid[g])) for g in (a, b)]
        relation = (
            "overlap in every configuration"
            if found.least_depth > 0
            else f"are never further apart than {max(0.0, -1e3 * found.least_depth):.1f} mm, "
            "and no motion keeps a margin"
        )
        yield Finding(
            WRONG,
            f"{pair} {relation}: add <exclude body1='{bodies[0]}' body2='{bodies[1]}'/> to the "
            "<contact> of an MJCF, or make one of them smaller",
            mended=True,
        )
