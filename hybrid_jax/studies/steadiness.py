# SPDX-License-Identifier: MIT
"""When a training has reached a steady policy, in episodes and in computing time."""

from collections.abc import Sequence

import numpy as np

from hybrid_jax.runs.run_folder import Run
from hybrid_jax.studies.measures import Metrics

STEADY, MEAN_OF = 0.05, 5
"""Criterion of a steady agent: the moving mean over `MEAN_OF` updates stays within the share
`STEADY` of its final value."""


def steady_from(at: Sequence[float], values: Sequence[float], tolerance: float) -> float:
    """Step from which on a curve stays within a tolerance of its final value.

    Args:
        at: `[point]` steps or episodes.
        values: `[point]` of the curve; its final value is the mean of the last tenth.
        tolerance: share of the final value.
    """
    curve = np.asarray(values, float)
    final = curve[-max(1, len(curve) // 10) :].mean()
    outside = np.flatnonzero(np.abs(curve - final) > tolerance * abs(final))
    return float(at[min(outside[-1] + 1, len(curve) - 1)]) if outside.size else float(at[0])


def _episodes(rows: list[dict]) -> np.ndarray:
    """Episodes done at each row of a training's log; its steps, where these are episodes."""
    if "episodes" in rows[0]:
        return np.cumsum([row["episodes"] for row in rows])
    return np.array([row["step"] for row in rows])


def _seconds(rows: list[dict]) -> np.ndarray:
    """Computing time at each row of a training's log [s], compiling included; empty if unknown."""
    if "seconds" in rows[0]:
        return np.array([row["seconds"] for row in rows])
    if "rate" not in rows[0]:
        return np.zeros(0)
    steps = np.diff([row["step"] for row in rows], prepend=0)
    return np.cumsum(steps / np.array([row["rate"] for row in rows]))


def add_steadiness(metrics: Metrics, run: Run, curves: dict[str, tuple[str, str, str]]) -> None:
    """Add when agents were steady, and how often their last episodes ended well.

    Trainings of fewer than `MEAN_OF` updates are left out.

    Args:
        metrics: to add to.
        run: with the logs of the trainings; agents without one are left out.
        curves: for each agent its stage, the column of the curve, and what that is in words.
    """
    for name, (stage, column, text) in curves.items():
        rows = [row for row in run.metrics(stage) if column in row]
        if len(rows) < MEAN_OF:  # too short to tell
            continue
        values = np.convolve([row[column] for row in rows], np.full(MEAN_OF, 1 / MEAN_OF), "valid")
        for unit, label, at in (
            ("1", "episodes", _episodes(rows)),
            ("s", "seconds", _seconds(rows)),
        ):
            if not at.size:
                continue
            # a moving mean belongs to the last update of its window
            steady = steady_from(at[MEAN_OF - 1 :], values, STEADY)
            note = f"{text} stays within {STEADY:.0%} of where it ends, of {at[-1]:,.0f} {label}"
            metrics.add(f"{name}_steady_{label}", steady, unit, "lower", note)
        last_successes = [row["success"] for row in rows if "success" in row][-MEAN_OF:]
        if last_successes:
            note = (
                f"share of the training episodes that end well, last {len(last_successes)} updates"
            )
            metrics.add(
                f"{name}_training_success", float(np.mean(last_successes)), "1", "higher", note
            )
