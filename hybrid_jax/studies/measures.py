# SPDX-License-Identifier: MIT
"""Metrics of a study: rates with their intervals, steadiness of curves, and a printed table."""

from collections import Counter

import jax
from scipy.stats import binomtest

from hybrid_jax.runs.presets import Preset


class Metrics:
    """A list of metrics under one prefix."""

    def __init__(self, study: str, preset: Preset | None = None):
        """Begin a list.

        Args:
            study: first part of the keys.
            preset: of the trainings that are measured: the paper's are told apart by their keys.
        """
        own = "paper_" if preset and preset.planner.handover else ""
        self.prefix, self.rows = f"{study}.{own}", []
        self.device = jax.devices()[0].device_kind

    def add(self, name: str, value: float, unit: str, better: str, note: str) -> None:
        """Add a metric.

        Args:
            name: without the prefix.
            value: in `unit`.
            unit: 1 for a share or a number.
            better: `higher`, `lower`, or empty.
            note: a sentence about the data behind it.
        """
        self.rows.append(
            {
                "key": f"{self.prefix}{name}",
                "value": value,
                "unit": unit,
                "better": better,
                "device": self.device,
                "note": note,
            }
        )


def rate(won: list[bool], causes: list[str] | None = None) -> tuple[float, str, str, str]:
    """Share of successes with Wilson's interval and the causes of failure.

    Args:
        won: success of each run.
        causes: of each run; those of successes do not count.

    Returns:
        Value, unit, better direction and note, as `Metrics.add` takes them.
    """
    wins, count = sum(won), len(won)
    interval = binomtest(wins, count).proportion_ci(method="wilson")
    note = f"{wins} of {count}, 95 % from {interval.low:.3f} to {interval.high:.3f}"
    pairs = zip(causes or [], won, strict=False)
    failed = Counter(cause for cause, success in pairs if not success)
    note += "".join(f"; {cause} {times}" for cause, times in failed.most_common())
    return wins / count, "1", "higher", note


def as_table(metrics: list[dict]) -> str:
    """Metrics as aligned lines of text."""
    return "\n".join(
        f"{m['key']:34s} {m['value']:>10.4g} {m['unit']:3s} {m['note']}" for m in metrics
    )
