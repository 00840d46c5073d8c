# SPDX-License-Identifier: MIT
"""Charts of the inspection study: success of each task, errors of strokes, learning curves."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402

from hybrid_jax.runs.run_folder import Run

TITLES = {"5cm_5deg": "5 cm, 5 deg", "1cm_2deg": "1 cm, 2 deg", "1mm_05deg": "1 mm, 0.5 deg"}
"""Titles of the tolerances."""
_COLOURS = plt.get_cmap("tab10").colors  # type: ignore[attr-defined]


def _tasks(ax, rows: list[dict], level: str) -> None:
    """Draw the success of each method on each part."""
    methods = list(dict.fromkeys(row["method"] for row in rows))
    parts = list(dict.fromkeys(row["part"] for row in rows))
    width = 0.8 / len(methods)
    for i, method in enumerate(methods):
        rates = [
            np.mean([r["success"][level] for r in rows if r["method"] == method and r["part"] == p])
            for p in parts
        ]
        positions = np.arange(len(parts)) + (i - (len(methods) - 1) / 2) * width
        ax.bar(positions, rates, width, label=method, color=_COLOURS[i])
    ax.set(ylabel="share of trials", ylim=(0, 1.05), title=f"success at {TITLES.get(level, level)}")
    ax.set_xticks(range(len(parts)), parts, rotation=45)


def _strokes(ax, rows: list[dict], key: str, unit: str) -> None:
    """Draw the distribution of a stroke's error over all trials of each method."""
    for i, method in enumerate(dict.fromkeys(row["method"] for row in rows)):
        values = [row[key] for row in rows if row["method"] == method and key in row]
        if values:
            share = np.arange(1, len(values) + 1) / len(values)
            ax.plot(np.sort(values), share, label=method, color=_COLOURS[i])
    ax.set(
        xlabel=f"{key.rsplit('_', 2)[0].replace('_', ' ')}, RMS of a stroke [{unit}]",
        ylabel="share of strokes",
        xscale="log",
    )
    ax.xaxis.set_major_formatter("{x:g}")
    ax.xaxis.set_minor_formatter("")
    ax.grid(alpha=0.3)


def _learning(ax, curves: dict[str, list[dict]], name: str, title: str) -> None:
    """Draw a metric over the episodes of trainings."""
    for i, (label, rows) in enumerate(curves.items()):
        logged = [row for row in rows if name in row]
        episodes = (
            [row["episodes"] for row in logged] if logged and "episodes" in logged[0] else None
        )
        steps = np.cumsum(episodes) if episodes else [row["step"] for row in logged]
        ax.plot(steps, [row[name] for row in logged], label=label, color=_COLOURS[i], lw=1.2)
    ax.set(xlabel="episodes", ylabel=name.replace("_", " "), title=title)
    ax.grid(alpha=0.3)
    ax.legend()


def draw_study(path: Path, rows: list[dict], run: Run) -> None:
    """Draw one chart of all methods.

    Args:
        path: PNG to write.
        rows: trials, see `inspection.row_of`.
        run: whose trainings are drawn.
    """
    fig, axes = plt.subplots(2, 3, figsize=(16, 8), layout="constrained")
    levels = list(rows[0]["success"])
    _tasks(axes[0, 0], rows, levels[0])
    _tasks(axes[0, 1], rows, levels[-1])
    _strokes(axes[0, 2], rows, "brush_angle_rms_deg", "deg")
    _strokes(axes[1, 2], rows, "stand_off_rms_mm", "mm")
    axes[0, 0].legend(loc="lower left")
    _learning(axes[1, 0], {"RL-LfD": run.metrics("lfd")}, "cost_over_optimum", "RL-LfD")
    joint = {"DRL-Feasibility": run.metrics("drl"), "pure DRL": run.metrics("alone")}
    _learning(axes[1, 1], {k: v for k, v in joint.items() if v}, "success", "joint agents")
    fig.savefig(path, dpi=110)
    plt.close(fig)
