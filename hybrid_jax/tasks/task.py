# SPDX-License-Identifier: MIT
"""Tasks: ordered key poses of the tool, and what the gripper does between them."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from hybrid_jax.errors import TaskError
from hybrid_jax.kernels.kinematics import tool_pose
from hybrid_jax.types import Workcell
from hybrid_jax.workcell.poses import as_row, dual_quats, pose_row


@dataclass(frozen=True)
class Hold:
    """How an object is held while it is carried."""

    in_tool: np.ndarray
    """`[7]` pose of the object in the tool's frame: position [m], quaternion."""
    opening: float
    """Opening of each finger around the object [m]."""
    support: tuple[str, ...] = ()
    """Fixtures that the held object may touch: it is lifted from the first and put on the last."""


@dataclass(frozen=True)
class Task:
    """Do something with one object. Segment i leads from key pose i to i + 1."""

    object_name: str
    """Name of the object."""
    object_poses: np.ndarray
    """`[object, 7]` where every object of the cell lies: position [m], quaternion."""
    key_poses: np.ndarray
    """`[K, 8]` tool poses in order, unit dual quaternions; the first is where the tool is now."""
    carrying: tuple[bool, ...]
    """`[K - 1]` True for segments on which the object is held."""
    start: np.ndarray
    """`[joint]` configuration in which the arm stands [rad or m]."""
    end: np.ndarray | None = None
    """`[joint]` configuration to end in [rad or m]; None for any that has the last key pose. It is
    reached up to whole turns of hinges whose range is a turn or more."""
    stops: tuple[int, ...] = ()
    """Inner key poses at which the arm comes to rest though the gripper does not move. Inner key
    poses are met exactly only at rest."""
    transit: bool = False
    """Does the first segment only lead from where the arm stands to key pose 1? Such a segment
    needs no demonstration: the arm moves freely."""
    tool_speeds: tuple[float, ...] = ()
    """`[K - 1]` highest speed of the tool on each segment [m/s]; empty for no limit."""
    hold: Hold | None = None
    """How the object is held; None where nothing is carried."""
    opening: float | None = None
    """Opening of each finger while nothing is held [m]; None for the gripper's own, or that of the
    keyframe `home` where the cell's data name no gripper."""

    @property
    def phases(self) -> list[tuple[int, int]]:
        """Runs of segments from rest to rest, as (first key pose, last key pose)."""
        held, count = self.carrying, len(self.carrying)
        cuts = {i for i in range(1, count) if held[i] != held[i - 1]} | {0, count, *self.stops}
        cuts = sorted(cuts)
        return list(zip(cuts[:-1], cuts[1:], strict=True))

    @property
    def given(self) -> slice:
        """Slice of the key poses that are set with the task.

        The others follow: the first is where the tool is now, and where the task ends in a given
        configuration, the last is the tool pose there.
        """
        return slice(1, len(self.key_poses) - (self.end is not None))

    @property
    def shown(self) -> tuple[np.ndarray, tuple[bool, ...]]:
        """Key poses `[pose, 8]` and carrying flags `[pose - 1]` that skills must cover.

        They are those of the whole task but for a transit.
        """
        first = int(self.transit)
        return self.key_poses[first:], self.carrying[first:]

    @property
    def placed_pose(self) -> np.ndarray:
        """Pose of the carried object when it is let go: `[7]` position [m], quaternion."""
        release = pose_row(self.key_poses[1 + int(np.flatnonzero(self.carrying)[-1])])
        position, quat = np.empty(3), np.empty(4)
        in_tool = self.require_hold().in_tool
        mujoco.mju_mulPose(position, quat, release[:3], release[3:], in_tool[:3], in_tool[3:])
        return np.concatenate([position, quat])

    def require_hold(self) -> Hold:
        """How the object is held.

        Raises:
            TaskError: something is carried, but the task does not say how it is held.
        """
        if self.hold is None:
            raise TaskError(f"{self.object_name!r} is carried, but the task has no `hold`")
        return self.hold

    def tool_speed(self, phase: int) -> float:
        """Highest speed of the tool in a phase [m/s]: the lowest limit of its segments."""
        low, high = self.phases[phase]
        return min(self.tool_speeds[low:high], default=np.inf)


def yaw_of(pose: np.ndarray) -> float:
    """Heading of a body's x axis [rad], from the body's pose `[7]`: position [m], quaternion."""
    x = Rotation.from_quat(pose[3:], scalar_first=True).apply([1.0, 0.0, 0.0])
    return float(np.arctan2(x[1], x[0]))


def upright(position, yaw: float) -> RigidTransform:
    """Pose that is turned about the vertical only.

    Args:
        position: `[3]` [m].
        yaw: heading of the x axis [rad].
    """
    return RigidTransform.from_components(
        np.asarray(position, float), Rotation.from_euler("z", yaw)
    )


def home_pose(cell: Workcell) -> np.ndarray:
    """Tool pose of the arm at home, as a unit dual quaternion `[8]`."""
    return np.asarray(tool_pose(cell, cell.home))


def as_rows(poses: np.ndarray) -> np.ndarray:
    """Positions [m] and quaternions `[pose, 7]` of unit dual quaternions `[pose, 8]`."""
    transforms = [RigidTransform.from_dual_quat(p.astype(float), scalar_first=True) for p in poses]
    return np.stack([as_row(pose) for pose in transforms])


def as_dual_quats(poses: Sequence[RigidTransform]) -> np.ndarray:
    """Unit dual quaternions `[pose, 8]` of SciPy's poses, in float32."""
    return dual_quats(np.stack([as_row(pose) for pose in poses]))


def start_of(cell: Workcell, start: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Configuration in which a task begins, and the tool pose there.

    A start of the wrong shape is kept, for the planner to refuse.

    Args:
        cell: of the task.
        start: `[joint]` [rad or m]; home if None.

    Returns:
        Configuration `[joint]` and tool pose `[8]`; that of home where the shape is wrong.
    """
    start = np.asarray(cell.home if start is None else start, np.float32)
    if start.shape != cell.home.shape:
        return start, home_pose(cell)
    return start, np.asarray(tool_pose(cell, start))
