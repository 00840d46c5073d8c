# SPDX-License-Identifier: MIT
"""Figures of the planning comparison, from the rows of its tasks."""

from collections import Counter

import numpy as np

from benchmarks.planning_methods import (
    Optimality,
)
from benchmarks.report import metric
from hybrid_jax.types import Source


def rows_of(name: str, rows: list[dict]) -> list[dict]:
    """Figures of one method."""
    good = [r for r in rows if r["ok"]]
    times = np.array([r["seconds"] for r in rows])
    causes = Counter(r["status"] for r in rows if not r["ok"])
    found = [
        metric(
            f"planning.{name}_success",
            len(good) / len(rows),
            "1",
            "higher",
            f"{len(rows)} tasks; failures: {dict(causes) or 'none'}",
        ),
        metric(
            f"planning.{name}_seconds",
            float(np.median(times)),
            "s",
            "lower",
            f"median; p95 {np.quantile(times, 0.95):.3f}, p99 {np.quantile(times, 0.99):.3f}",
        ),
    ]
    if not good:
        return found
    mean = {
        key: float(np.mean([r[key] for r in good]))
        for key in ("length", "duration", "jerk", "tilt", "approach")
    }
    units = {"length": "rad", "duration": "s", "jerk": "rad/s^3", "tilt": "deg", "approach": "deg"}
    found += [
        metric(f"planning.{name}_{key}", value, units[key], "lower", "mean of solved tasks")
        for key, value in mean.items()
    ]
    least = min(r["clearance"] for r in good)
    found.append(metric(f"planning.{name}_clearance", least, "m", "higher", "smallest of all"))
    shares = [r["result"].shares for r in good]
    for source in Source:
        share = float(np.mean([s[source] for s in shares]))
        if share and name != "ompl":
            found.append(
                metric(
                    f"planning.{name}_share_{source.name.lower()}",
                    share,
                    "1",
                    "higher",
                    "share of way points",
                )
            )
    return found


def headline(switch: Optimality, table: dict[str, list[dict]]) -> list[dict]:
    """What follows from the comparison."""
    own = table["hybrid"]
    seams = np.array([r["seam"] for r in own if r["ok"] and np.isfinite(r["seam"])] or [np.nan])
    times = np.array([r["seconds"] for r in own])
    found = [
        metric("planning.seconds_median", float(np.median(times)), "s", "lower", "one task"),
        metric("planning.seconds_p99", float(np.quantile(times, 0.99)), "s", "lower", "one task"),
        metric(
            "planning.seam_step_ratio",
            float(seams.max()),
            "1",
            "lower",
            f"worst of all; median {np.median(seams):.2f}, p95 {np.quantile(seams, 0.95):.2f}",
        ),
        metric(
            "planning.switch_optimality",
            float(switch.agent.mean()),
            "1",
            "higher",
            f"{len(switch.agent)} unseen phases; worst {switch.agent.min():.3f}",
        ),
        metric(
            "planning.switch_rule_optimality",
            float(switch.rule.mean()),
            "1",
            "higher",
            f"of the rule in its place, on the same phases; worst {switch.rule.min():.3f}",
        ),
    ]
    if "ompl" in table:
        both = [(a, b) for a, b in zip(own, table["ompl"], strict=True) if b["ok"]]
        pairs = [(a, b) for a, b in both if a["ok"]]
        solved = len(pairs) / max(1, len(both))
        found.append(
            metric(
                "planning.solved",
                solved,
                "1",
                "higher",
                f"of {len(both)} tasks that OMPL solves in 10 s",
            )
        )
        for key in ("tilt", "approach"):
            ratio = np.mean([b[key] for _, b in pairs]) / np.mean([a[key] for a, _ in pairs])
            found.append(
                metric(
                    f"planning.adherence_vs_ompl_{key}",
                    float(ratio),
                    "1",
                    "higher",
                    "OMPL's deviation over ours, tasks that both solve",
                )
            )
    return found
