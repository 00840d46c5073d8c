# SPDX-License-Identifier: MIT
"""What `benchmarks.latency` measures inside of fresh processes.

    python -m benchmarks.latency_process {plans,second-cell,new-cells,soak} ...

Each prints one JSON object.
"""

import json
import resource
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import tyro

BEGAN = time.perf_counter()


def _count_compiles() -> list[str]:
    """A list that grows by one with each program that XLA compiles or loads from now on."""
    import jax

    compiled: list[str] = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda event, *_, **__: compiled.append(event) if "backend_compile" in event else None
    )
    return compiled


def _timed(function: Callable):
    began = time.perf_counter()
    value = function()
    return value, time.perf_counter() - began


def plans(run: Path, first: int = 0, count: int = 100) -> None:
    """Seconds of loading a run, of its first plan, and of plans after it.

    Args:
        run: folder of the run.
        first: number of the first task, of those of `seeds.LATENCY`.
        count: plans after the first.
    """
    import jax

    from hybrid_jax.planner.pipeline import plan_motion
    from hybrid_jax.runs.load_planner import load_planner
    from hybrid_jax.runs.run_folder import open_run
    from hybrid_jax.runs.seeds import LATENCY
    from hybrid_jax.tasks.registry import random_task

    imported = time.perf_counter() - BEGAN
    planner, load = _timed(lambda: load_planner(open_run(run)))
    seconds, statuses = [], []
    for seed in LATENCY[first : first + count + 1]:
        task, key = random_task(planner.cell, seed), jax.random.key(seed)
        result, took = _timed(partial(plan_motion, planner, task, key=key))
        seconds.append(took)
        statuses.append(result.status.name)
    timed = {"imported": imported, "load": load, "seconds": seconds}
    print(json.dumps(timed | {"statuses": statuses}))


def _moved_cell(cell, geom: str, by: tuple[float, float, float]):
    """The same cell with one geom moved [m]: another cell of its class."""
    import copy

    from hybrid_jax.workcell.compile import compile_workcell

    model = copy.copy(cell.model)
    model.geom_pos[model.geom(geom).id] += by
    return compile_workcell(model, f"{cell.source.name} with {geom} moved", cell.source.task)


def second_cell() -> None:
    """Programs that a second cell of a class traces, and seconds of its first plan."""
    import jax

    from hybrid_jax.planner.pipeline import plan_motion
    from hybrid_jax.runs.load_planner import untrained_planner
    from hybrid_jax.runs.seeds import LATENCY
    from hybrid_jax.runtime.kept_programs import traced
    from hybrid_jax.tasks.registry import random_task
    from hybrid_jax.workcell.load import load_workcell

    def plan(cell):
        planner = untrained_planner(cell, 0.1)
        return [
            plan_motion(planner, random_task(cell, seed), key=jax.random.key(seed)).status.name
            for seed in LATENCY[:3]
        ]

    first = load_workcell("gen3_handling")
    plan(first)
    before = len(traced)
    second = _moved_cell(first, "post_front_left", (0.03, 0.0, 0.0))
    statuses, took = _timed(lambda: plan(second))
    print(json.dumps({"traced": traced[before:], "seconds": took, "statuses": statuses}))


def new_cells(folder: Path, every: int = 25, first: int = 0) -> None:
    """Seconds of the first motion in each of several cells, one cell a problem.

    Args:
        folder: of the Panda's problems, see `mbm_cells`.
        every, first: which of each scene's problems.
    """
    import jax

    from benchmarks.mbm_cells import read_problems
    from hybrid_jax.planner.point_to_point import plan_joint_motion
    from hybrid_jax.runtime.kept_programs import traced

    seconds, statuses = [], []
    for problem in read_problems(folder, every, first):
        plan = partial(plan_joint_motion, problem.cell, problem.start, problem.goal)
        result, took = _timed(partial(plan, key=jax.random.key(problem.number)))
        seconds.append(took)
        statuses.append(result.status.name)
    print(json.dumps({"seconds": seconds, "statuses": statuses, "traced": traced}))


def soak(run: Path, count: int = 1000, largest: int = 40) -> None:
    """Plan in batches of changing sizes and scenes, and watch what the process holds.

    Args:
        run: folder of the run.
        count: plans altogether.
        largest: tasks of the largest batch.
    """
    import jax
    import numpy as np

    from hybrid_jax.planner.pipeline import plan_batch
    from hybrid_jax.runs.load_planner import load_planner
    from hybrid_jax.runs.run_folder import open_run
    from hybrid_jax.runs.seeds import LATENCY
    from hybrid_jax.tasks.registry import random_task

    planner, rng = load_planner(open_run(run)), np.random.default_rng(0)
    compiled, rows, done = _count_compiles(), [], 0
    while done < count:
        size = min(int(rng.integers(1, largest + 1)), count - done)
        tasks = [random_task(planner.cell, seed) for seed in LATENCY[done : done + size]]
        before = len(compiled)
        results, took = _timed(partial(plan_batch, planner, tasks, key=jax.random.key(done)))
        done += size
        rows.append(
            {
                "size": size,
                "seconds": took,
                "compiles": len(compiled) - before,
                "ok": sum(result.status.name == "OK" for result in results),
                "resident_mb": _resident(),
            }
        )
    maps = len(Path("/proc/self/maps").read_text().splitlines())
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(json.dumps({"batches": rows, "maps": maps, "peak_mb": peak}))


def _resident() -> float:
    """Memory that this process holds [MB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 2**20


if __name__ == "__main__":
    parts = {"plans": plans, "second-cell": second_cell, "new-cells": new_cells, "soak": soak}
    tyro.extras.subcommand_cli_from_dict(parts)
