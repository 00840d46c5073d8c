# SPDX-License-Identifier: MIT
"""Plans and policies for other programs: JointTrajectory as JSON or CSV, TP programs, StableHLO."""

from hybrid_jax.export.files import write_plan
from hybrid_jax.export.policies import export_policy
from hybrid_jax.export.trajectories import to_joint_trajectory, write_json

__all__ = ["export_policy", "to_joint_trajectory", "write_json", "write_plan"]
