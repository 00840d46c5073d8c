# SPDX-License-Identifier: MIT
"""The handling study: every method sorts the objects of the same random scenes, in physics."""

import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

import jax
import numpy as np
from scipy.stats import binomtest

from hybrid_jax.errors import RunFolderError, UnknownNameError
from hybrid_jax.planner.directly import joint_agent_only
from hybrid_jax.planner.loading import load_planner
from hybrid_jax.planner.pipeline import lfd_only, plan_batch
from hybrid_jax.planner.records import Planner, PlanResult
from hybrid_jax.progress import Progress
from hybrid_jax.rivals import paper_run, whole_space_agent
from hybrid_jax.runfolder import Run
from hybrid_jax.simulation.disturbances import CALM, DISTURBED, Disturbance
from hybrid_jax.simulation.runs import SortingReport, planning, sort_scenes
from hybrid_jax.skills.task import Task
from hybrid_jax.types import Workcell

METHODS = {
    "hybrid": "skills and joint agent, as the planner is used",
    "paper": "the same with the paper's agents (preset `paper`)",
    "lfd": "skills alone",
    "drl": "a joint agent of the whole work space alone, from key pose to key pose",
    "ompl": "OMPL's RRT-Connect between the same key poses",
    "disturbed": "hybrid, with what `simulation.disturbances.DISTURBED` changes",
}
"""What can be compared."""

PlanMany = Callable[..., list[PlanResult]]


@dataclass(frozen=True)
class Contestant:
    """A method with what it plans with."""

    name: str
    planner: Planner
    plan: PlanMany
    disturbance: Disturbance = CALM


def one_by_one(plan: Callable[..., PlanResult]) -> PlanMany:
    """A planner of one task for many."""

    def plan_many(planner: Planner, tasks: Sequence[Task], *, key) -> list[PlanResult]:
        keys = jax.random.split(key, len(tasks))
        return [plan(planner, task, key=k) for task, k in zip(tasks, keys, strict=True)]

    return plan_many


def contestant(name: str, run: Run, paper: Run | None) -> Contestant | None:
    """A method of the study; None (and a sentence) where something for it is missing.

    Raises:
        UnknownNameError: no such method.
        RunFolderError: the paper's run is of another cell, or a run lacks a stage.
    """
    if name not in METHODS:
        raise UnknownNameError("method", name, METHODS)
    if name == "paper":
        return _paper(run, paper)
    planner = load_planner(run)
    if name == "ompl":
        return _ompl(planner)
    if name == "drl":
        return Contestant(name, whole_space_agent(run, planner), one_by_one(joint_agent_only))
    if name == "lfd":
        return Contestant(name, lfd_only(planner), plan_batch)
    return Contestant(name, planner, plan_batch, DISTURBED if name == "disturbed" else CALM)


def _paper(run: Run, paper: Run | None) -> Contestant:
    paper = paper or paper_run(run)
    if paper.cell.source.digest != run.cell.source.digest:
        raise RunFolderError(
            f"{paper.folder} was trained for cell {paper.cell.source.name!r}, not for "
            f"{run.cell.source.name!r} of {run.folder}; give a run of the same cell"
        )
    return Contestant("paper", load_planner(paper), plan_batch)


def _ompl(planner: Planner) -> Contestant | None:
    try:
        from hybrid_jax.planner.ompl_tasks import OmplTasks  # noqa: PLC0415
    except ImportError as error:
        print(f"ompl: left out, {error.name} is not installed (pip install 'hybrid_jax[ompl]')")
        return None
    tasks = OmplTasks(planner, planner.config.smoothing.margin)  # as much as our own paths keep
    return Contestant("ompl", planner, one_by_one(lambda _, task, key: tasks.plan(task, key)))


def run_contestant(
    cell: Workcell, one: Contestant, seeds: Sequence[int], quiet: bool = False
) -> tuple[list[SortingReport], float]:
    """All runs of one method, and the time that they took [s], compilation included."""
    began, progress = time.perf_counter(), Progress(one.name, "runs", quiet)

    def report(ended: int, simulated: float) -> None:
        progress(ended, len(seeds), f"{simulated:,.0f} s simulated")

    plan = planning(one.planner, one.plan, seeds[0])
    found = sort_scenes(cell, plan, seeds, disturbance=one.disturbance, progress=report)
    return found, time.perf_counter() - began


def row_of(method: str, report: SortingReport) -> dict:
    """One run as a row of the study's file."""
    causes = [r.cause for r in report.reports if not r.success]
    return {
        "method": method,
        "seed": report.seed,
        "success": report.success,
        "cause": causes[0] if causes else "" if report.success else "collision",
        "cycle_s": round(report.seconds, 2),
        "planning_s": round(sum(r.planning_s for r in report.reports), 3),
        "touches": [str(touch) for touch in report.touches],
        "objects": [asdict(r) for r in report.reports],
    }


def _rate(wins: int, count: int) -> tuple[float, str]:
    interval = binomtest(wins, count).proportion_ci(method="wilson")
    return wins / count, f"{wins} of {count}, 95 % from {interval.low:.3f} to {interval.high:.3f}"


def summarize(rows: list[dict], seconds: dict[str, float]) -> list[dict]:
    """Metrics of all methods.

    Args:
        rows: see `row_of`.
        seconds: of each method's runs.
    """
    metrics: list[dict] = []
    for method, took in seconds.items():
        own = [row for row in rows if row["method"] == method]
        objects = [item for row in own for item in row["objects"]]
        value, note = _rate(sum(row["success"] for row in own), len(own))
        causes = Counter(row["cause"] for row in own if not row["success"])
        note += "".join(f"; {cause} {count}" for cause, count in causes.most_common())
        add = _adder(metrics, method)
        add("success", value, "1", "higher", note)
        add("object_success", *_objects(objects))
        done = [row["cycle_s"] for row in own if row["success"]]
        if done:
            add("cycle_time", float(np.median(done)), "s", "lower", "median of successful runs")
        plans = sum(max(1, item["tries"]) for item in objects)
        each = sum(row["planning_s"] for row in own) / plans
        add("planning_time", each, "s", "lower", "mean of a plan, compilation included")
        if method == "hybrid":
            text = f"{len(own)} runs took {took:.0f} s, compilation included"
            add("seconds_100", took * 100 / len(own), "s", "lower", text, prefix=False)
    return metrics


def _objects(objects: list[dict]) -> tuple[float, str, str, str]:
    value, note = _rate(sum(item["success"] for item in objects), len(objects))
    return value, "1", "higher", note


def _adder(metrics: list[dict], method: str) -> Callable[..., None]:
    device = jax.devices()[0].device_kind

    def add(name: str, value: float, unit: str, better: str, note: str, prefix: bool = True):
        key = f"handling.{method}_{name}" if prefix else f"handling.{name}"
        metrics.append(
            {"key": key, "value": value, "unit": unit, "better": better, "device": device,
             "note": note}
        )  # fmt: skip

    return add


def as_table(metrics: list[dict]) -> str:
    """Metrics as aligned lines."""
    return "\n".join(
        f"{m['key']:34s} {m['value']:>10.4g} {m['unit']:3s} {m['note']}" for m in metrics
    )
