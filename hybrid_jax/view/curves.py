# SPDX-License-Identifier: MIT
"""Learning curves of a run on a page."""

import numpy as np
import viser
from viser import uplot

from hybrid_jax.runs.run_folder import Run

SHOWN = {
    "lfd": ("cost_over_optimum", "reward"),
    "drl": ("success", "reward"),
    "switch": ("reward",),
}
"""Metrics of each agent's stage that are drawn."""


def curve_of(run: Run, stage: str, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Steps `[row]` and values `[row]` of one metric; empty where it was not logged."""
    rows = [(row["step"], row[name]) for row in run.metrics(stage) if name in row]
    steps, values = np.array(rows, float).reshape(-1, 2).T
    return steps, values


def add_curves(server: viser.ViserServer, run: Run) -> int:
    """Add a chart for each metric that was logged.

    Returns:
        Number of charts.
    """
    count = 0
    for stage, names in SHOWN.items():
        for name in names:
            steps, values = curve_of(run, stage, name)
            if len(steps) > 1:
                label = name.replace("_", " ")
                server.gui.add_uplot(
                    (steps, values),
                    (uplot.Series(label="step"), uplot.Series(label=label, stroke="#1478dc")),
                    scales={"x": uplot.Scale(time=False)},
                    title=f"{stage}: {label}",
                    aspect=1.8,
                )
                count += 1
    if not count:
        server.gui.add_markdown("This run has no learning curves yet.")
    return count
