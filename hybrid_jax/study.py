# SPDX-License-Identifier: MIT
"""Trials of a method on random tasks, and what they add up to."""

import time
from collections import Counter
from collections.abc import Callable

import jax
import numpy as np
from scipy.stats import binomtest

from hybrid_jax.planner.directly import joint_agent_only
from hybrid_jax.planner.pipeline import lfd_only, plan_motion
from hybrid_jax.planner.records import Planner, PlanResult
from hybrid_jax.simulation.execution import execute
from hybrid_jax.skills.task import Task, random_task
from hybrid_jax.types import Status

METHODS: dict[str, Callable[[Planner], tuple[Planner, Callable]]] = {
    "hybrid": lambda planner: (planner, plan_motion),
    "lfd": lambda planner: (lfd_only(planner), plan_motion),
    "drl": lambda planner: (planner, joint_agent_only),
}
"""How each method of the paper's study plans."""


def run_trial(method: tuple[Planner, Callable[..., PlanResult]], name: str, seed: int) -> dict:
    """Plan and execute one random task; one row of the study."""
    planner, plan = method
    task: Task = random_task(planner.cell, seed)
    began = time.perf_counter()
    result = plan(planner, task, key=jax.random.key(seed))
    row = {
        "method": name,
        "seed": seed,
        "object": task.object_name,
        "status": result.status.name,
        "detail": result.detail,
        "planning_s": round(time.perf_counter() - began, 3),
        "drl_share": round(result.drl_share, 3),
        "success": False,
        "cause": "no plan",
    }
    if result.status is not Status.OK:
        return row
    report = execute(planner.cell, task, result)
    cause = (
        ""
        if report.success
        else "lost in transfer"
        if not report.grasped
        else "wrong place"
        if not report.placed
        else "collision"
    )
    return row | {
        "success": report.success,
        "placed": report.placed,
        "touched": report.touched,
        "cause": cause,
        "cycle_s": round(report.duration, 2),
    }


def summarize(rows: list[dict], method: str) -> list[dict]:
    """Success rate with its Wilson 95 % interval, causes of failure, times."""
    own = [row for row in rows if row["method"] == method]
    wins = sum(row["success"] for row in own)
    interval = binomtest(wins, len(own)).proportion_ci(method="wilson")
    causes = Counter(row["cause"] for row in own if not row["success"])
    note = f"95 % interval {interval.low:.3f} to {interval.high:.3f}, {len(own)} trials"
    if causes:
        note += "; failures: " + ", ".join(f"{k} {v}" for k, v in causes.most_common())
    device = jax.devices()[0].device_kind
    found = [
        {
            "key": f"evaluate.{method}_success",
            "value": wins / len(own),
            "unit": "1",
            "better": "higher",
            "device": device,
            "note": note,
        },
        {
            "key": f"evaluate.{method}_planning_time",
            "value": float(np.median([row["planning_s"] for row in own])),
            "unit": "s",
            "better": "lower",
            "device": device,
            "note": "median, first call compiles",
        },
    ]
    return found


def as_table(metrics: list[dict]) -> str:
    """Metrics as aligned lines."""
    return "\n".join(
        f"{m['key']:34s} {m['value']:>10.4g} {m['unit']:3s} {m['note']}" for m in metrics
    )
