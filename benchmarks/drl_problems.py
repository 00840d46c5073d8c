# SPDX-License-Identifier: MIT
"""Segments for the joint agent: to train on, to be tested on, and pairs of the whole work space.

The test takes infeasible segments of tasks that nothing was tuned on, those that RRT-Connect
solves: an agent that fails on one of them fails on something that can be done.
"""

from dataclasses import asdict, dataclass
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from hybrid_jax.contracts import Segments, take
from hybrid_jax.envs.segments import free_pairs, join
from hybrid_jax.errors import RunFolderError
from hybrid_jax.feasibility.building import build_feasibility_map
from hybrid_jax.planner.infeasible_segments import harvest
from hybrid_jax.planner.lfd import optimal_chooser
from hybrid_jax.planner.rrt_connect import plan_paths
from hybrid_jax.runs.load_planner import read_library
from hybrid_jax.runs.presets import DEFAULT, SMOKE
from hybrid_jax.runs.seeds import BENCHMARK_TRAINING, JOINT_AGENT_TEST
from hybrid_jax.runtime import artifacts
from hybrid_jax.runtime.progress import Progress
from hybrid_jax.types import Workcell, pytree

SEEDS = {"BENCHMARK_TRAINING": BENCHMARK_TRAINING, "JOINT_AGENT_TEST": JOINT_AGENT_TEST}
"""Ranges that the tasks are drawn from."""
HELD_OUT = 500
"""Segments of the test."""


@dataclass(frozen=True)
class Sizes:
    """How much is collected."""

    training: int = 100
    """Tasks to train on."""
    held_out: int = HELD_OUT
    """Segments of the test, ..."""
    together: int = 30
    """... collected from so many tasks at a time."""


TINY = Sizes(training=4, held_out=8, together=4)


@pytree
class Problems:
    """What the agents of the benchmark train and are tested on."""

    training: Segments
    """Infeasible segments of 100 random tasks."""
    everywhere: Segments
    """Random pairs of free configurations, each in the scene of a training segment."""
    held_out: Segments
    """Infeasible segments of unseen tasks, all solvable."""


def collect(cell: Workcell, scale: float, first: int, count: int) -> Segments:
    """Infeasible segments of `count` random tasks."""
    return harvest(
        cell,
        read_library(),
        optimal_chooser,
        DEFAULT.planner.skills,
        DEFAULT.planner.first_look,
        scale,
        tasks=range(first, first + count),
        seed=0,
        progress=Progress("collect", "tasks"),
    )


def rrt_paths(cell: Workcell, segments: Segments, batch: int = 64) -> list[np.ndarray | None]:
    """RRT-Connect's path of each segment; None where it found none."""
    count, found = segments.start.shape[0], []
    for low in range(0, count, batch):
        index = np.minimum(np.arange(low, low + batch), count - 1)  # one shape, one program
        part = take(segments, index)
        found += plan_paths(cell, part.scene, part.start, part.goal, key=jax.random.key(low))
    return found[:count]


def unseen(cell: Workcell, scale: float, sizes: Sizes) -> Segments:
    """The segments of the test."""
    parts, found, tried, first = [], 0, 0, JOINT_AGENT_TEST.start
    while found < sizes.held_out:
        segments = collect(cell, scale, first, sizes.together)
        good = np.array([path is not None for path in rrt_paths(cell, segments)])
        parts.append(take(segments, np.flatnonzero(good)))
        found, tried, first = found + int(good.sum()), tried + len(good), first + sizes.together
    tasks = first - JOINT_AGENT_TEST.start
    print(f"held out: {found} of {tried} segments of {tasks} tasks are solvable")
    return take(join(parts), slice(sizes.held_out))


def draw(cell: Workcell, sizes: Sizes) -> Problems:
    """All of them, from scratch."""
    # the scale is drawn from random configurations: any grid will do
    scale = float(build_feasibility_map(cell, SMOKE.map).manipulability_scale)
    training = collect(cell, scale, BENCHMARK_TRAINING.start, sizes.training)
    return Problems(training, free_pairs(cell, training), unseen(cell, scale, sizes))


def problems(cell: Workcell, file: Path | None, sizes: Sizes = Sizes()) -> Problems:
    """From a file if it is there, else from scratch (and into the file).

    Raises:
        RunFolderError: the file is of other seeds or sizes.
    """
    drawn = {name: [some.start, some.stop] for name, some in SEEDS.items()} | asdict(sizes)
    if file and file.is_file():
        header, state = artifacts.load(file, "problems", cell.source.digest)
        if header.get("drawn") != drawn:
            raise RunFolderError(
                f"{file} holds problems of {header.get('drawn')}, not of {drawn}: choose another "
                "file, or remove it"
            )
        template = Problems(*[Segments(cell.scene, cell.home, cell.home)] * 3)
        found = artifacts.restore(template, state, str(file), batched=True)
        return jax.tree.map(jnp.asarray, found)
    found = draw(cell, sizes)
    if file:
        artifacts.save(file, "problems", cell.source.digest, found, drawn=drawn)
    return found
