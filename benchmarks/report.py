# SPDX-License-Identifier: MIT
"""One form for all figures: key, value, unit, direction, device, note."""

import time
from collections.abc import Callable, Mapping
from pathlib import Path

import jax
import numpy as np
from scipy import stats

from hybrid_jax.runtime.provenance import write_figures


def metric(key: str, value: float, unit: str, better: str, note: str = "") -> dict:
    """One figure of this machine."""
    device = f"{jax.devices()[0].device_kind}, jax {jax.__version__}"
    return {
        "key": key,
        "value": value,
        "unit": unit,
        "better": better,
        "device": device,
        "note": note,
    }


def rate(run: Callable[[], object], count: int, seconds: float = 2.0) -> tuple[float, float]:
    """Items per second of `run`, which handles `count` of them, and the time of its first call."""
    began = time.perf_counter()
    jax.block_until_ready(run())
    first = time.perf_counter() - began
    calls, began = 0, time.perf_counter()
    while time.perf_counter() - began < seconds:
        jax.block_until_ready(run())
        calls += 1
    return calls * count / (time.perf_counter() - began), first


def race(runs: dict[str, tuple[Callable[[], object], int]], rounds: int = 8) -> dict[str, float]:
    """Items per second of several contenders, each the best of its rounds.

    They take turns, so that whatever else slows the machine down slows all of them.

    Args:
        runs: by name, what to run and how many items it handles; all have run once before.
        rounds: turns of each, half a second long.
    """
    best = dict.fromkeys(runs, 0.0)
    for _ in range(rounds):
        for name, (run, count) in runs.items():
            best[name] = max(best[name], rate(run, count, 0.5)[0])
    return best


def interval(values) -> tuple[float, float]:
    """Mean of a few independent values and half the width of its 95 % interval (Student's t)."""
    values = np.asarray(values, float)
    if len(values) < 2:
        return float(values.mean()), float("nan")
    half = stats.t.ppf(0.975, len(values) - 1) * values.std(ddof=1) / np.sqrt(len(values))
    return float(values.mean()), float(half)


def write(metrics: list[dict], path: Path | None, seeds: Mapping[str, range] | None = None) -> None:
    """Print the figures as a table, and write them with where they come from if a path is given.

    Args:
        metrics: see `metric`.
        path: JSON file; `docs/figures/NAME.json` is what the documents are rendered from.
        seeds: ranges of `hybrid_jax.runs.seeds` that were drawn from, by name.
    """
    for m in metrics:
        better = f"({m['better']} is better)" if m["better"] else ""
        print(f"{m['key']:34s} {m['value']:>12.4g} {m['unit']:4s} {better:20s} {m['note']}")
    if path:
        write_figures(path, metrics, seeds or {})
