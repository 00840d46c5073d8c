# SPDX-License-Identifier: MIT
"""The last word on a trajectory before it is returned: limits and collision, between points too.

Collision is checked twice: by the kernels, and by C MuJoCo, which shares no code with them.
"""

import mujoco
import numpy as np

from hybrid_jax.planner.timing import densify, path_clearance
from hybrid_jax.skills.task import Task
from hybrid_jax.types import Trajectory, Workcell
from hybrid_jax.workcell.contacts import may_collide
from hybrid_jax.workcell.layout import moved_geoms

MAX_STEP = 0.02
"""Joint distance between checked configurations [rad]."""


def limit_faults(cell: Workcell, trajectory: Trajectory, slack: float = 1.02) -> list[str]:
    """Sentences about joint, velocity and acceleration limits that are broken."""
    low, high = np.asarray(cell.joint_limits).T
    checks = [
        ("position", np.maximum(low - trajectory.positions, trajectory.positions - high) > 1e-4),
        ("velocity", np.abs(trajectory.velocities) > slack * np.asarray(cell.velocity_limits)),
        (
            "acceleration",
            np.abs(trajectory.accelerations) > slack * np.asarray(cell.chain.acceleration_limits),
        ),
    ]
    return [
        f"{kind} limit of {cell.joint_names[j]} broken at {trajectory.times[broken[:, j]][0]:.2f} s"
        for kind, broken in checks
        for j in np.flatnonzero(broken.any(axis=0))
    ]


def engine_collision(
    cell: Workcell,
    q: np.ndarray,
    poses: np.ndarray,
    opening: float,
    held: str | None,
    held_in_tool: np.ndarray | None,
    support: tuple[str, ...],
) -> str | None:
    """First collision that C MuJoCo finds along configurations, in words; None if there is none.

    Args:
        cell: for its model.
        q: `[point, joint]` to check.
        poses: `[object, 7]` where the objects lie.
        opening: of each finger [m].
        held: object in the gripper, or None.
        held_in_tool: `[7]` its pose in the tool's frame.
        support: bodies that the held object may touch.
    """
    model, layout = cell.model, cell.source.layout
    data = mujoco.MjData(model)
    robot = moved_geoms(model, layout)
    for address, pose in zip(layout.object_qpos, poses, strict=True):
        data.qpos[address : address + 7] = pose
    data.qpos[[model.jnt_qposadr[j] for j in layout.fingers]] = opening
    index = layout.object_names.index(held) if held else -1
    held_body = layout.object_bodies[index] if held else -1
    for row in q:
        data.qpos[list(layout.qpos)] = row
        mujoco.mj_kinematics(model, data)
        if held:
            _hang(model, data, layout, index, held_in_tool)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        for contact in data.contact[: data.ncon]:
            fault = _fault(model, contact, robot, held_body, support)
            if fault:
                return fault
    return None


def _hang(model, data, layout, index, held_in_tool) -> None:
    """Put the held object where the tool carries it."""
    turn, address = np.empty(4), layout.object_qpos[index]
    mujoco.mju_mat2Quat(turn, data.site_xmat[layout.tool_site])
    quat, position = np.empty(4), np.empty(3)
    mujoco.mju_mulPose(
        position,
        quat,
        data.site_xpos[layout.tool_site],
        turn,
        np.asarray(held_in_tool[:3], float),
        np.asarray(held_in_tool[3:], float),
    )
    data.qpos[address : address + 7] = np.concatenate([position, quat])
    mujoco.mj_kinematics(model, data)


def _fault(model, contact, robot, held_body, support) -> str | None:
    a, b = contact.geom
    bodies = [int(model.geom_bodyid[g]) for g in (a, b)]
    carried = [body == held_body for body in bodies]
    moving = [bool(robot[g]) or c for g, c in zip((a, b), carried, strict=True)]
    if contact.dist >= 0 or not any(moving) or not may_collide(model, a, b):
        return None
    other = bodies[1] if carried[0] else bodies[0]
    gripped = any(carried) and all(moving)  # fingers and what they hold
    if gripped or (any(carried) and model.body(other).name in support):
        return None
    return f"{model.geom(a).name} touches {model.geom(b).name}"


def collision_faults(
    cell: Workcell,
    trajectory: Trajectory,
    task: Task,
    *,
    carrying: bool,
    opening: float,
    poses: np.ndarray,
    held_in_tool: np.ndarray,
) -> list[str]:
    """Sentences about collisions of a phase: the kernels' verdict, then C MuJoCo's."""
    dense = densify(trajectory.positions, MAX_STEP)
    gap = path_clearance(cell, dense).min()
    faults = [f"clearance falls to {1e3 * gap:.1f} mm"] if gap < 0 else []
    found = engine_collision(
        cell,
        dense,
        poses,
        opening,
        task.object_name if carrying else None,
        held_in_tool if carrying else None,
        task.support,
    )
    return faults + ([found] if found else [])
