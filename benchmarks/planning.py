# SPDX-License-Identifier: MIT
"""The hybrid planner on random handling tasks, against its parts, its switches and OMPL.

    python -m benchmarks.planning --json FILE

OMPL comes with the extra `bench`; without it its rows are left out, and it is said. About a quarter
of an hour on two cores, more than half of it training and compiling.
"""

import importlib.util
import time
from collections import Counter
from dataclasses import asdict
from pathlib import Path

import jax
import numpy as np
import tyro

import hybrid_jax as hj
from benchmarks import ompl_batch
from benchmarks.planning_figures import headline, rows_of
from benchmarks.planning_measures import measure
from benchmarks.planning_methods import (
    SWITCH_TEST,
    Method,
    methods,
    switch_optimality,
    trained_run,
)
from benchmarks.report import metric, write
from hybrid_jax.contracts import PlanResult
from hybrid_jax.planner.lfd import skill_path
from hybrid_jax.planner.phase_scenes import phase_scene, segment_kinds
from hybrid_jax.planner.pipeline import plan_batch
from hybrid_jax.planner.records import Planner
from hybrid_jax.planner.trajectory_check import (
    CheckConfig,
    ConfigurationChecker,
    collision_fault,
    limit_faults,
)
from hybrid_jax.runs.load_planner import load_planner
from hybrid_jax.runs.seeds import PLANNING_BATCHES, PLANNING_TEST, PLANNING_WARM_UP, SWITCHING_TEST
from hybrid_jax.tasks.registry import random_task
from hybrid_jax.tasks.task import Task
from hybrid_jax.types import Status, Workcell

FINER = CheckConfig(clearance=0.0, max_step=0.005, slack=1.0)
"""The check after the check: four times as dense, nothing beyond the limits."""


def rejected(cell: Workcell, engine: ConfigurationChecker, task: Task, plan: PlanResult) -> int:
    """Trajectories of a plan that the finer check rejects."""
    kinds, count = segment_kinds(task), 0
    for (low, _), phase in zip(task.phases, plan.phases, strict=True):
        scene = phase_scene(cell, task, int(kinds[low]))
        fault = collision_fault(engine, scene, phase.positions)
        count += bool(limit_faults(cell, phase, FINER) or fault)
    return count


def ompl(planner: Planner) -> dict[str, Method]:
    """The rival, or nothing where it is not installed."""
    try:
        from hybrid_jax.baselines.ompl_tasks import OmplTasks
    except ImportError as error:
        print(
            f"{error.name} is not installed: its rows are left out "
            "(pip install 'hybrid_jax[bench]')"
        )
        return {}
    return {"ompl": OmplTasks(planner.cell, planner.config).plan}


def trial(plan: Method, planner: Planner, task: Task, number: int) -> dict:
    """One task by one method."""
    shown = skill_path(planner.library, task, planner.choose, planner.config.skills).poses
    began = time.perf_counter()
    result = plan(task, jax.random.key(number))
    seconds = time.perf_counter() - began
    row = {
        "ok": result.status is Status.OK,
        "status": result.status.name,
        "seconds": seconds,
        "detail": result.detail,
        "result": result,
    }
    return row | (asdict(measure(planner.cell, task, result, shown)) if row["ok"] else {})


def compare(
    planner: Planner, methods_module: dict[str, Method], tasks: list[Task], warm: int
) -> tuple[list[dict], dict[str, list[dict]]]:
    """All methods, each compiled on tasks of its own first."""
    cell, found, table = planner.cell, [], {}
    for name, plan in methods_module.items():
        for number in range(warm):
            plan(random_task(cell, PLANNING_WARM_UP[number]), jax.random.key(number))
        table[name] = [trial(plan, planner, task, i) for i, task in enumerate(tasks)]
        found += rows_of(name, table[name])
        print(f"{name}: {sum(r['ok'] for r in table[name])} of {len(tasks)}", flush=True)
        failures = Counter(r["detail"] for r in table[name] if not r["ok"])
        for detail, count in failures.most_common(3):
            print(f"    {count}: {detail}")
    return found, table


def batch(planner: Planner, count: int, size: int) -> list[dict]:
    """Rate of batches of so many tasks; trajectories returned and rejected by the finer check."""
    cell = planner.cell
    engine, checked, bad, rates = ConfigurationChecker(cell, FINER), 0, 0, []
    for first in range(0, count, size):
        tasks = [random_task(cell, PLANNING_BATCHES[first + i]) for i in range(size)]
        began = time.perf_counter()
        results = plan_batch(planner, tasks, key=jax.random.key(first))
        rates.append(size / (time.perf_counter() - began))
        for task, result in zip(tasks, results, strict=True):
            checked += len(result.phases)
            bad += rejected(cell, engine, task, result) if result.phases else 0
        print(f"batch of {size}: {rates[-1]:.1f} plans/s, {bad} of {checked} rejected", flush=True)
    return [
        metric(
            "planning.batch_plans_per_second",
            float(np.median(rates[1:] or rates)),
            "1/s",
            "higher",
            f"{size} tasks; median of {len(rates)} batches but the first, which "
            f"compiles; best {max(rates):.1f}",
        ),
        metric(
            "planning.rejected",
            bad,
            "1",
            "lower",
            f"of {checked} returned trajectories, by a check four times as dense",
        ),
    ]


def ompl_rate(workcell: str, warm: int, count: int, ours: float) -> list[dict]:
    """OMPL's rate on tasks of a batch, beside ours; nothing where it is not installed."""
    if importlib.util.find_spec("ompl") is None:
        return []
    rate, solved = ompl_batch.plans_per_second(
        workcell, PLANNING_WARM_UP[:warm], PLANNING_BATCHES[:count]
    )
    return [
        metric(
            "planning.ompl_batch_plans_per_second",
            rate,
            "1/s",
            "higher",
            f"{count} of the same tasks, a process on each core; solved {solved:.3f}",
        ),
        metric(
            "planning.batch_vs_ompl",
            ours / rate,
            "1",
            "higher",
            "plans/s of a batch, both on all cores",
        ),
    ]


def main(
    json: Path | None = None,
    run: Path | None = None,
    tasks: int = 200,
    batched: int = 512,
    tiny: bool = False,
) -> None:
    """Print all figures.

    Args:
        json: file to write them to.
        run: folder of a trained run of the handling cell; one is trained if not given.
        tasks: random tasks of the comparison.
        batched: tasks that are planned in batches of 256; 3,500 for 10^4 trajectories.
        tiny: as little of everything as shows that it runs.
    """
    hj.use_all_cores()
    tasks, batched, size, warm, unseen = (
        (2, 4, 4, 1, 2) if tiny else (tasks, batched, 256, 10, SWITCH_TEST)
    )
    drawn = {
        "PLANNING_TEST": PLANNING_TEST,
        "PLANNING_BATCHES": PLANNING_BATCHES,
        "SWITCHING_TEST": SWITCHING_TEST,
    }
    with trained_run(run, tiny) as opened:
        planner = load_planner(opened)
        some = [random_task(opened.cell, seed) for seed in PLANNING_TEST[:tasks]]
        methods_module = methods(opened, planner) | ompl(planner)
        found, table = compare(planner, methods_module, some, warm)
        switch = switch_optimality(planner, opened.preset.switch, unseen)
        found += headline(switch, table)
        write(found, json, drawn)
        found += batch(planner, batched, size)
        rate = next(m for m in found if m["key"] == "planning.batch_plans_per_second")["value"]
        found += ompl_rate(opened.workcell, warm, min(batched, size), rate)
    write(found, json, drawn)


if __name__ == "__main__":
    tyro.cli(main)
