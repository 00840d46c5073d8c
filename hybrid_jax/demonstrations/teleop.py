# SPDX-License-Identifier: MIT
"""Make a simulated arm follow a hand, by mink's differential inverse kinematics with limits."""

import mink
import numpy as np
from scipy.spatial.transform import RigidTransform

from hybrid_jax.types import Workcell
from hybrid_jax.workcell.layout import home_qpos
from hybrid_jax.workcell.poses import as_row, matrix_pose


class Follower:
    """An arm whose tool follows a hand. Only the arm moves, and nothing in the cell stops it."""

    def __init__(self, cell: Workcell, rate: float):
        """Put the arm at home.

        Args:
            cell: the work cell.
            rate: calls of `follow` per second.
        """
        model, layout = cell.model, cell.source.layout
        self._site = layout.tool_site
        self._rate = rate
        self._configuration = mink.Configuration(model, home_qpos(model))
        self._task = mink.FrameTask(
            model.site(self._site).name,
            "site",
            position_cost=1.0,
            orientation_cost=0.5,
            lm_damping=1e-3,
        )
        speeds = {
            name: float(speed)
            for name, speed in zip(layout.joint_names, cell.chain.velocity_limits, strict=True)
        }
        self._limits = [mink.ConfigurationLimit(model), mink.VelocityLimit(model, speeds)]
        fixed_dofs = sorted(set(range(model.nv)) - set(layout.dofs))
        self._still = [mink.DofFreezingTask(model, fixed_dofs)] if fixed_dofs else []

    @property
    def qpos(self) -> np.ndarray:
        """Configuration of the whole cell, MuJoCo's `qpos` `[nq]`."""
        return self._configuration.q

    @property
    def pose(self) -> np.ndarray:
        """Pose of the tool `[7]`: position [m], quaternion."""
        data = self._configuration.data
        return as_row(matrix_pose(data.site_xpos[self._site], data.site_xmat[self._site]))

    def reset(self, qpos: np.ndarray) -> None:
        """Go on from another configuration.

        Args:
            qpos: `[nq]` of the whole cell.
        """
        self._configuration.update(qpos)

    def follow(self, hand: RigidTransform) -> np.ndarray:
        """Move the tool towards the hand for one period.

        Args:
            hand: pose that the tool is to reach.

        Returns:
            Pose of the tool after the period, `[7]`: position [m], quaternion.
        """
        self._task.set_target(mink.SE3.from_matrix(hand.as_matrix()))
        velocity = mink.solve_ik(
            self._configuration,
            [self._task],
            1 / self._rate,
            solver="daqp",
            damping=1e-6,
            limits=self._limits,
            constraints=self._still,
        )
        self._configuration.integrate_inplace(velocity, 1 / self._rate)
        return self.pose
