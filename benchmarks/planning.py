# SPDX-License-Identifier: MIT
"""The hybrid planner on random handling tasks, against its parts, its switches and OMPL.

    python -m benchmarks.planning --json FILE

OMPL comes with the extra `bench`; without it its rows are left out, and it is said. About a quarter
of an hour on two cores, half of it training and compiling.
"""

import time
from collections import Counter
from dataclasses import asdict
from pathlib import Path

import jax
import numpy as np
import tyro

import hybrid_jax as hj
from benchmarks.planning_measures import measure
from benchmarks.planning_methods import Learned, Method, learn, methods
from benchmarks.report import metric, write
from hybrid_jax.planner.checking import CheckConfig, Engine, collision_fault, limit_faults
from hybrid_jax.planner.lfd import skill_path
from hybrid_jax.planner.pipeline import plan_batch
from hybrid_jax.planner.records import Planner, PlanResult
from hybrid_jax.planner.scenes import phase_scene, segment_kinds
from hybrid_jax.seeds import PLANNING_BATCHES, PLANNING_TEST, PLANNING_WARM_UP
from hybrid_jax.skills.task import Task
from hybrid_jax.skills.tasks import random_task
from hybrid_jax.types import Source, Status, Workcell
from hybrid_jax.workcell.load import load_workcell

FINER = CheckConfig(clearance=0.0, max_step=0.005, slack=1.0)
"""The check after the check: four times as dense, nothing beyond the limits."""


def rejected(cell: Workcell, engine: Engine, task: Task, plan: PlanResult) -> int:
    """Trajectories of a plan that the finer check rejects."""
    kinds, count = segment_kinds(task), 0
    for (low, _), phase in zip(task.phases, plan.phases, strict=True):
        scene = phase_scene(cell, task, int(kinds[low]))
        fault = collision_fault(engine, scene, phase.positions)
        count += bool(limit_faults(cell, phase, FINER) or fault)
    return count


def ompl(learned: Learned) -> dict[str, Method]:
    """The rival, or nothing where it is not installed."""
    try:
        from hybrid_jax.planner.ompl_tasks import OmplTasks  # noqa: PLC0415
    except ImportError as error:
        print(f"{error.name} is not installed: its rows are left out "
              "(pip install 'hybrid_jax[bench]')")  # fmt: skip
        return {}
    return {"ompl": OmplTasks(learned.planner).plan}


def trial(plan: Method, planner: Planner, task: Task, number: int) -> dict:
    """One task by one method."""
    shown = skill_path(planner.library, task, planner.choose, planner.config.skills).poses
    began = time.perf_counter()
    result = plan(task, jax.random.key(number))
    seconds = time.perf_counter() - began
    row = {"ok": result.status is Status.OK, "status": result.status.name, "seconds": seconds,
           "detail": result.detail, "result": result}  # fmt: skip
    return row | (asdict(measure(planner.cell, task, result, shown)) if row["ok"] else {})


def rows_of(name: str, rows: list[dict]) -> list[dict]:
    """Figures of one method."""
    good = [r for r in rows if r["ok"]]
    times = np.array([r["seconds"] for r in rows])
    causes = Counter(r["status"] for r in rows if not r["ok"])
    found = [
        metric(f"planning.{name}_success", len(good) / len(rows), "1", "higher",
               f"{len(rows)} tasks; failures: {dict(causes) or 'none'}"),
        metric(f"planning.{name}_seconds", float(np.median(times)), "s", "lower",
               f"median; p95 {np.quantile(times, 0.95):.3f}, p99 {np.quantile(times, 0.99):.3f}"),
    ]  # fmt: skip
    if not good:
        return found
    mean = {key: float(np.mean([r[key] for r in good])) for key in
            ("length", "duration", "jerk", "tilt", "approach")}  # fmt: skip
    units = {"length": "rad", "duration": "s", "jerk": "rad/s^3", "tilt": "deg", "approach": "deg"}
    found += [metric(f"planning.{name}_{key}", value, units[key], "lower", "mean of solved tasks")
              for key, value in mean.items()]  # fmt: skip
    least = min(r["clearance"] for r in good)
    found.append(metric(f"planning.{name}_clearance", least, "m", "higher", "smallest of all"))
    shares = [r["result"].shares for r in good]
    for source in Source:
        share = float(np.mean([s[source] for s in shares]))
        if share and name != "ompl":
            found.append(metric(f"planning.{name}_share_{source.name.lower()}", share, "1",
                                "higher", "share of way points"))  # fmt: skip
    return found


def compare(
    learned: Learned, tasks: list[Task], warm: int
) -> tuple[list[dict], dict[str, list[dict]]]:
    """All methods, each compiled on tasks of its own first."""
    cell, found, table = learned.planner.cell, [], {}
    for name, plan in (methods(learned) | ompl(learned)).items():
        for number in range(warm):
            plan(random_task(cell, PLANNING_WARM_UP[number]), jax.random.key(number))
        table[name] = [trial(plan, learned.planner, task, i) for i, task in enumerate(tasks)]
        found += rows_of(name, table[name])
        print(f"{name}: {sum(r['ok'] for r in table[name])} of {len(tasks)}", flush=True)
        failures = Counter(r["detail"] for r in table[name] if not r["ok"])
        for detail, count in failures.most_common(3):
            print(f"    {count}: {detail}")
    return found, table


def headline(learned: Learned, table: dict[str, list[dict]]) -> list[dict]:
    """The figures of the issue that follow from the comparison."""
    own = table["hybrid"]
    seams = np.array([r["seam"] for r in own if r["ok"] and np.isfinite(r["seam"])] or [np.nan])
    times = np.array([r["seconds"] for r in own])
    found = [
        metric("planning.seconds_median", float(np.median(times)), "s", "lower", "one task"),
        metric("planning.seconds_p99", float(np.quantile(times, 0.99)), "s", "lower", "one task"),
        metric("planning.seam_step_ratio", float(seams.max()), "1", "lower",
               f"worst of all; median {np.median(seams):.2f}, p95 {np.quantile(seams, 0.95):.2f}"),
        metric("planning.switch_optimality", float(learned.optimality.mean()), "1", "higher",
               f"{len(learned.optimality)} unseen phases; worst {learned.optimality.min():.3f}"),
    ]  # fmt: skip
    found.append(metric("planning.switch_rule_optimality", float(learned.rule.mean()), "1",
                        "higher", "of the rule in its place, on the same phases"))  # fmt: skip
    if "ompl" in table:
        both = [(a, b) for a, b in zip(own, table["ompl"], strict=True) if b["ok"]]
        pairs = [(a, b) for a, b in both if a["ok"]]
        solved = len(pairs) / max(1, len(both))
        found.append(metric("planning.solved", solved, "1", "higher",
                            f"of {len(both)} tasks that OMPL solves in 10 s"))  # fmt: skip
        for key in ("tilt", "approach"):
            ratio = np.mean([b[key] for _, b in pairs]) / np.mean([a[key] for a, _ in pairs])
            found.append(metric(f"planning.adherence_vs_ompl_{key}", float(ratio), "1", "higher",
                                "OMPL's deviation over ours, tasks that both solve"))  # fmt: skip
    return found


def batch(learned: Learned, count: int, size: int) -> list[dict]:
    """Rate of batches of so many tasks; trajectories returned and rejected by the finer check."""
    planner, cell = learned.planner, learned.planner.cell
    engine, checked, bad, rates = Engine(cell, FINER), 0, 0, []
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
        metric("planning.batch_plans_per_second", float(np.median(rates[1:] or rates)), "1/s",
               "higher", f"{size} tasks; median of {len(rates)} batches but the first, which "
               f"compiles; best {max(rates):.1f}"),
        metric("planning.rejected", bad, "1", "lower",
               f"of {checked} returned trajectories, by a check four times as dense"),
    ]  # fmt: skip



def main(
    json: Path | None = None, tasks: int = 200, batched: int = 512, tiny: bool = False
) -> None:
    """Print all figures.

    Args:
        json: file to write them to.
        tasks: random tasks of the comparison.
        batched: tasks that are planned in batches of 256; 3,500 for 10^4 trajectories.
        tiny: as little of everything as shows that it runs.
    """
    hj.use_all_cores()
    cell = load_workcell("gen3_handling")
    learned = learn(cell, tiny)
    tasks, batched, size, warm = (2, 4, 4, 1) if tiny else (tasks, batched, 256, 10)
    some = [random_task(cell, seed) for seed in PLANNING_TEST[:tasks]]
    found, table = compare(learned, some, warm)
    found += headline(learned, table)
    drawn = {"PLANNING_TEST": PLANNING_TEST, "PLANNING_BATCHES": PLANNING_BATCHES}
    write(found, json, drawn)
    found += batch(learned, batched, size)
    write(found, json, drawn)


if __name__ == "__main__":
    tyro.cli(main)
