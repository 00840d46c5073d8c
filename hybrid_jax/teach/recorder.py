# SPDX-License-Identifier: MIT
"""The recorder, without a page: an arm that follows a hand, and samples of its motion."""

import numpy as np

from hybrid_jax.demonstrations.demonstration import Demonstration
from hybrid_jax.demonstrations.teleop import Follower
from hybrid_jax.types import Workcell
from hybrid_jax.workcell.poses import pose_of

RATE = 30.0
"""Samples, and updates of the arm, per second."""


class Recorder:
    """Lets the arm follow the hand, and samples pose and gripper while it records.

    Time is the simulated arm's: one period for each call of `tick`, however long the page took.
    """

    def __init__(self, cell: Workcell, robot: str):
        """Start at home, gripper open.

        Args:
            cell: the work cell.
            robot: kind of robot, as noted in the recording.
        """
        self.cell, self.robot = cell, robot
        self.closed = False
        self.recording = False
        self._follower = Follower(cell, RATE)
        self._rows: list[tuple] = []

    @property
    def samples(self) -> int:
        """Number of samples of the present or last recording."""
        return len(self._rows)

    @property
    def tool(self) -> np.ndarray:
        """Tool pose `[7]`: position [m], quaternion."""
        return self._follower.pose

    @property
    def qpos(self) -> np.ndarray:
        """Configuration of the whole cell `[nq]`, the fingers open or closed as the gripper is."""
        qpos = np.array(self._follower.qpos)
        task, layout = self.cell.source.task, self.cell.source.layout
        if task is not None and layout.fingers:
            addresses = self.cell.model.jnt_qposadr[list(layout.fingers)]
            qpos[addresses] = 0.0 if self.closed else task.gripper.open
        return qpos

    def tick(self, hand: np.ndarray) -> None:
        """Follow the hand's pose `[7]` for one period, and keep a sample while recording."""
        tool = self._follower.follow(pose_of(hand[:3], hand[3:]))
        if self.recording:
            self._rows.append((tool, float(self.closed), np.array(self.qpos)))

    def start(self) -> None:
        """Begin a recording; the last one is lost if it was not saved."""
        self._rows, self.recording = [], True

    def stop(self) -> None:
        """Stop recording."""
        self.recording = False

    def demonstration(self, name: str, note: str = "") -> Demonstration:
        """The recording, from the first to the last motion of tool or gripper.

        Args:
            name: of the demonstration.
            note: about it, for people.

        Returns:
            Times `[sample]` [s], poses `[sample, 7]` and gripper `[sample]` (1 closed); empty
            where nothing was recorded.
        """
        if not self._rows:
            return Demonstration(name, np.zeros(0), np.zeros((0, 7)), np.zeros(0))
        poses, gripper = (np.array(c) for c in list(zip(*self._rows, strict=True))[:2])
        low, high = _active(poses, gripper)
        motion = slice(low, high + 1)
        times = np.arange(high + 1 - low) / RATE
        return Demonstration(
            name,
            times,
            poses[motion],
            gripper[motion],
            robot=self.robot,
            note=note,
        )

    def frames(self) -> list[np.ndarray]:
        """Configurations `[nq]` of the whole cell, one for each sample, for a replay."""
        return [row[2] for row in self._rows]


def _active(poses: np.ndarray, gripper: np.ndarray) -> tuple[int, int]:
    """Indices of the motion's first and last sample; a hand pauses before and after it."""
    step = np.abs(np.diff(poses, axis=0)).max(axis=1) > 1e-5
    moving = np.flatnonzero(step | (np.diff(gripper) != 0))
    return (int(moving[0]), int(moving[-1]) + 1) if moving.size else (0, len(poses) - 1)
