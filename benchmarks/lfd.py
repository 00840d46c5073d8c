# SPDX-License-Identifier: MIT
"""RL-LfD: maps against CartesianDMP on real demonstrations, the DQN against the exact optimum.

    python -m benchmarks.lfd --json FILE --picture FILE.png

The real demonstrations (RoboTasks, five tasks, nine demonstrations each) are no part of the
project: `--demonstrations` says where they lie; without them the figures that need them are left
out, and it is said. CartesianDMP comes from `movement_primitives` (extra `bench`).
"""

import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from benchmarks import lfd_learning, lfd_maps, lfd_missing
from benchmarks.report import metric, write
from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.runs.load_planner import read_library
from hybrid_jax.skills.mapping import map_skills

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data" / "robotasks"


def mapping_seconds(repeats: int = 50) -> list[dict]:
    """20 skills x 1,000 segments of 100 way points, compiled; the median of the calls."""
    library = read_library()
    rng = np.random.default_rng(0)
    ends = dq.exp(jnp.asarray(rng.normal(scale=0.4, size=(2, 1000, 6)), jnp.float32))
    skills = library.poses[:20, :100]
    run = jax.jit(map_skills)
    jax.block_until_ready(run(skills, *ends))
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        jax.block_until_ready(run(skills, *ends))
        times.append(time.perf_counter() - began)
    return [
        metric("lfd.map_20x1000_seconds", float(np.median(times)), "s", "lower", "100 way points")
    ]


def main(
    json: Path | None = None,
    picture: Path | None = None,
    demonstrations: Path = SHARED,
    tiny: bool = False,
) -> None:
    """Print all figures.

    Args:
        json: file to write them to.
        picture: learning curve to draw.
        demonstrations: folder of the RoboTasks files.
        tiny: as little of everything as shows that it runs.
    """
    metrics = lfd_learning.figures(picture, lfd_learning.TINY if tiny else lfd_learning.Sizes())
    metrics += mapping_seconds(2 if tiny else 50)
    if tiny:
        print("tiny: the real demonstrations are left out")
    elif demonstrations.is_dir():
        demos = lfd_maps.load_demonstrations(demonstrations)
        metrics += lfd_maps.figures(demos)
        metrics += lfd_missing.figures(demos)
    else:
        print(f"real demonstrations are absent ({demonstrations}): figures that need them left out")
    write(metrics, json, lfd_learning.DRAWN)


if __name__ == "__main__":
    tyro.cli(main)
