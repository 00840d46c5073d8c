# SPDX-License-Identifier: MIT
"""A cell of your own: an arm in MJCF, what is wrong with it, and a motion in it.

python examples/08_own_cell.py
"""

import tempfile
from pathlib import Path

import jax
import numpy as np

import hybrid_jax as hj
from hybrid_jax.workcell.diagnosis import diagnose

LINK = """
<body name="{name}" pos="{pos}">
  <joint name="{name}" axis="{axis}" range="-2.8 2.8"/>
  <geom type="capsule" fromto="0 0 0.05 0 0 0.25" size="0.04"/>
  {inner}
</body>"""


def arm() -> str:
    """Three links beside a wall, the tool at the end of the last."""
    inner = '<site name="tool" pos="0 0 0.3"/>'
    for name, axis in (("wrist", "0 1 0"), ("elbow", "0 1 0"), ("shoulder", "0 0 1")):
        pos = "0 0 0.1" if name == "shoulder" else "0 0 0.3"
        inner = LINK.format(name=name, pos=pos, axis=axis, inner=inner)
    wall = '<geom name="wall" type="box" pos="0.35 0 0.3" size="0.02 0.2 0.3"/>'
    return f'<mujoco><compiler angle="radian"/><worldbody>{wall}{inner}</worldbody></mujoco>'


def main() -> None:
    """Write the cell to a file, check it, and plan around the wall."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "own_cell.xml"
        path.write_text(arm())
        for finding in diagnose(path):
            print(f"{finding.level}: {finding.text}")
        cell = hj.load_workcell(path)
    print(
        f"joints: {', '.join(cell.joint_names)}; clearance at home: "
        f"{1e3 * float(hj.clearance(cell, cell.home)):.0f} mm"
    )
    start, goal = np.array([-1.2, 1.0, 0.4]), np.array([1.2, 1.0, 0.4])
    plan = hj.plan_joint_motion(cell, start, goal, key=jax.random.key(0))
    print(f"{plan.status.name}: {plan.detail}")


if __name__ == "__main__":
    main()
