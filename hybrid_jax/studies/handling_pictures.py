# SPDX-License-Identifier: MIT
"""Chart of the handling study: success rates of the methods, and causes of failure."""

from collections import Counter
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402
from scipy.stats import binomtest  # noqa: E402

_COLOURS = plt.get_cmap("tab10").colors  # type: ignore[attr-defined]


def _bars(ax, rows: list[dict], methods: list[str]) -> None:
    """Draw full-task and per-object success with Wilson 95 % intervals."""
    for shift, label in ((-0.2, "all objects"), (0.2, "each object")):
        for i, method in enumerate(methods):
            runs = [row for row in rows if row["method"] == method]
            successes = [row["success"] for row in runs]
            if shift > 0:
                successes = [item["success"] for row in runs for item in row["objects"]]
            rate, interval = (
                np.mean(successes),
                binomtest(sum(successes), len(successes)).proportion_ci(method="wilson"),
            )
            colour = _COLOURS[0] if shift < 0 else _COLOURS[9]
            ax.barh(i + shift, rate, 0.38, color=colour, label=label if i == 0 else None)
            spread = [[rate - interval.low], [interval.high - rate]]
            ax.errorbar(rate, i + shift, xerr=spread, color="black", capsize=3)
    ax.set(xlabel="share of runs", xlim=(0, 1.08), title="success, 95 % intervals")
    _name_rows(ax, methods)


def _causes(ax, rows: list[dict], methods: list[str]) -> None:
    """Draw the numbers of failed objects by cause."""
    counts = {
        method: Counter(
            item["cause"]
            for row in rows
            if row["method"] == method
            for item in row["objects"]
            if not item["success"]
        )
        for method in methods
    }
    causes = sorted({cause for count in counts.values() for cause in count})
    offsets = np.zeros(len(methods))
    for k, cause in enumerate(causes):
        width = np.array([counts[method][cause] for method in methods], float)
        colour = _COLOURS[(k + 1) % len(_COLOURS)]
        ax.barh(range(len(methods)), width, 0.6, left=offsets, label=cause, color=colour)
        offsets += width
    ax.set(xlabel="objects", title="what failed")
    _name_rows(ax, methods)


def _name_rows(ax, methods: list[str]) -> None:
    """Name the rows of a chart after the methods, the first on top."""
    ax.set_yticks(range(len(methods)), methods)
    ax.invert_yaxis()


def draw_study(path: Path, rows: list[dict]) -> None:
    """Draw one chart of all methods.

    Args:
        path: PNG to write.
        rows: runs, see `handling.row_of`.
    """
    methods = list(dict.fromkeys(row["method"] for row in rows))
    size = (13, 1.6 + 0.34 * len(methods))
    fig, axes = plt.subplots(1, 2, figsize=size, layout="constrained")
    _bars(axes[0], rows, methods)
    _causes(axes[1], rows, methods)
    for axis, place in zip(axes, ("outside lower left", "outside lower right"), strict=True):
        labels = axis.get_legend_handles_labels()
        fig.legend(*labels, loc=place, ncols=4, frameon=False)
    fig.savefig(path, dpi=110)
    plt.close(fig)
