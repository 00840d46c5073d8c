# SPDX-License-Identifier: MIT
"""A feasibility map: which tool poses the arm can reach, and why not the others.

python examples/03_feasibility_map.py
"""

from collections import Counter

import jax.numpy as jnp
import numpy as np

import hybrid_jax as hj
from hybrid_jax.feasibility.evaluation import Reason
from hybrid_jax.kernels import dualquat as dq


def main() -> None:
    """Build a coarse map, count the reasons, and ask it about one pose."""
    cell = hj.load_workcell("gen3_handling")
    config = hj.MapConfig(spacing=0.25, tilts=(0.0,), yaws=(0.0,), batch=256)
    fmap = hj.build_feasibility_map(cell, config)
    reasons = Counter(Reason(code).name for code in np.asarray(fmap.reason).ravel())
    for name, count in reasons.most_common():
        print(f"{count:5d} poses  {name}")
    down = jnp.array([0.0, 1.0, 0.0, 0.0])  # the tool points down
    wanted = dq.from_parts(jnp.array([0.45, 0.0, 0.9]), down)
    value, _ = hj.query(fmap, wanted)
    nearest = hj.nearest_feasible(fmap, wanted)
    print(
        f"at {np.round(dq.position(wanted), 2)} m feasibility is {float(value):.2f}; the nearest "
        f"feasible pose of the grid is at {np.round(dq.position(nearest), 2)} m"
    )


if __name__ == "__main__":
    main()
