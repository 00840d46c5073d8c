# SPDX-License-Identifier: MIT
"""Learning curves of a run."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402


def draw_curves(
    path: Path, rows: list[dict], title: str, unit: str, names: tuple[str, ...]
) -> None:
    """Draw one panel for each metric over the training's steps.

    Args:
        path: PNG to write.
        rows: metrics, each with its `step`.
        title: of the figure.
        unit: name of the steps.
        names: metrics to draw.
    """
    fig, axes = plt.subplots(1, len(names), figsize=(5 * len(names), 3.2), layout="constrained")
    for axis, name in zip(np.atleast_1d(axes), names, strict=True):
        points = [(row["step"], row[name]) for row in rows if name in row]
        if points:
            axis.plot(*zip(*points, strict=True), lw=1.2)
        axis.set(xlabel=unit, ylabel=name.replace("_", " "))
        axis.locator_params(axis="x", nbins=5)
        axis.grid(alpha=0.3)
    fig.suptitle(title)
    fig.savefig(path, dpi=110)
    plt.close(fig)
