# SPDX-License-Identifier: MIT
"""A study of tasks of any kind: every method does the same random tasks once, in physics."""

from collections.abc import Sequence

import matplotlib.figure
import numpy as np

from hybrid_jax.errors import InputError
from hybrid_jax.execution.disturbances import CALM
from hybrid_jax.execution.single_tasks import TaskReport, carry_out_tasks
from hybrid_jax.runs import seeds
from hybrid_jax.runs.run_folder import Run
from hybrid_jax.studies.measures import Metrics, rate
from hybrid_jax.studies.methods import Method, carry_out
from hybrid_jax.types import Workcell

SEEDS = seeds.SINGLE_TASK_STUDY
"""Seeds of the study's tasks."""
METHODS = ("hybrid", "drl")
"""Methods that are compared by default."""


def run_method(
    cell: Workcell, method: Method, numbers: Sequence[int], quiet: bool = False
) -> tuple[list[TaskReport], float]:
    """Carry out all runs of one method.

    Args:
        cell: with task data of any kind.
        method: the method.
        numbers: seeds of the tasks.
        quiet: show no progress.

    Returns:
        One report a task, with frames `[frame, nq]`, and the time of all [s], with compilation.

    Raises:
        InputError: the method disturbs the cell, which only studies of their own kind can.
    """
    if method.disturbance != CALM:
        raise InputError(f"method {method.name!r}: this study has no disturbances; leave it out")
    return carry_out(
        method,
        "tasks",
        len(numbers),
        numbers[0],
        lambda plan, progress: carry_out_tasks(
            cell, plan, numbers, method.execution, method.engine, progress
        ),
        quiet,
    )


def drawn(cell: Workcell, first: int, runs: int) -> range:
    """Seeds of the tasks of `runs` runs, from `first` on."""
    del cell
    return range(first, first + runs)


def row_of(method: str, report: TaskReport) -> dict:
    """One task as a row of the study's file: plain values that JSON can hold."""
    return {
        "method": method,
        "object": report.name,
        "seed": report.seed,
        "success": succeeded(report),
        "cause": report.cause,
        "detail": report.detail,
        "measures": report.measures,
        "touches": [str(touch) for touch in report.touches],
        "cycle_s": round(report.cycle_s, 2),
        "planning_s": round(report.planning_s, 4),
        "shares": report.shares,
    }


def summarize(rows: list[dict], seconds: dict[str, float]) -> list[dict]:
    """Metrics of all methods.

    Args:
        rows: see `row_of`.
        seconds: time of each method's tasks [s].

    Returns:
        Rows of `measures.Metrics`.
    """
    metrics = Metrics("tasks")
    for method, took in seconds.items():
        own = [row for row in rows if row["method"] == method]
        causes = [row["cause"] for row in own]
        metrics.add(f"{method}_success", *rate([row["success"] for row in own], causes))
        for name in sorted({name for row in own for name in row["measures"]}):
            values = [row["measures"][name] for row in own if name in row["measures"]]
            note = f"mean of {len(values)} tasks that were carried out; largest {max(values):.4g}"
            metrics.add(f"{method}_{name}", float(np.mean(values)), "", "", note)
        cycle_times = [row["cycle_s"] for row in own if row["success"]]
        if cycle_times:
            median = float(np.median(cycle_times))
            metrics.add(f"{method}_cycle_time", median, "s", "lower", "median of successful tasks")
        planning = sum(row["planning_s"] for row in own) / len(own)
        note = f"mean of a plan, with compiling; {len(own)} tasks took {took:.0f} s"
        metrics.add(f"{method}_planning_time", planning, "s", "lower", note)
    return metrics.rows


def learning(run: Run) -> list[dict]:
    """Metrics of the trainings; this study has none."""
    del run
    return []


def succeeded(report: TaskReport) -> bool:
    """Was the task done, and nothing else touched?"""
    return not report.cause


def frames_of(report: TaskReport) -> tuple[str, np.ndarray]:
    """Name of a task, and MuJoCo's `qpos` `[frame, nq]` after each tick."""
    return f"{report.name}-{report.seed}", report.frames


def draw(path, rows: list[dict], run: Run) -> None:
    """Draw the share of tasks that each method did into a file."""
    methods = list(dict.fromkeys(row["method"] for row in rows))
    shares = [np.mean([row["success"] for row in rows if row["method"] == m]) for m in methods]
    figure = matplotlib.figure.Figure(figsize=(6, 1 + 0.4 * len(methods)), layout="constrained")
    axes = figure.add_subplot()
    bars = axes.barh(methods, shares)
    axes.bar_label(bars, [f"{share:.2f}" for share in shares], padding=3)
    axes.set(xlim=(0, 1.15), xlabel="share of tasks that were done", title=run.cell.source.name)
    axes.invert_yaxis()
    figure.savefig(path, dpi=120)


def title(report: TaskReport) -> str:
    """Outcome of a task in few words."""
    return report.cause or "done"


def lines(report: TaskReport) -> list[str]:
    """Outcome of a task, as one line."""
    return [f"{report.name}: {report.cause or 'done'} {report.detail}".rstrip()]
