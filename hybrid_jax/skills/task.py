# SPDX-License-Identifier: MIT
"""Tasks: ordered key poses with what the gripper does between them."""

from collections.abc import Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels.kinematics import tool_pose
from hybrid_jax.types import Workcell
from hybrid_jax.workcell.geometry import as_row


@dataclass(frozen=True)
class Task:
    """Do something with one object. Segment i leads from key pose i to i + 1."""

    object_name: str
    """Which object."""
    object_poses: np.ndarray
    """`[object, 7]` where every object of the cell lies."""
    key_poses: np.ndarray
    """`[K, 8]` tool poses, in order; the first is where the tool is now."""
    carrying: tuple[bool, ...]
    """`[K - 1]` True for segments on which the object is held."""
    start: np.ndarray
    """`[joint]` configuration in which the arm stands [rad]."""
    end: np.ndarray | None = None
    """`[joint]` configuration to end in [rad], up to whole turns of joints that can stand in one
    place with two readings; None for any that has the last key pose."""
    stops: tuple[int, ...] = ()
    """Inner key poses at which the arm comes to rest though the gripper does not move: only there
    they are met exactly."""
    transit: bool = False
    """Does the first segment only lead from wherever the arm stands to key pose 1? No demonstration
    is asked for it: the joint agent moves freely."""
    tool_speeds: tuple[float, ...] = ()
    """`[K - 1]` most that the tool may move on each segment [m/s]; empty for no limit."""
    support: tuple[str, ...] = ()
    """Fixtures that the held object may touch: it is lifted from or put on them."""
    grasp: int = 0
    """Which of the object's grasps is used."""

    @property
    def phases(self) -> list[tuple[int, int]]:
        """Runs of segments from rest to rest, as (first key pose, last key pose)."""
        held, last = self.carrying, len(self.carrying)
        cuts = {i for i in range(1, last) if held[i] != held[i - 1]} | {0, last, *self.stops}
        cuts = sorted(cuts)
        return list(zip(cuts[:-1], cuts[1:], strict=True))

    @property
    def given(self) -> slice:
        """Key poses that whoever sets the task chooses: all but where the tool is now, and where an
        end that is given as a configuration leads."""
        return slice(1, len(self.key_poses) - (self.end is not None))

    @property
    def shown(self) -> tuple[np.ndarray, tuple[bool, ...]]:
        """Key poses and carrying flags of what skills must cover: all but a transit."""
        first = int(self.transit)
        return self.key_poses[first:], self.carrying[first:]

    def tool_speed(self, phase: int) -> float:
        """Most that the tool may move in a phase [m/s]."""
        low, high = self.phases[phase]
        return min(self.tool_speeds[low:high], default=np.inf)


def yaw_of(pose: np.ndarray) -> float:
    """Heading of a body's x axis [rad] from its pose `[7]`."""
    x = Rotation.from_quat(pose[3:], scalar_first=True).apply([1.0, 0.0, 0.0])
    return float(np.arctan2(x[1], x[0]))


def upright(position, yaw: float) -> RigidTransform:
    """Pose turned about the vertical only."""
    return RigidTransform.from_components(
        np.asarray(position, float), Rotation.from_euler("z", yaw)
    )


def home_pose(cell: Workcell) -> np.ndarray:
    """Tool pose `[8]` of the arm at home."""
    return np.asarray(tool_pose(cell, cell.home))


def as_rows(poses: np.ndarray) -> np.ndarray:
    """`[pose, 7]` position [m] and quaternion, from `[pose, 8]`."""
    found = [RigidTransform.from_dual_quat(p.astype(float), scalar_first=True) for p in poses]
    return np.stack([as_row(pose) for pose in found])


def as_dual_quats(poses: Sequence[RigidTransform]) -> np.ndarray:
    """`[pose, 8]`."""
    rows = np.stack([as_row(pose) for pose in poses]).astype(np.float32)
    return np.asarray(dq.from_parts(jnp.asarray(rows[:, :3]), jnp.asarray(rows[:, 3:])))


def start_of(cell: Workcell, start: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Where a task begins: configuration (home if None) and tool pose `[8]`.

    A start of the wrong shape is kept, for the planner to refuse.
    """
    start = np.asarray(cell.home if start is None else start, np.float32)
    if start.shape != cell.home.shape:
        return start, home_pose(cell)
    return start, np.asarray(tool_pose(cell, start))
