# SPDX-License-Identifier: MIT
"""The last word on a trajectory before it is returned.

It shares no code with what plans: C MuJoCo for poses and collisions, differences of the timed
points for velocities and accelerations.
"""

import copy
from dataclasses import dataclass

import mujoco
import numpy as np

from hybrid_jax.types import Trajectory, Workcell
from hybrid_jax.workcell.contacts import forbidden_contacts
from hybrid_jax.workcell.layout import home_qpos, moved_geoms

MASK_BITS = 10
"""Bits of a contact mask of the model that are told apart: three times so many fit an integer."""


@dataclass(frozen=True)
class CheckConfig:
    """What a trajectory must keep."""

    clearance: float = 0.0005
    """Distance that the engine must see between what may not touch [m]."""
    max_step: float = 0.02
    """Joint distance between configurations that are checked [rad]."""
    position_tolerance: float = 0.002
    """Of a key pose [m], ..."""
    rotation_tolerance: float = 0.0175
    """... [rad] (1 deg)."""
    passing_position: float = 0.01
    """Of a key pose that a trajectory passes without a stop [m], ..."""
    passing_rotation: float = 0.087
    """... [rad] (5 deg): smoothing rounds the corner."""
    slack: float = 1.01
    """Factor on the velocity and acceleration limits."""


@dataclass(frozen=True)
class PhaseScene:
    """What the engine has to know about a phase."""

    poses: np.ndarray
    """`[object, 7]` where the objects lie."""
    opening: float
    """Of each finger [m]."""
    held: str | None
    """Object in the gripper, ..."""
    held_in_tool: np.ndarray | None
    """... its pose `[7]` in the tool's frame, ..."""
    support: tuple[str, ...]
    """... and the bodies that it may touch."""


def limit_faults(
    cell: Workcell, trajectory: Trajectory, config: CheckConfig = CheckConfig()
) -> list[str]:
    """Sentences about joint, velocity and acceleration limits that are broken.

    The stated velocities and accelerations count, and those that follow from the points.
    """
    numbers = trajectory.times, trajectory.positions, *_stated(trajectory)
    if not all(np.isfinite(a).all() for a in numbers) or (np.diff(trajectory.times) <= 0).any():
        return ["the trajectory holds numbers that are not finite, or times that do not grow"]
    low, high = np.asarray(cell.joint_limits, float).T
    speed = config.slack * np.asarray(cell.velocity_limits, float)
    rate = config.slack * np.asarray(cell.chain.acceleration_limits, float)
    q, dt = trajectory.positions, np.diff(trajectory.times)[:, None]
    mean = np.diff(q, axis=0) / dt
    change = np.diff(mean, axis=0) / ((dt[1:] + dt[:-1]) / 2)
    stated = _stated(trajectory)
    checks = [
        ("position", np.maximum(low - q, q - high) > 1e-4),
        ("velocity", np.abs(stated[0]) > speed),
        ("velocity", np.abs(mean) > speed),
        ("acceleration", np.abs(stated[1]) > rate),
        ("acceleration", np.abs(change) > rate),
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
    """Configurations along a trajectory, `max_step` apart, whatever its speed."""
    way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(positions, axis=0)).max(axis=1))])
    count = int(np.ceil(way[-1] / max_step)) + 1
    at = np.linspace(0.0, way[-1], max(2, count))
    low = np.clip(np.searchsorted(way, at, side="right") - 1, 0, len(way) - 2)
    share = (at - way[low]) / np.maximum(way[low + 1] - way[low], 1e-12)
    return positions[low] + share[:, None] * (positions[low + 1] - positions[low])


class Engine:
    """C MuJoCo as the judge of configurations. One at a time uses it."""

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
        """Put the objects and the fingers where they are in a phase."""
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
        """Let the engine skip pairs that never count: of what stands still, of fingers and payload.

        It would report an object on its tray at every configuration. The masks of what stands still
        are asked by what moves alone; the arm asks its own masks in bits that the payload lacks.
        """
        kind, mask = self.masks
        if max(kind.max(), mask.max()) >> MASK_BITS:
            return
        still, model = ~self.moving, self.model
        model.geom_contype[:] = np.where(self.robot, kind << 2 * MASK_BITS, 0)
        model.geom_contype[still] = (kind | mask << MASK_BITS)[still]
        asks = mask | kind << MASK_BITS
        model.geom_conaffinity[:] = np.where(self.robot, asks | mask << 2 * MASK_BITS, asks)
        model.geom_conaffinity[still] = 0

    def place(self, q: np.ndarray) -> None:
        """Put the arm, and what it holds, in a configuration."""
        self._move(q)
        if self.scene.held:
            self._hang()

    def _move(self, q: np.ndarray) -> None:
        self.qpos[self.joints] = q
        mujoco.mj_kinematics(self.model, self.data)

    def _hang(self) -> None:
        data, site = self.data, self.layout.tool_site
        held, turn = self.held, np.empty(4)
        mujoco.mju_mat2Quat(turn, data.site_xmat[site])
        pose = self.qpos[self.layout.object_qpos[self.object] :][:7]
        mujoco.mju_mulPose(pose[:3], pose[3:], data.site_xpos[site], turn, held[:3], held[3:])
        mujoco.mj_kinematics(self.model, data)

    def collision(self, q: np.ndarray) -> str | None:
        """What touches what in a configuration, in words; None if nothing does."""
        self.place(q)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_collision(self.model, self.data)
        count = self.data.ncon
        if not count:
            return None
        pairs = self.data.contact.geom[:count]
        near = np.flatnonzero(self.moving[pairs[:, 0]] | self.moving[pairs[:, 1]])
        for (a, b), gap in zip(pairs[near], self.data.contact.dist[near], strict=True):
            if gap < self.config.clearance and self._counts(int(a), int(b)):
                names = [self.model.geom(g).name or self._named_body(g) for g in (a, b)]
                how = "touches" if gap < 0 else "comes too close to"
                return f"{names[0]} {how} {names[1]}"
        return None

    def _body(self, geom: int) -> str:
        return self.model.body(self.model.geom_bodyid[geom]).name

    def _named_body(self, geom: int) -> str:
        return self._body(geom) or f"body #{self.model.geom_bodyid[geom]}"

    def _counts(self, a: int, b: int) -> bool:
        """Must these two not touch?"""
        carried = [int(self.model.geom_bodyid[g]) == self.held_body for g in (a, b)]
        if not any(carried):
            return bool(self.forbidden[a, b])
        other = b if carried[0] else a
        return not (self.robot[other] or self._body(other) in self.scene.support)

    def position(self, q: np.ndarray) -> np.ndarray:
        """Of the tool [m], whatever the scene."""
        self._move(q)
        return self.data.site_xpos[self.layout.tool_site].copy()

    def turned(self, q: np.ndarray, wanted: np.ndarray) -> float:
        """Angle between the tool and a quaternion [rad], whatever the scene."""
        self._move(q)
        turn, way = np.empty(4), np.empty(3)
        mujoco.mju_mat2Quat(turn, self.data.site_xmat[self.layout.tool_site])
        mujoco.mju_subQuat(way, turn, np.asarray(wanted, float))
        return float(np.linalg.norm(way))


def pose_row(pose: np.ndarray) -> np.ndarray:
    """`[7]` position [m] and quaternion of a unit dual quaternion `[8]`."""
    pose = np.asarray(pose, float)
    back, dual = np.empty(4), np.empty(4)
    mujoco.mju_negQuat(back, pose[:4])
    mujoco.mju_mulQuat(dual, pose[4:], back)
    return np.concatenate([2 * dual[1:], pose[:4]])


def collision_fault(engine: Engine, scene: PhaseScene, positions: np.ndarray) -> str | None:
    """First collision along a joint path `[point, joint]` in words; None if there is none."""
    engine.enter(scene)
    for q in checked_points(positions, engine.config.max_step):
        found = engine.collision(q)
        if found:
            return found
    return None


def pose_fault(engine: Engine, q: np.ndarray, pose: np.ndarray, name: str) -> str | None:
    """A sentence if a configuration misses a pose `[7]` (position [m], quaternion); else None."""
    away = float(np.linalg.norm(engine.position(q) - pose[:3]))
    config = engine.config
    return _missed(
        name, away, engine.turned(q, pose[3:]),
        config.position_tolerance, config.rotation_tolerance,
    )  # fmt: skip


def passing_faults(
    engine: Engine, positions: np.ndarray, poses: dict[str, np.ndarray]
) -> list[str]:
    """Sentences about the named poses `[7]` that a joint path `[point, joint]` does not pass."""
    if not poses:
        return []
    path, config = checked_points(positions, engine.config.max_step), engine.config
    tools = np.array([engine.position(q) for q in path])
    way = np.diff(tools, axis=0)
    faults = []
    for name, pose in poses.items():
        # nearest places on the straight lines between the tool's positions
        along = np.sum((pose[:3] - tools[:-1]) * way, axis=1)
        share = np.clip(along / np.maximum(np.sum(way**2, axis=1), 1e-12), 0, 1)[:, None]
        away = np.linalg.norm(tools[:-1] + share * way - pose[:3], axis=1)
        at = int(np.argmin(away))
        turned = engine.turned(path[at] + share[at] * (path[at + 1] - path[at]), pose[3:])
        fault = _missed(
            name, float(away[at]), turned,
            config.passing_position, config.passing_rotation,
        )  # fmt: skip
        faults += [fault] if fault else []
    return faults


def _missed(name: str, away: float, turned: float, most: float, most_turned: float) -> str | None:
    if away <= most and turned <= most_turned:
        return None
    return f"{name} is missed by {1e3 * away:.1f} mm and {np.degrees(turned):.2f} deg"
