# SPDX-License-Identifier: MIT
"""A skill from one demonstration, mapped to ends that were never shown.

python examples/05_teach_and_map_a_skill.py
"""

import jax.numpy as jnp
import numpy as np

import hybrid_jax as hj
from hybrid_jax.demonstrations.demonstration import Demonstration
from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.skills.mapping import map_skills


def arc() -> Demonstration:
    """Somebody carries the tool over an obstacle: half a circle in two seconds."""
    share = np.linspace(0.0, 1.0, 200)
    x, z = 0.4 - 0.15 * np.cos(np.pi * share), 0.2 + 0.15 * np.sin(np.pi * share)
    turn = np.tile([0.0, 1.0, 0.0, 0.0], (share.size, 1))
    poses = np.column_stack([x, np.zeros_like(x), z, turn])
    return Demonstration("over", times=2.0 * share, poses=poses, gripper=np.ones_like(share))


def main() -> None:
    """Print where the mapped skill begins, is highest, and ends."""
    library = hj.build_library([arc()])
    down = jnp.array([0.0, 1.0, 0.0, 0.0])
    starts = dq.from_parts(jnp.array([[0.3, -0.2, 0.1]]), down[None])
    goals = dq.from_parts(jnp.array([[0.5, 0.3, 0.15]]), down[None])
    path = map_skills(library.poses[:1], starts, goals)[0, 0]
    places = np.asarray(dq.position(path))
    print(f"skill {library.names[0]!r}: {len(places)} poses")
    for what, row in (("begins", 0), ("is highest", places[:, 2].argmax()), ("ends", -1)):
        print(f"  {what:10s} at {np.round(places[row], 3)} m")


if __name__ == "__main__":
    main()
