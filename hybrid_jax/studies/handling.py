# SPDX-License-Identifier: MIT
"""The handling study: every method sorts the objects of the same random scenes, in physics."""

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np

from hybrid_jax import seeds
from hybrid_jax.planner.ablations import ABLATIONS
from hybrid_jax.runfolder import Run
from hybrid_jax.simulation.runs import SortingReport, sort_scenes
from hybrid_jax.studies.contestants import Contestant, carry_out
from hybrid_jax.studies.handlingpictures import draw_study
from hybrid_jax.studies.measures import Metrics, rate
from hybrid_jax.types import Workcell

SEEDS = seeds.HANDLING_STUDY
"""Of its scenes."""
METHODS = (
    "hybrid", "lfd", "lfd_executed", "drl", "ompl", "disturbed", "paper",
    *(f"ablation_{name}" for name in ABLATIONS),
)  # fmt: skip
"""Methods that are compared if none is named."""


def run_contestant(
    cell: Workcell, one: Contestant, numbers: Sequence[int], quiet: bool = False
) -> tuple[list[SortingReport], float]:
    """All runs of one method, and the time that they took [s], compilation included."""
    return carry_out(
        one, "runs", len(numbers), numbers[0],
        lambda plan, progress: sort_scenes(
            cell, plan, numbers, disturbance=one.disturbance, config=one.execution,
            progress=progress,
        ),
        quiet,
    )  # fmt: skip


def drawn(cell: Workcell, first: int, runs: int) -> range:
    """Seeds of all scenes of so many runs."""
    del cell
    return range(first, first + runs)


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


def summarize(rows: list[dict], seconds: dict[str, float]) -> list[dict]:
    """Metrics of all methods.

    Args:
        rows: see `row_of`.
        seconds: of each method's runs.
    """
    metrics = Metrics("handling")
    for method, took in seconds.items():
        own = [row for row in rows if row["method"] == method]
        objects = [item for row in own for item in row["objects"]]
        won, causes = [row["success"] for row in own], [row["cause"] for row in own]
        metrics.add(f"{method}_success", *rate(won, causes))
        metrics.add(f"{method}_object_success", *rate([item["success"] for item in objects]))
        metrics.add(f"{method}_object_placed", *rate([item["placed"] for item in objects]))
        first = [_first_try(item) for item in objects]
        at_once = [row["success"] and all(_first_try(i) for i in row["objects"]) for row in own]
        metrics.add(f"{method}_first_try", *rate(at_once))
        metrics.add(f"{method}_object_first_try", *rate(first))
        _add_plans(metrics, method, objects)
        done = [row["cycle_s"] for row in own if row["success"]]
        if done:
            middle = float(np.median(done))
            metrics.add(f"{method}_cycle_time", middle, "s", "lower", "median of successful runs")
        asked = max(1, sum(item["asked"] for item in objects))
        each = sum(row["planning_s"] for row in own) / asked
        text = f"mean of {asked} plans that were asked for, with compiling"
        metrics.add(f"{method}_planning_time", each, "s", "lower", text)
        if method == "hybrid":
            text = f"{len(own)} runs took {took:.0f} s, compilation included"
            metrics.add("seconds_100", took * 100 / len(own), "s", "lower", text)
    return metrics.rows


def _first_try(item: dict) -> bool:
    """Was an object placed by the first plan that was asked for?"""
    return bool(item["success"] and item["asked"] == item["tries"] == 1)


def _add_plans(metrics: Metrics, method: str, objects: list[dict]) -> None:
    """How long the plans of placed objects are, and what they come from."""
    planned = [item for item in objects if item["tries"] and item["motion_s"] > 0]
    if not planned:
        return
    note = f"mean of the last plan of {len(planned)} objects"
    way, motion = (float(np.mean([i[key] for i in planned])) for key in ("way_rad", "motion_s"))
    metrics.add(f"{method}_way", way, "rad", "lower", note)
    metrics.add(f"{method}_motion", motion, "s", "lower", note)
    for source in planned[0]["shares"]:
        share = float(np.mean([item["shares"].get(source, 0.0) for item in planned]))
        metrics.add(f"{method}_share_{source.lower()}", share, "1", "", note)


def learning(run: Run) -> list[dict]:
    """Metrics of the trainings: none."""
    del run
    return []


def succeeded(report: SortingReport) -> bool:
    """Is everything where it belongs?"""
    return report.success


def frames_of(report: SortingReport) -> tuple[str, np.ndarray]:
    """Name of a run, and its motion `[frame, nq]`."""
    return str(report.seed), report.frames


def draw(path, rows: list[dict], run: Run) -> None:
    """The chart of the study."""
    del run
    draw_study(path, rows)


def title(report: SortingReport) -> str:
    """What became of a run, in few words."""
    return f"{sum(r.success for r in report.reports)} of {len(report.reports)} placed"


def lines(report: SortingReport) -> list[str]:
    """What became of each object."""
    return [f"{r.name}: {r.cause or 'placed'} {r.detail}".rstrip() for r in report.reports]
