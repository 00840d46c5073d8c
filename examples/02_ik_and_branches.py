# SPDX-License-Identifier: MIT
"""Inverse kinematics from many seeds: every branch of the arm that reaches a pose.

python examples/02_ik_and_branches.py
"""

import jax
import numpy as np

import hybrid_jax as hj


def main() -> None:
    """Print the distinct solutions for one tool pose, with their clearances."""
    cell = hj.load_workcell("fpi")
    pose = hj.tool_pose(cell, cell.home)
    config = hj.IkConfig(seeds=64)
    result = hj.solve_ik(cell, pose, config=config, key=jax.random.key(0))
    branches = np.asarray(result.branches)[np.asarray(result.branch_distinct)]
    gaps = jax.vmap(lambda q: hj.clearance(cell, q))(branches)
    print(f"{len(branches)} branches bring the tool to where it is at home:")
    for q, gap in sorted(zip(branches, np.asarray(gaps), strict=True), key=lambda row: -row[1]):
        state = f"{1e3 * gap:4.0f} mm from everything" if gap > 0 else "collides"
        print("  " + " ".join(f"{x:6.2f}" for x in q) + f" rad  {state}")
    print(f"the one nearest to home misses the pose by {float(result.position_error):.0e} m")


if __name__ == "__main__":
    main()
