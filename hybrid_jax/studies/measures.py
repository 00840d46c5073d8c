# SPDX-License-Identifier: MIT
"""Metrics of a study: rates with their intervals, and what they are printed as."""

from collections import Counter
from collections.abc import Sequence

import jax
import numpy as np
from scipy.stats import binomtest


class Metrics:
    """A list of metrics under one prefix."""

    def __init__(self, prefix: str):
        self.prefix, self.rows = prefix, []
        self.device = jax.devices()[0].device_kind

    def add(self, name: str, value: float, unit: str, better: str, note: str) -> None:
        """One more: what it measures, in which unit, which way is better, what is behind it."""
        self.rows.append(
            {"key": f"{self.prefix}.{name}", "value": value, "unit": unit, "better": better,
             "device": self.device, "note": note}
        )  # fmt: skip


def rate(won: list[bool], causes: list[str] | None = None) -> tuple[float, str, str, str]:
    """Share of successes with Wilson's interval and the causes of the others, for `Metrics.add`."""
    wins, count = sum(won), len(won)
    interval = binomtest(wins, count).proportion_ci(method="wilson")
    note = f"{wins} of {count}, 95 % from {interval.low:.3f} to {interval.high:.3f}"
    pairs = zip(causes or [], won, strict=False)
    failed = Counter(cause for cause, success in pairs if not success)
    note += "".join(f"; {cause} {times}" for cause, times in failed.most_common())
    return wins / count, "1", "higher", note


def steady_from(at: Sequence[float], values: Sequence[float], tolerance: float) -> float:
    """Where a curve becomes steady: from there on it stays within a tolerance of where it ends.

    Args:
        at: steps or episodes.
        values: at these; where it ends is the mean of the last tenth.
        tolerance: share of that mean.
    """
    curve = np.asarray(values, float)
    last = curve[-max(1, len(curve) // 10) :].mean()
    away = np.flatnonzero(np.abs(curve - last) > tolerance * abs(last))
    return float(at[min(away[-1] + 1, len(curve) - 1)]) if away.size else float(at[0])


def as_table(metrics: list[dict]) -> str:
    """Metrics as aligned lines."""
    return "\n".join(
        f"{m['key']:34s} {m['value']:>10.4g} {m['unit']:3s} {m['note']}" for m in metrics
    )
