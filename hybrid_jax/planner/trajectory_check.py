# SPDX-License-Identifier: MIT
"""The final check of a trajectory before it is returned.

It shares no code with the planner: poses and collisions come from C MuJoCo, velocities and
accelerations from differences of the timed points.
"""

# MuJoCo's C functions come without types
# pyright: reportAttributeAccessIssue=false

import copy
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np

from hybrid_jax.types import Trajectory, Workcell
from hybrid_jax.workcell.allowed_collisions import forbidden_contacts
from hybrid_jax.workcell.layout import home_qpos, moved_geoms

MASK_BITS = 10
"""Contact masks with more bits stay as they are: three groups must fit into an integer."""


@dataclass(frozen=True)
class CheckConfig:
    """Conditions on a trajectory."""

    clearance: float = 0.0005
    """Smallest distance between bodies that may not touch, as the engine sees it [m]."""
    max_step: float = 0.02
    """Largest change of a joint between configurations that are checked [rad]."""
    position_tolerance: float = 0.002
    """Position error at a key pose where the trajectory stops [m]."""
    rotation_tolerance: float = 0.0175
    """Rotation error there [rad] (1 deg)."""
    passing_position: float = 0.01
    """Position error at a key pose that a trajectory passes without a stop [m]. It is larger
    because smoothing rounds the corner there."""
    passing_rotation: float = 0.087
    """Rotation error there [rad] (5 deg)."""
    slack: float = 1.01
    """Factor on the velocity and acceleration limits."""
    backend: Literal["fused", "mjx"] = "fused"
    """`mjx`: MJX looks at the configurations as well, beside C MuJoCo and the kernels."""


@dataclass(frozen=True)
class PhaseScene:
    """Scene of a phase, as the engine needs it."""

    poses: np.ndarray
    """`[object, 7]` where the objects lie: position [m], quaternion."""
    opening: float
    """Opening of each finger [m]."""
    held: str | None
    """Name of the object in the gripper; None if there is none."""
    held_in_tool: np.ndarray | None
    """`[7]` its pose in the tool's frame: position [m], quaternion."""
    support: tuple[str, ...]
    """Names of the bodies that it may touch."""


def limit_faults(
    cell: Workcell, trajectory: Trajectory, config: CheckConfig = CheckConfig()
) -> list[str]:
    """Sentences about position, velocity and acceleration limits that are broken.

    Both the stated velocities and accelerations and those that follow from the points must keep
    the limits.
    """
    values = trajectory.times, trajectory.positions, *_stated(trajectory)
    if not all(np.isfinite(a).all() for a in values) or (np.diff(trajectory.times) <= 0).any():
        return ["the trajectory holds numbers that are not finite, or times that do not grow"]
    low, high = np.asarray(cell.joint_limits, float).T
    speed = config.slack * np.asarray(cell.velocity_limits, float)
    rate = config.slack * np.asarray(cell.chain.acceleration_limits, float)
    q, dt = trajectory.positions, np.diff(trajectory.times)[:, None]
    mean_velocity = np.diff(q, axis=0) / dt
    mean_acceleration = np.diff(mean_velocity, axis=0) / ((dt[1:] + dt[:-1]) / 2)
    stated = _stated(trajectory)
    checks = [
        ("position", np.maximum(low - q, q - high) > 1e-4),
        ("velocity", np.abs(stated[0]) > speed),
        ("velocity", np.abs(mean_velocity) > speed),
        ("acceleration", np.abs(stated[1]) > rate),
        ("acceleration", np.abs(mean_acceleration) > rate),
    ]
    faults = [
        f"{kind} limit of {cell.joint_names[j]} broken at {trajectory.times[broken[:, j]][0]:.2f} s"
        for kind, broken in ((k, _padded(b, len(q))) for k, b in checks)
        for j in np.flatnonzero(broken.any(axis=0))
    ]
    return list(dict.fromkeys(faults))


def _stated(trajectory: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    return trajectory.velocities, trajectory.accelerations


def _padded(broken: np.ndarray, count: int) -> np.ndarray:
    return np.concatenate([broken, np.zeros((count - len(broken), broken.shape[1]), bool)])


def checked_points(positions: np.ndarray, max_step: float) -> np.ndarray:
    """Configurations along a joint path, so dense that no joint moves by more than `max_step`.

    Args:
        positions: `[point, joint]` [rad or m].
        max_step: largest change of a joint between neighbours [rad or m].

    Returns:
        `[n, joint]` configurations on the straight lines between the points.
    """
    travelled = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(positions, axis=0)).max(axis=1))])
    count = int(np.ceil(travelled[-1] / max_step)) + 1
    places = np.linspace(0.0, travelled[-1], max(2, count))
    low = np.clip(np.searchsorted(travelled, places, side="right") - 1, 0, len(travelled) - 2)
    share = (places - travelled[low]) / np.maximum(travelled[low + 1] - travelled[low], 1e-12)
    return positions[low] + share[:, None] * (positions[low + 1] - positions[low])


class ConfigurationChecker:
    """Checks single configurations with C MuJoCo; it is not safe for use by several threads."""

    def __init__(self, cell: Workcell, config: CheckConfig = CheckConfig()):
        self.layout, self.config = cell.source.layout, config
        self.model = model = copy.deepcopy(cell.model)
        model.geom_margin[:] = config.clearance  # contacts are reported from this distance on
        model.body_margin[:] = config.clearance  # what the broad phase looks at
        model.pair_margin[:] = config.clearance
        model.geom_gap[:] = model.pair_gap[:] = 0.0
        self.forbidden = forbidden_contacts(model, self.layout)
        self.data = mujoco.MjData(model)
        # doors, grippers and other arms stand where the kernels have them too
        self.data.qpos[:] = home_qpos(model)
        self.masks = model.geom_contype.copy(), model.geom_conaffinity.copy()
        self.robot = np.asarray(moved_geoms(model, self.layout), bool)
        self.qpos, self.joints = self.data.qpos, np.asarray(self.layout.qpos)
        self.fingers = [model.jnt_qposadr[j] for j in self.layout.fingers]

    def enter(self, scene: PhaseScene) -> None:
        """Put the objects and the fingers where they are in a phase; `place` moves the arm."""
        self.scene = scene
        for address, pose in zip(self.layout.object_qpos, scene.poses, strict=True):
            self.qpos[address : address + 7] = pose
        self.qpos[self.fingers] = scene.opening
        names = self.layout.object_names
        self.object = names.index(scene.held) if scene.held else -1
        self.held = np.zeros(7) if scene.held is None else np.asarray(scene.held_in_tool, float)
        self.held_body = self.layout.object_bodies[self.object] if scene.held else -1
        self.moving = self.robot | (self.model.geom_bodyid == self.held_body)
        self._skip_idle_pairs()

    def _skip_idle_pairs(self) -> None:
        """Make the engine skip pairs that never count: static geoms; arm or fingers and payload.

        It would else report an object on its tray at every configuration. The engine tests a pair
        if the contype of one shares a bit with the conaffinity of the other. The lowest two groups
        of bits pair moving geoms with static ones. Only the arm has bits in the third group.
        """
        contype, conaffinity = self.masks
        if max(contype.max(), conaffinity.max()) >> MASK_BITS:
            return
        static, model = ~self.moving, self.model
        model.geom_contype[:] = np.where(self.robot, contype << 2 * MASK_BITS, 0)
        model.geom_contype[static] = (contype | conaffinity << MASK_BITS)[static]
        bits = conaffinity | contype << MASK_BITS
        model.geom_conaffinity[:] = np.where(self.robot, bits | conaffinity << 2 * MASK_BITS, bits)
        model.geom_conaffinity[static] = 0

    def place(self, q: np.ndarray) -> None:
        """Move the arm, and what it holds, to a configuration `[joint]` [rad or m]."""
        self._move(q)
        if self.scene.held:
            self._hang()

    def _move(self, q: np.ndarray) -> None:
        self.qpos[self.joints] = q
        mujoco.mj_kinematics(self.model, self.data)

    def _hang(self) -> None:
        """Move the held object along with the tool."""
        data, site = self.data, self.layout.tool_site
        held, quat = self.held, np.empty(4)
        mujoco.mju_mat2Quat(quat, data.site_xmat[site])
        pose = self.qpos[self.layout.object_qpos[self.object] :][:7]
        mujoco.mju_mulPose(pose[:3], pose[3:], data.site_xpos[site], quat, held[:3], held[3:])
        mujoco.mj_kinematics(self.model, data)

    def collision(self, q: np.ndarray) -> str | None:
        """What touches what in a configuration `[joint]`, in words; None if nothing does."""
        for gap, a, b in self._contacts(q):
            if gap < self.config.clearance:
                relation = "touches" if gap < 0 else "comes too close to"
                return f"{self._named(a)} {relation} {self._named(b)}"
        return None

    def gap(self, q: np.ndarray) -> float:
        """Smallest distance in a configuration `[joint]` [m], cut off at the clearance."""
        return min([self.config.clearance, *(gap for gap, *_ in self._contacts(q))])

    def _contacts(self, q: np.ndarray) -> Iterator[tuple[float, int, int]]:
        """Distance [m] and both geoms of what is near each other and may not touch."""
        self.place(q)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_collision(self.model, self.data)
        if not self.data.ncon:
            return
        contact = self.data.contact
        for (a, b), gap in zip(contact.geom.tolist(), contact.dist.tolist(), strict=True):
            if (self.moving[a] or self.moving[b]) and self._counts(a, b):
                yield gap, a, b

    def _body(self, geom: int) -> str:
        return self.model.body(self.model.geom_bodyid[geom]).name

    def _named(self, geom: int) -> str:
        number = self.model.geom_bodyid[geom]
        return self.model.geom(geom).name or self._body(geom) or f"body #{number}"

    def _counts(self, a: int, b: int) -> bool:
        """Is contact of these two geoms a collision?"""
        carried = [int(self.model.geom_bodyid[g]) == self.held_body for g in (a, b)]
        if not any(carried):
            return bool(self.forbidden[a, b])
        partner = b if carried[0] else a
        return not (self.robot[partner] or self._body(partner) in self.scene.support)

    def position(self, q: np.ndarray) -> np.ndarray:
        """Position of the tool `[3]` [m] in a configuration `[joint]`, whatever the scene."""
        self._move(q)
        return self.data.site_xpos[self.layout.tool_site].copy()

    def turned(self, q: np.ndarray, wanted: np.ndarray) -> float:
        """Angle between the tool, in a configuration `[joint]`, and a quaternion `[4]` [rad]."""
        self._move(q)
        quat, rotation = np.empty(4), np.empty(3)
        mujoco.mju_mat2Quat(quat, self.data.site_xmat[self.layout.tool_site])
        mujoco.mju_subQuat(rotation, quat, np.asarray(wanted, float))
        return float(np.linalg.norm(rotation))


def collision_fault(
    checker: ConfigurationChecker, scene: PhaseScene, positions: np.ndarray
) -> str | None:
    """First collision along a joint path `[point, joint]`, in words; None if there is none."""
    checker.enter(scene)
    for q in checked_points(positions, checker.config.max_step):
        contact = checker.collision(q)
        if contact:
            return contact
    return None


def pose_fault(
    checker: ConfigurationChecker, q: np.ndarray, pose: np.ndarray, name: str
) -> str | None:
    """A sentence if a configuration `[joint]` misses a pose `[7]` [m, quaternion]; else None."""
    distance = float(np.linalg.norm(checker.position(q) - pose[:3]))
    config = checker.config
    turned, most = checker.turned(q, pose[3:]), config.position_tolerance
    return _missed(name, distance, turned, most, config.rotation_tolerance)


def passing_faults(
    checker: ConfigurationChecker, positions: np.ndarray, poses: dict[str, np.ndarray]
) -> list[str]:
    """Sentences about the named poses `[7]` that a joint path `[point, joint]` does not pass."""
    if not poses:
        return []
    path, config = checked_points(positions, checker.config.max_step), checker.config
    tools = np.array([checker.position(q) for q in path])
    way = np.diff(tools, axis=0)
    faults = []
    for name, pose in poses.items():
        # nearest places on the straight lines between the tool's positions
        along = np.sum((pose[:3] - tools[:-1]) * way, axis=1)
        share = np.clip(along / np.maximum(np.sum(way**2, axis=1), 1e-12), 0, 1)[:, None]
        distances = np.linalg.norm(tools[:-1] + share * way - pose[:3], axis=1)
        nearest = int(np.argmin(distances))
        angle = checker.turned(
            path[nearest] + share[nearest] * (path[nearest + 1] - path[nearest]), pose[3:]
        )
        fault = _missed(
            name,
            float(distances[nearest]),
            angle,
            config.passing_position,
            config.passing_rotation,
        )
        faults += [fault] if fault else []
    return faults


def _missed(name: str, away: float, turned: float, most: float, most_turned: float) -> str | None:
    """A sentence if a pose is missed by more than the tolerances [m, rad]; else None."""
    if away <= most and turned <= most_turned:
        return None
    return f"{name} is missed by {1e3 * away:.1f} mm and {np.degrees(turned):.2f} deg"
