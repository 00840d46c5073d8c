# SPDX-License-Identifier: MIT
"""From one configuration to another: no demonstration, no training.

The motion is found by RRT-Connect, shortened, smoothed, timed within the limits, proven free
between its points, and checked once more by C MuJoCo.

    python examples/04_joint_motion.py
"""

import jax
import numpy as np

import hybrid_jax as hj


def main() -> None:
    """Plan a motion and print what it is like."""
    cell = hj.load_workcell("fpi")
    start = np.asarray(cell.home)
    goal = start + np.array([1.2, 0.3, -0.2, 0.0, 0.2, 0.5], np.float32)
    plan = hj.plan_joint_motion(cell, start, goal, key=jax.random.key(0))
    print(f"{plan.status.name}: {plan.detail}")
    if not plan.phases:
        return
    motion = plan.phases[0]
    speeds = np.abs(motion.velocities).max(axis=0) / np.asarray(cell.velocity_limits)
    print(f"{len(motion.times)} points in {motion.times[-1]:.2f} s")
    for name, share in zip(cell.joint_names, speeds, strict=True):
        print(f"  {name:12s} moves at up to {share:4.0%} of its fastest")


if __name__ == "__main__":
    main()
