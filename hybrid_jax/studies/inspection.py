# SPDX-License-Identifier: MIT
"""The inspection study: every method brushes the same parts, from random starts, in physics."""

from collections.abc import Sequence

import numpy as np

from hybrid_jax.errors import InputError
from hybrid_jax.execution.inspection import EXACT, InspectionReport, Trial, inspect_parts
from hybrid_jax.runs import seeds
from hybrid_jax.runs.run_folder import Run
from hybrid_jax.studies.inspection_pictures import draw_study
from hybrid_jax.studies.measures import Metrics, rate
from hybrid_jax.studies.methods import Method, carry_out
from hybrid_jax.studies.steadiness import add_steadiness
from hybrid_jax.tasks.inspection import require_inspection
from hybrid_jax.types import Workcell

SEEDS = seeds.INSPECTION_STUDY
"""Seeds of the study's trials."""
METHODS = ("hybrid", "drl")
"""Methods that are compared by default."""
LEVELS = {
    "5cm_5deg": (0.05, np.radians(5.0)),
    "1cm_2deg": (0.01, np.radians(2.0)),
    "1mm_05deg": EXACT,
}
"""Tolerances of every key pose: position [m], each Euler angle [rad]. The first is the paper's."""


def run_method(
    cell: Workcell, method: Method, numbers: Sequence[int], quiet: bool = False
) -> tuple[list[InspectionReport], float]:
    """Carry out a trial of every part for each number; every trial has its own seed.

    Args:
        cell: with inspection data.
        method: the method.
        numbers: of the runs; see `drawn` for the seeds that follow from them.
        quiet: show no progress.

    Returns:
        One report a trial, with frames `[frame, nq]`, and the time of all [s], with compilation.
    """
    parts = require_inspection(cell).parts
    trials = [
        Trial(part.name, _trial_seed(seed, number, len(parts)))
        for number, part in enumerate(parts)
        for seed in numbers
    ]
    return carry_out(
        method,
        "trials",
        len(trials),
        numbers[0],
        lambda plan, progress: inspect_parts(
            cell,
            plan,
            trials,
            method.disturbance,
            engine=method.engine,
            progress=progress,
        ),
        quiet,
    )


def _trial_seed(seed: int, part: int, parts: int) -> int:
    """Seed of the trial of part number `part` of `parts`; those of the study stay in its range."""
    # consecutive for all parts of a run, so no two trials share a seed
    first = SEEDS.start if seed >= SEEDS.start else 0
    return first + parts * (seed - first) + part


def drawn(cell: Workcell, first: int, runs: int) -> range:
    """Seeds of all trials of `runs` runs of each part, from `first` on.

    Raises:
        InputError: they would leave the study's range.
    """
    parts = len(require_inspection(cell).parts)
    start = _trial_seed(first, 0, parts)
    span = range(start, start + runs * parts)
    if first >= SEEDS.start and span.stop > SEEDS.stop:
        raise InputError(
            f"{runs} runs from seed {first} on draw seeds {span.start} to {span.stop - 1} for "
            f"{parts} parts; those of the study end at {SEEDS.stop - 1}: ask for fewer runs"
        )
    return span


def row_of(method: str, report: InspectionReport) -> dict:
    """One trial as a row of the study's file: plain values that JSON can hold."""
    angles, gaps = np.degrees(report.brush_angles), 1e3 * report.stand_offs
    stroke = (
        {
            "brush_angle_rms_deg": float(np.sqrt(np.mean(angles**2))),
            "brush_angle_max_deg": float(angles.max()),
            "stand_off_rms_mm": float(np.sqrt(np.mean(gaps**2))),
            "stand_off_max_mm": float(np.abs(gaps).max()),
        }
        if angles.size
        else {}
    )
    return {
        "method": method,
        "part": report.trial.part,
        "seed": report.trial.seed,
        "success": {level: report.succeeded(*limits) for level, limits in LEVELS.items()},
        "cause": report.cause,
        "detail": report.detail,
        "away_mm": [round(1e3 * x, 4) for x in report.away],
        "turned_deg": [round(float(np.degrees(x)), 4) for x in report.turned],
        "touches": [str(touch) for touch in report.touches],
        "cycle_s": round(report.seconds, 2),
        "planning_s": round(report.planning_s, 4),
        "shares": report.shares,
        **stroke,
    }


def summarize(rows: list[dict], seconds: dict[str, float]) -> list[dict]:
    """Metrics of all methods; those of the hybrid stand without a name.

    Args:
        rows: see `row_of`.
        seconds: time of each method's trials [s].

    Returns:
        Rows of `measures.Metrics`.
    """
    metrics = Metrics("inspection")
    for method, took in seconds.items():
        trials = [row for row in rows if row["method"] == method]
        name = "" if method == "hybrid" else f"{method}_"
        causes = [row["cause"] or "inexact" for row in trials]
        for level in LEVELS:
            successes = [row["success"][level] for row in trials]
            metrics.add(f"{name}success_{level}", *rate(successes, causes))
        _add_strokes(metrics, name, trials)
        touched = sum(bool(row["touches"]) for row in trials)
        metrics.add(f"{name}collisions", touched, "1", "lower", f"of {len(trials)} trials")
        seconds_each = sum(row["planning_s"] for row in trials) / len(trials)
        metrics.add(
            f"{name}planning_time", seconds_each, "s", "lower", "mean of a plan, with compiling"
        )
        text = f"{len(trials)} trials took {took:.0f} s, compilation included"
        metrics.add(f"{name}seconds_100", took * 100 / len(trials), "s", "lower", text)
    return metrics.rows


def _add_strokes(metrics: Metrics, name: str, own: list[dict]) -> None:
    brushed = [row for row in own if "brush_angle_rms_deg" in row]
    if not brushed:
        return
    for key, unit in (("brush_angle", "deg"), ("stand_off", "mm")):
        rms_values = np.array([row[f"{key}_rms_{unit}"] for row in brushed])
        worst = max(row[f"{key}_max_{unit}"] for row in brushed)
        note = (
            f"{len(brushed)} strokes; worst stroke {rms_values.max():.2f}, worst point {worst:.2f}"
        )
        metrics.add(f"{name}{key}_rms", _rms(rms_values), unit, "lower", note)
        parts = {
            part: _rms([row[f"{key}_rms_{unit}"] for row in brushed if row["part"] == part])
            for part in sorted({row["part"] for row in brushed})
        }
        for which, pick in (("best", min), ("worst", max)):
            part = pick(parts, key=parts.__getitem__)
            note = f"RMS of the strokes of {part}; {which} of {len(parts)} parts"
            metrics.add(f"{name}{key}_{which}_part", parts[part], unit, "lower", note)
    cycle = float(np.median([row["cycle_s"] for row in brushed]))
    metrics.add(f"{name}cycle_time", cycle, "s", "lower", "median of trials that were carried out")


def _rms(values) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


CURVES = {
    "lfd": ("lfd", "cost_over_optimum", "cost of its plans of unseen tasks"),
    "drl_feasibility": ("drl", "return", "return"),
    "drl": ("alone", "return", "return"),
    "pure_drl": ("pure", "return", "return"),
}
"""For each agent the stage of its training, the curve that tells when it is steady, in words."""


def learning(run: Run) -> list[dict]:
    """Metrics of the trainings: the map, and when each agent was steady."""
    metrics = Metrics("inspection", run.preset)
    for row in run.metrics("map")[-1:]:
        note = f"of {row['step']:,} tool poses of the map"
        metrics.add("map_feasible", row["feasible"], "1", "higher", note)
    add_steadiness(metrics, run, CURVES)
    return metrics.rows


def succeeded(report: InspectionReport) -> bool:
    """Was every key pose met within the study's strictest tolerance, without a contact?"""
    return report.succeeded(*EXACT)


def frames_of(report: InspectionReport) -> tuple[str, np.ndarray]:
    """Name of a trial, and MuJoCo's `qpos` `[frame, nq]` after each tick."""
    return f"{report.trial.part}-{report.trial.seed}", report.frames


def draw(path, rows: list[dict], run: Run) -> None:
    """Draw the charts of the study into a file."""
    draw_study(path, rows, run)


def title(report: InspectionReport) -> str:
    """Outcome of a trial in few words."""
    return report.cause or "brushed"


def lines(report: InspectionReport) -> list[str]:
    """Outcome of a trial, as one line."""
    return [f"{report.trial.part}: {report.cause or 'brushed'} {report.detail}".rstrip()]
