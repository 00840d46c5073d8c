# SPDX-License-Identifier: MIT
"""Indices of the arm, the gripper, the objects and the geoms in an `MjModel`."""

from dataclasses import dataclass

import mujoco
import numpy as np

from hybrid_jax.errors import UnknownNameError, WorkcellError
from hybrid_jax.workcell.description import TaskData
from hybrid_jax.workcell.tool_frame import usual_site

_HINGE = int(mujoco.mjtJoint.mjJNT_HINGE)
_MOTION = (_HINGE, int(mujoco.mjtJoint.mjJNT_SLIDE))
_FREE = int(mujoco.mjtJoint.mjJNT_FREE)
_ON_JOINT = int(mujoco.mjtTrn.mjTRN_JOINT)


@dataclass(frozen=True)
class Layout:
    """Indices into an `MjModel`, all tuples, so that a layout can be hashed."""

    joint_names: tuple[str, ...]
    """Names of the arm's joints, from the base to the tool."""
    joint_units: tuple[str, ...]
    """Unit of each arm joint's value: rad of a hinge, m of a slide."""
    unlimited: tuple[bool, ...]
    """Is the arm joint a hinge without limits?"""
    joints: tuple[int, ...]
    """Joints of the arm, from the base to the tool."""
    qpos: tuple[int, ...]
    """Address of each arm joint in `qpos`."""
    dofs: tuple[int, ...]
    """Address of each arm joint in `qvel`."""
    actuators: tuple[int, ...]
    """Actuator of each arm joint; -1 where there is none."""
    tool_site: int
    """Site that is the tool."""
    fingers: tuple[int, ...]
    """Slide joints of the gripper."""
    gripper_actuator: int
    """Actuator of the gripper; -1 where there is none."""
    object_names: tuple[str, ...]
    """Names of the movable objects: those of the task data first, in their order."""
    object_bodies: tuple[int, ...]
    """Body of each object."""
    object_qpos: tuple[int, ...]
    """First of the seven addresses of each object in `qpos`."""


def _name(model, kind, index) -> str:
    return mujoco.mj_id2name(model, kind, index) or f"#{index}"


def body_path(model: mujoco.MjModel, body: int) -> list[int]:
    """Bodies from the child of the world down to `body`."""
    path = []
    while body:
        path.append(body)
        body = int(model.body_parentid[body])
    return path[::-1]


def body_joints(model: mujoco.MjModel, body: int) -> range:
    """Joints of one body."""
    first = int(model.body_jntadr[body])
    return range(first, first + int(model.body_jntnum[body])) if first >= 0 else range(0)


def _find_tool(model: mujoco.MjModel, task: TaskData | None, tool: str) -> int:
    names = [model.site(i).name for i in range(model.nsite)]
    site = tool or (task.tool_site if task else "") or usual_site(names)
    if site in names:
        return names.index(site)
    raise UnknownNameError("tool site", site, names)


def _arm_joints(model: mujoco.MjModel, tool: int) -> tuple[int, ...]:
    path = body_path(model, int(model.site_bodyid[tool]))
    joints = tuple(j for body in path for j in body_joints(model, body))
    for j in joints:
        if model.jnt_type[j] not in _MOTION:
            raise WorkcellError(
                f"joint {_name(model, mujoco.mjtObj.mjOBJ_JOINT, j)!r} on the way to the tool is "
                "neither a hinge nor a slide: only serial arms are supported"
            )
    if not joints:
        raise WorkcellError(f"no joint moves the tool site {model.site(tool).name!r}")
    return joints


_EQ = mujoco.mjtEq


def _refuse_couplings(model: mujoco.MjModel, joints: tuple[int, ...]) -> None:
    """Refuse an active equality that couples joints of the arm or closes a chain.

    The kernels move every joint by itself. Couplings within the gripper do not matter.

    Raises:
        WorkcellError: there is one; the message names what it couples.
    """
    links = _links(model, joints)
    for e in np.flatnonzero(model.eq_active0):
        kind = int(model.eq_type[e])
        first, second = int(model.eq_obj1id[e]), int(model.eq_obj2id[e])
        if kind == _EQ.mjEQ_JOINT:
            arm_joints = [j for j in (first, second) if j in joints]
            labels = " and ".join(
                repr(_name(model, mujoco.mjtObj.mjOBJ_JOINT, j)) for j in (first, second) if j >= 0
            )
            if arm_joints:
                raise WorkcellError(
                    f"an equality couples the joints {labels} on the way to the tool: every joint "
                    "of the arm must move by itself; replace the coupled joint by a fixed link, or "
                    "leave the equality out"
                )
        elif kind in (_EQ.mjEQ_CONNECT, _EQ.mjEQ_WELD):
            # the same constraint may be given by two sites instead of two bodies
            of_site = model.eq_objtype[e] == mujoco.mjtObj.mjOBJ_SITE
            bodies = [int(model.site_bodyid[i]) if of_site else i for i in (first, second)]
            if links[bodies[0]] != links[bodies[1]]:
                names = [_name(model, mujoco.mjtObj.mjOBJ_BODY, b) for b in bodies]
                raise WorkcellError(
                    f"an equality ties {names[0]!r} to {names[1]!r}, which the arm moves against "
                    "each other: closed chains are not supported"
                )


def _links(model: mujoco.MjModel, joints: tuple[int, ...]) -> np.ndarray:
    """`[body]` number of the last of the given joints on the way to it; -1 where there is none."""
    number_of = {int(model.jnt_bodyid[j]): number for number, j in enumerate(joints)}
    links = np.full(model.nbody, -1)
    for body in range(1, model.nbody):
        links[body] = number_of.get(body, links[model.body_parentid[body]])
    return links


def _joint_actuator(model: mujoco.MjModel, joint: int) -> int:
    """Actuator that drives a joint directly; -1 where there is none."""
    for a in range(model.nu):
        on_joint = model.actuator_trntype[a] == _ON_JOINT
        if on_joint and model.actuator_trnid[a, 0] == joint:
            return a
    return -1


def _named(model, kind, what: str, name: str) -> int:
    index = mujoco.mj_name2id(model, kind, name)
    if index < 0:
        names = [_name(model, kind, i) for i in range(_count(model, kind))]
        raise UnknownNameError(what, name, names)
    return index


def _count(model, kind) -> int:
    counts = {
        mujoco.mjtObj.mjOBJ_JOINT: model.njnt,
        mujoco.mjtObj.mjOBJ_ACTUATOR: model.nu,
        mujoco.mjtObj.mjOBJ_BODY: model.nbody,
    }
    return counts[kind]


def find_layout(model: mujoco.MjModel, task: TaskData | None, tool: str = "") -> Layout:
    """Tell arm, gripper and movable objects apart.

    Args:
        model: of the cell.
        task: its data, if it has any.
        tool: site or link that is the tool; as the task data say, or a usual name, if empty.

    Raises:
        WorkcellError, UnknownNameError: no tool frame, no serial arm, or a name in the task data
            that the model does not have.
    """
    site = _find_tool(model, task, tool)
    joints = _arm_joints(model, site)
    _refuse_couplings(model, joints)
    free = [
        b
        for b in range(1, model.nbody)
        if any(model.jnt_type[j] == _FREE for j in body_joints(model, b))
    ]
    if task:
        names = [spec.name for spec in task.objects]
        free = [_named(model, mujoco.mjtObj.mjOBJ_BODY, "object", n) for n in names] + [
            b for b in free if model.body(b).name not in names
        ]
        for name in task.fixture_names:
            _named(model, mujoco.mjtObj.mjOBJ_BODY, "fixture", name)
    gripper = task.gripper if task else None
    return Layout(
        joint_names=tuple(_name(model, mujoco.mjtObj.mjOBJ_JOINT, j) for j in joints),
        joint_units=tuple("rad" if model.jnt_type[j] == _HINGE else "m" for j in joints),
        unlimited=tuple(
            bool(model.jnt_type[j] == _HINGE and not model.jnt_limited[j]) for j in joints
        ),
        joints=joints,
        qpos=tuple(int(model.jnt_qposadr[j]) for j in joints),
        dofs=tuple(int(model.jnt_dofadr[j]) for j in joints),
        actuators=tuple(_joint_actuator(model, j) for j in joints),
        tool_site=site,
        fingers=tuple(
            _named(model, mujoco.mjtObj.mjOBJ_JOINT, "gripper joint", n)
            for n in (gripper.joints if gripper else ())
        ),
        gripper_actuator=_named(
            model, mujoco.mjtObj.mjOBJ_ACTUATOR, "gripper actuator", gripper.actuator
        )
        if gripper
        else -1,
        object_names=tuple(_name(model, mujoco.mjtObj.mjOBJ_BODY, b) for b in free),
        object_bodies=tuple(free),
        object_qpos=tuple(int(model.jnt_qposadr[body_joints(model, b)[0]]) for b in free),
    )


def geom_links(model: mujoco.MjModel, layout: Layout) -> np.ndarray:
    """Link that carries each geom: the index of the last arm joint on the way to it.

    Returns:
        `[geom]`, -1 where the arm does not move the geom. Gripper and fingers are on a link too.
    """
    return _links(model, layout.joints)[model.geom_bodyid]


def moved_geoms(model: mujoco.MjModel, layout: Layout) -> np.ndarray:
    """Geoms that the arm moves: `[geom]`, True where it does."""
    return geom_links(model, layout) >= 0


def home_qpos(model: mujoco.MjModel) -> np.ndarray:
    """Home of the whole cell, `qpos` `[nq]`.

    It is the keyframe `home`, else the first keyframe, else the reference configuration `qpos0`.
    """
    names = [model.key(i).name for i in range(model.nkey)]
    if names:
        return model.key_qpos[names.index("home") if "home" in names else 0].copy()
    return model.qpos0.copy()
