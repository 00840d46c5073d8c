# SPDX-License-Identifier: MIT
"""The arm that a planning group of an SRDF means: its last link, and what is held on the way."""

import mujoco
import numpy as np

from hybrid_jax.adopt.semantic_description import Group
from hybrid_jax.errors import UnknownNameError, WorkcellError
from hybrid_jax.workcell.load import compile_spec
from hybrid_jax.workcell.poses import matrix_pose


def group_tip(spec: mujoco.MjSpec, group: Group, name: str) -> str:
    """The last link of a group.

    Args:
        spec: of the robot.
        group: all that the group consists of.
        name: of the group, for messages.

    Raises:
        UnknownNameError: the group's chain names a link that the robot lacks.
        WorkcellError: the group has no link of the robot, or is no single chain.
    """
    links = _links(spec, group)
    if not links:
        raise WorkcellError(f"the group {name!r} has no joint or link of this robot")
    tips = [link for link in links if not any(_is_on_way(link, other) for other in links)]
    if len(tips) > 1:
        raise WorkcellError(
            f"the group {name!r} is no single arm: it ends at "
            f"{', '.join(link.name for link in tips)}; name another group, or the end by --tool"
        )
    return tips[0].name


def hold_other_joints(
    spec: mujoco.MjSpec, group: Group, tip: str, home: dict[str, np.ndarray]
) -> list[str]:
    """Fix the joints on the way to a link that a group does not move.

    Args:
        spec: of the robot, without keyframes; it is changed.
        group: all that the group consists of.
        tip: name of the link.
        home: values of the joints by name, where the held ones stay; those are taken out.

    Returns:
        A sentence for each joint.
    """
    moving = {joint.name for link in _links(spec, group) for joint in link.joints}
    way = _way(_body(spec, tip))
    held = [joint for body in way for joint in body.joints if joint.name not in moving]
    if not held:
        return []
    model = compile_spec(spec)
    data = mujoco.MjData(model)
    for name, value in home.items():
        data.joint(name).qpos[:] = value
    values = {joint.id: data.joint(joint.id).qpos for joint in held}
    for index, value in values.items():
        if model.jnt_limited[index]:
            value[:] = np.clip(value, *model.jnt_range[index])
    mujoco.mj_kinematics(model, data)
    notes = []
    for body in dict.fromkeys(joint.parent for joint in held):
        _place(body, data)
    for joint in held:
        numbers = ", ".join(f"{number:.3g}" for number in values[joint.id])
        notes.append(f"joint {joint.name!r} is held at {numbers}: it is not of the group")
        home.pop(joint.name, None)
        _delete(spec, joint)
    return notes


def _links(spec: mujoco.MjSpec, group: Group) -> list:
    """Bodies of a group: of its links and joints, and of its chains after their first link."""
    bodies = [_body(spec, link) for link in group.links]
    bodies += [spec.joint(joint).parent for joint in group.joints if spec.joint(joint)]
    for base, tip in group.chains:
        way, first = _way(_body(spec, tip)), _body(spec, base)
        bodies += [body for body in way if body != first and not _is_on_way(body, first)]
    return list(dict.fromkeys(body for body in bodies if body.name != "world"))


def _body(spec: mujoco.MjSpec, name: str):
    body = spec.body(name)
    if body is None:
        raise UnknownNameError("link of the robot", name, [b.name for b in spec.bodies if b.name])
    return body


def _way(body) -> list:
    """Bodies from a body up to the world, which is left out."""
    way = []
    while body is not None and body.name != "world":
        way.append(body)
        body = body.parent
    return way


def _is_on_way(body, other) -> bool:
    """Does another body hang on a body, directly or through others?"""
    return body != other and body in _way(other)


def _place(body, data: mujoco.MjData) -> None:
    """Write down a body's pose in its parent as it is in `data`."""
    own, parent = (
        matrix_pose(data.body(b).xpos, data.body(b).xmat) for b in (body.id, body.parent.id)
    )
    relative = parent.inv() * own
    body.pos, body.quat = relative.translation, relative.rotation.as_quat(scalar_first=True)
    body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT


def _delete(spec: mujoco.MjSpec, joint) -> None:
    """Remove a joint, and what acts on it."""
    name = joint.name
    for actuator in [a for a in spec.actuators if a.target == name]:
        spec.delete(actuator)
    for equality in [e for e in spec.equalities if name in (e.name1, e.name2)]:
        spec.delete(equality)
    spec.delete(joint)
