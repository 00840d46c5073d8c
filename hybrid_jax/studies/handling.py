# SPDX-License-Identifier: MIT
"""The handling study: every method sorts the objects of the same random scenes, in physics."""

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np

from hybrid_jax.baselines.ablations import ABLATIONS
from hybrid_jax.execution.handling import SortingReport, sort_scenes
from hybrid_jax.runs import seeds
from hybrid_jax.runs.run_folder import Run
from hybrid_jax.studies.handling_pictures import draw_study
from hybrid_jax.studies.measures import Metrics, rate
from hybrid_jax.studies.methods import Method, carry_out
from hybrid_jax.studies.steadiness import add_steadiness
from hybrid_jax.types import Workcell

SEEDS = seeds.HANDLING_STUDY
"""Seeds of the study's scenes."""
METHODS = (
    "hybrid",
    "lfd",
    "lfd_executed",
    "drl",
    "ompl",
    "disturbed",
    "paper",
    *(f"ablation_{name}" for name in ABLATIONS),
)
"""Methods that are compared by default."""


def run_method(
    cell: Workcell, method: Method, numbers: Sequence[int], quiet: bool = False
) -> tuple[list[SortingReport], float]:
    """Carry out all runs of one method.

    Args:
        cell: with handling data.
        method: the method.
        numbers: seeds of the scenes.
        quiet: show no progress.

    Returns:
        One report a run, with frames `[frame, nq]`, and the time of all [s], compilation included.
    """
    return carry_out(
        method,
        "runs",
        len(numbers),
        numbers[0],
        lambda plan, progress: sort_scenes(
            cell,
            plan,
            numbers,
            disturbance=method.disturbance,
            config=method.execution,
            engine=method.engine,
            progress=progress,
        ),
        quiet,
    )


def drawn(cell: Workcell, first: int, runs: int) -> range:
    """Seeds of all scenes of `runs` runs, from `first` on."""
    del cell
    return range(first, first + runs)


def row_of(method: str, report: SortingReport) -> dict:
    """One run as a row of the study's file: plain values that JSON can hold."""
    # where every object succeeded, only a contact that belongs to none can fail the run
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


def summarize(rows: list[dict], seconds: dict[str, float]) -> list[dict]:
    """Metrics of all methods.

    Args:
        rows: see `row_of`.
        seconds: time of each method's runs [s].

    Returns:
        Rows of `measures.Metrics`.
    """
    metrics = Metrics("handling")
    for method, took in seconds.items():
        runs = [row for row in rows if row["method"] == method]
        objects = [item for row in runs for item in row["objects"]]
        successes, causes = [row["success"] for row in runs], [row["cause"] for row in runs]
        metrics.add(f"{method}_success", *rate(successes, causes))
        metrics.add(f"{method}_object_success", *rate([item["success"] for item in objects]))
        metrics.add(f"{method}_object_placed", *rate([item["placed"] for item in objects]))
        first = [_first_try(item) for item in objects]
        at_once = [row["success"] and all(_first_try(i) for i in row["objects"]) for row in runs]
        metrics.add(f"{method}_first_try", *rate(at_once))
        metrics.add(f"{method}_object_first_try", *rate(first))
        _add_plans(metrics, method, objects)
        cycle_times = [row["cycle_s"] for row in runs if row["success"]]
        if cycle_times:
            median = float(np.median(cycle_times))
            metrics.add(f"{method}_cycle_time", median, "s", "lower", "median of successful runs")
        plan_count = max(1, sum(item["asked"] for item in objects))
        mean_time = sum(row["planning_s"] for row in runs) / plan_count
        text = f"mean of {plan_count} plans that were asked for, with compiling"
        metrics.add(f"{method}_planning_time", mean_time, "s", "lower", text)
        if method == "hybrid":
            text = f"{len(runs)} runs took {took:.0f} s, compilation included"
            metrics.add("seconds_100", took * 100 / len(runs), "s", "lower", text)
    return metrics.rows


def _first_try(item: dict) -> bool:
    """Was an object placed by the first plan that was asked for?"""
    return bool(item["success"] and item["asked"] == item["tries"] == 1)


def _add_plans(metrics: Metrics, method: str, objects: list[dict]) -> None:
    """Add the length of the objects' last plans, and the shares of their sources."""
    planned = [item for item in objects if item["tries"] and item["motion_s"] > 0]
    if not planned:
        return
    note = f"mean of the last plan of {len(planned)} objects"
    path_length, duration = (
        float(np.mean([i[key] for i in planned])) for key in ("way_rad", "motion_s")
    )
    metrics.add(f"{method}_way", path_length, "rad", "lower", note)
    metrics.add(f"{method}_motion", duration, "s", "lower", note)
    for source in planned[0]["shares"]:
        share = float(np.mean([item["shares"].get(source, 0.0) for item in planned]))
        metrics.add(f"{method}_share_{source.lower()}", share, "1", "", note)


CURVES = {
    "lfd": ("lfd", "cost_over_optimum", "cost of its plans of unseen tasks"),
    "drl_feasibility": ("drl", "return", "return"),
    "switching": ("switch", "return", "return"),
    "pure_drl": ("pure", "return", "return"),
}
"""For each agent the stage of its training, the curve that tells when it is steady, in words."""


def learning(run: Run) -> list[dict]:
    """Metrics of the trainings: when each agent was steady."""
    metrics = Metrics("handling", run.preset)
    add_steadiness(metrics, run, CURVES)
    return metrics.rows


def succeeded(report: SortingReport) -> bool:
    """Is every object in its tray, and nothing else touched?"""
    return report.success


def frames_of(report: SortingReport) -> tuple[str, np.ndarray]:
    """Name of a run, and MuJoCo's `qpos` `[frame, nq]` after each tick."""
    return str(report.seed), report.frames


def draw(path, rows: list[dict], run: Run) -> None:
    """Draw the chart of the study into a file."""
    del run
    draw_study(path, rows)


def title(report: SortingReport) -> str:
    """Outcome of a run in few words."""
    return f"{sum(r.success for r in report.reports)} of {len(report.reports)} placed"


def lines(report: SortingReport) -> list[str]:
    """Outcome of each object, one line each."""
    return [f"{r.name}: {r.cause or 'placed'} {r.detail}".rstrip() for r in report.reports]
