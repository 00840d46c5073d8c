# SPDX-License-Identifier: MIT
"""`MjModel` to `Workcell`: the only place where MJCF turns into the kernels' arrays."""

import hashlib

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from hybrid_jax.errors import WorkcellError
from hybrid_jax.types import (
    ContactPairs,
    KinematicChain,
    RobotShapes,
    Scene,
    Workcell,
    WorkcellSource,
)
from hybrid_jax.workcell import geometry
from hybrid_jax.workcell.description import Handling
from hybrid_jax.workcell.layout import Layout, body_joints, body_path, find_layout, home_qpos

DEFAULT_VELOCITY = 1.0
"""Velocity limit of a joint whose `user` data states none [rad/s or m/s]: slow on purpose."""
DEFAULT_ACCELERATION = 5.0
"""The same for accelerations [rad/s^2 or m/s^2]."""
_HINGE = int(mujoco.mjtJoint.mjJNT_HINGE)


def _reference_data(model: mujoco.MjModel, layout: Layout) -> mujoco.MjData:
    """Kinematics with the arm at its reference, the fingers closed, the rest at home."""
    data = mujoco.MjData(model)
    data.qpos[:] = home_qpos(model)
    data.qpos[list(layout.qpos)] = model.qpos0[list(layout.qpos)]
    data.qpos[[model.jnt_qposadr[j] for j in layout.fingers]] = 0.0
    mujoco.mj_kinematics(model, data)
    return data


def _joint_frames(model, data, layout) -> list:
    """World pose of each joint's frame in the reference configuration."""
    frames = []
    for j in layout.joints:
        body = model.jnt_bodyid[j]
        pose = geometry.matrix_pose(data.xpos[body], data.xmat[body])
        frames.append(pose * geometry.pose_of(model.jnt_pos[j], [1, 0, 0, 0]))
    return frames


def _limits(model, layout) -> np.ndarray:
    rows = []
    for name, j in zip(layout.joint_names, layout.joints, strict=True):
        if model.jnt_limited[j]:
            rows.append(model.jnt_range[j])
        elif model.jnt_type[j] == _HINGE:
            rows.append((-2 * np.pi, 2 * np.pi))
        else:
            raise WorkcellError(f"slide joint {name!r} has no range: add range='lower upper'")
    return np.array(rows)


def _rates(model, layout, column: int, default: float) -> np.ndarray:
    if model.nuser_jnt <= column:
        return np.full(len(layout.joints), default)
    stated = model.jnt_user[list(layout.joints), column]
    return np.where(stated > 0, stated, default)


def _chain(model, data, layout) -> KinematicChain:
    frames = _joint_frames(model, data, layout)
    base = geometry.pose_of([0, 0, 0], [1, 0, 0, 0])
    before = [base, *frames[:-1]]
    offsets = [geometry.as_row(a.inv() * b) for a, b in zip(before, frames, strict=True)]
    site = layout.tool_site
    tool = geometry.matrix_pose(data.site_xpos[site], data.site_xmat[site])
    joints = list(layout.joints)
    arrays = (
        geometry.as_row(base),
        np.stack(offsets),
        model.jnt_axis[joints],
        (model.jnt_type[joints] == _HINGE).astype(float),
        model.qpos0[list(layout.qpos)],
        geometry.as_row(frames[-1].inv() * tool),
        _limits(model, layout),
        _rates(model, layout, 0, DEFAULT_VELOCITY),
        _rates(model, layout, 1, DEFAULT_ACCELERATION),
    )
    return KinematicChain(*(jnp.asarray(np.asarray(a, np.float32)) for a in arrays))


def _link_of(model, layout, geom: int) -> int:
    """Last arm joint above a geom; -1 for a geom that the arm does not move."""
    link = -1
    for body in body_path(model, int(model.geom_bodyid[geom])):
        for j in body_joints(model, body):
            link = layout.joints.index(j) if j in layout.joints else link
    return link


def _stroke(model, data, layout, geom: int, frame) -> np.ndarray:
    """Displacement of a geom per metre of gripper opening, in its link's frame."""
    stroke = np.zeros(3)
    for body in body_path(model, int(model.geom_bodyid[geom])):
        for j in body_joints(model, body):
            if j in layout.fingers:
                stroke += frame.rotation.inv().apply(data.xaxis[j])
    return stroke


def _object_of(model, layout, geom: int) -> int:
    path = body_path(model, int(model.geom_bodyid[geom]))
    return layout.object_bodies.index(path[0]) if path and path[0] in layout.object_bodies else -1


def may_collide(model: mujoco.MjModel, a: int, b: int) -> bool:
    """MuJoCo's own filter: bit masks, same or adjacent bodies, excluded body pairs."""
    bits = (model.geom_contype[a] & model.geom_conaffinity[b]) | (
        model.geom_contype[b] & model.geom_conaffinity[a]
    )
    body_a, body_b = int(model.geom_bodyid[a]), int(model.geom_bodyid[b])
    weld_a, weld_b = int(model.body_weldid[body_a]), int(model.body_weldid[body_b])
    if not bits or weld_a == weld_b:
        return False
    parent_a = int(model.body_weldid[model.body_parentid[weld_a]])
    parent_b = int(model.body_weldid[model.body_parentid[weld_b]])
    if weld_a and weld_b and (weld_a == parent_b or weld_b == parent_a):
        return False
    low, high = sorted((body_a, body_b))
    return (low << 16) + high not in set(int(s) for s in model.exclude_signature)


def _split(primitives):
    return [p for p in primitives if not p.box], [p for p in primitives if p.box]


def _pairs(model, robot, world, planes, payload_slots, last_link, links) -> ContactPairs:
    """Masks over robot x world and index pairs within the robot; payload slots come last."""
    robot_c, robot_b = _split(robot)
    fixed, objects = world
    world_c = _split(fixed)[0] + _split(objects)[0]
    world_b = _split(fixed)[1] + _split(objects)[1]

    def mask(rows, columns, slots):
        table = [[may_collide(model, r.geom, c) for c in columns] for r in rows]
        table = np.array(table, np.float32).reshape(len(rows), len(columns))
        return jnp.asarray(np.vstack([table, np.ones((slots, len(columns)), np.float32)]))

    geoms_c, geoms_b = [p.geom for p in world_c], [p.geom for p in world_b]
    slots_c, slots_b = payload_slots

    def inner(first, second, same):
        found = [
            (i, j)
            for i, p in enumerate(first)
            for j, r in enumerate(second)
            if (not same or i < j) and may_collide(model, p.geom, r.geom)
        ]
        return found

    # the payload may touch the link that carries the gripper, and nothing before it
    free_c = [j for j, p in enumerate(robot_c) if links[p.geom] < last_link]
    free_b = [j for j, p in enumerate(robot_b) if links[p.geom] < last_link]
    own_c = [len(robot_c) + k for k in range(slots_c)]
    own_b = [len(robot_b) + k for k in range(slots_b)]
    return ContactPairs(
        capsule_capsule=mask(robot_c, geoms_c, slots_c),
        capsule_box=mask(robot_c, geoms_b, slots_c),
        capsule_plane=mask(robot_c, planes, slots_c),
        box_capsule=mask(robot_b, geoms_c, slots_b),
        box_box=mask(robot_b, geoms_b, slots_b),
        box_plane=mask(robot_b, planes, slots_b),
        self_capsules=tuple(
            inner(robot_c, robot_c, True) + [(j, k) for k in own_c for j in free_c]
        ),
        self_boxes=tuple(
            inner(robot_b, robot_c, False)
            + [(k, j) for k in own_b for j in free_c]
            + [(j, k) for k in own_c for j in free_b]
        ),
        self_box_boxes=tuple(
            inner(robot_b, robot_b, True) + [(k, j) for k in own_b for j in free_b]
        ),
    )


def _robot(model, data, layout, geoms, frames, links, slots):
    """Primitives that the arm moves, and their record."""
    primitives = [geometry.primitive(model, data, g, frames[links[g]]) for g in geoms]
    capsules, boxes = _split(primitives)

    def strokes(ones):
        rows = [_stroke(model, data, layout, p.geom, frames[links[p.geom]]) for p in ones]
        return jnp.asarray(np.array(rows, np.float32).reshape(-1, 3))

    tool = len(layout.joints)
    record = RobotShapes(
        shapes=geometry.to_shapes(primitives),
        capsule_stroke=strokes(capsules),
        box_stroke=strokes(boxes),
        capsule_link=tuple(links[p.geom] for p in capsules) + (tool,) * slots[0],
        box_link=tuple(links[p.geom] for p in boxes) + (tool,) * slots[1],
        payload_capsules=slots[0],
        payload_boxes=slots[1],
    )
    return primitives, record


def _objects(model, data, layout, geoms):
    """Primitives of the movable objects in their bodies' frames, and the object of each."""
    primitives = []
    for g in geoms:
        body = layout.object_bodies[_object_of(model, layout, g)]
        frame = geometry.matrix_pose(data.xpos[body], data.xmat[body])
        primitives.append(geometry.primitive(model, data, g, frame))
    return primitives


def _digest(arrays, names, task) -> str:
    """Hash of what the kernels read, rounded so that it does not depend on the last bit."""
    total = hashlib.sha256(repr((names, task)).encode())
    for leaf in jax.tree.leaves(arrays):
        rounded = np.round(np.asarray(leaf, np.float64), 5) + 0.0  # no negative zeros
        total.update(rounded.astype(np.float32).tobytes())
    return total.hexdigest()


def compile_workcell(model: mujoco.MjModel, name: str, task: Handling | None) -> Workcell:
    """Turn a compiled model into the pytree that the kernels read.

    Raises:
        WorkcellError: a geom the kernels cannot represent, no serial arm, a slide without range.
    """
    layout = find_layout(model, task)
    data = _reference_data(model, layout)
    frames = _joint_frames(model, data, layout)
    geoms = geometry.collision_geoms(model)
    links = {g: _link_of(model, layout, g) for g in geoms}
    flat = [g for g in geoms if model.geom_type[g] == int(mujoco.mjtGeom.mjGEOM_PLANE)]
    movable = [g for g in geoms if _object_of(model, layout, g) >= 0]
    fixed = [g for g in geoms if links[g] < 0 and g not in movable and g not in flat]
    objects = _objects(model, data, layout, movable)
    per_object = [
        [p for p in objects if _object_of(model, layout, p.geom) == k]
        for k in range(len(layout.object_bodies))
    ]
    slots = tuple(
        max([len(_split(ones)[kind]) for ones in per_object], default=0) for kind in (0, 1)
    )
    robot, robot_record = _robot(
        model, data, layout, [g for g in geoms if links[g] >= 0], frames, links, slots
    )
    world = geometry.pose_of([0, 0, 0], [1, 0, 0, 0])
    fixtures = [geometry.primitive(model, data, g, world) for g in fixed]
    pairs = _pairs(model, robot, (fixtures, objects), flat, slots, len(layout.joints) - 1, links)
    planes = np.array([geometry.plane_row(data, g) for g in flat], np.float32).reshape(-1, 4)
    object_shapes = geometry.to_shapes(objects)
    owners = tuple(
        tuple(_object_of(model, layout, p.geom) for p in ones) for ones in _split(objects)
    )
    fixture_record = geometry.to_shapes(fixtures)
    home = home_qpos(model)
    opening = task.gripper.open if task else 0.0
    scene = Scene(
        objects=object_shapes,
        payload=geometry.to_shapes([], *slots),
        opening=jnp.float32(opening),
        payload_support_on=jnp.ones(fixture_record.box_on.size + object_shapes.box_on.size),
    )
    chain = _chain(model, data, layout)
    home_arm = jnp.asarray(home[list(layout.qpos)], jnp.float32)
    digest = _digest(
        (chain, robot_record, fixture_record, planes, pairs, object_shapes, home_arm),
        (layout.joint_names, layout.object_names, owners),
        task,
    )
    boxes = [p.geom for p in fixtures if p.box]
    source = WorkcellSource(
        name=name,
        digest=digest,
        model=model,
        layout=layout,
        task=task,
        owners=owners,
        fixture_bodies=tuple(model.body(model.geom_bodyid[g]).name for g in boxes),
    )
    return Workcell(
        chain=chain,
        robot=robot_record,
        fixtures=fixture_record,
        planes=jnp.asarray(planes),
        objects=object_shapes,
        pairs=pairs,
        scene=scene,
        home=home_arm,
        source=source,
    )
