# SPDX-License-Identifier: MIT
"""Make a simulated arm follow a hand: mink's differential inverse kinematics within the limits."""

import mink
import numpy as np
from scipy.spatial.transform import RigidTransform

from hybrid_jax.types import Workcell
from hybrid_jax.workcell.geometry import as_row, matrix_pose
from hybrid_jax.workcell.layout import home_qpos


class Follower:
    """An arm whose tool is led by a hand; only the arm moves, free of the cell's walls."""

    def __init__(self, cell: Workcell, rate: float):
        """Start at home.

        Args:
            cell: the work cell.
            rate: calls of `follow` per second.
        """
        model, layout = cell.model, cell.source.layout
        self._site = layout.tool_site
        self._rate = rate
        self._configuration = mink.Configuration(model, home_qpos(model))
        self._task = mink.FrameTask(
            model.site(self._site).name, "site",
            position_cost=1.0, orientation_cost=0.5, lm_damping=1e-3,
        )  # fmt: skip
        speeds = {
            name: float(speed)
            for name, speed in zip(layout.joint_names, cell.chain.velocity_limits, strict=True)
        }
        self._limits = [mink.ConfigurationLimit(model), mink.VelocityLimit(model, speeds)]
        others = sorted(set(range(model.nv)) - set(layout.dofs))
        self._still = [mink.DofFreezingTask(model, others)] if others else []

    @property
    def qpos(self) -> np.ndarray:
        """Configuration of the whole cell `[nq]`."""
        return self._configuration.q

    @property
    def pose(self) -> np.ndarray:
        """`[7]` pose of the tool."""
        data = self._configuration.data
        return as_row(matrix_pose(data.site_xpos[self._site], data.site_xmat[self._site]))

    def reset(self, qpos: np.ndarray) -> None:
        """Go on from another configuration of the whole cell `[nq]`."""
        self._configuration.update(qpos)

    def follow(self, hand: RigidTransform) -> np.ndarray:
        """Move towards the hand for one period; returns the tool's pose `[7]` then."""
        self._task.set_target(mink.SE3.from_matrix(hand.as_matrix()))
        velocity = mink.solve_ik(
            self._configuration, [self._task], 1 / self._rate, solver="daqp", damping=1e-6,
            limits=self._limits, constraints=self._still,
        )  # fmt: skip
        self._configuration.integrate_inplace(velocity, 1 / self._rate)
        return self.pose
