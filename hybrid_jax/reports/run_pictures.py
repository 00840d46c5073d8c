# SPDX-License-Identifier: MIT
"""Pictures of a run: learning curves and the feasibility map."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402
from matplotlib.colors import ListedColormap  # noqa: E402

from hybrid_jax.feasibility.building import FeasibilityMap  # noqa: E402
from hybrid_jax.feasibility.evaluation import Reason


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


_REASON_COLOURS = ("firebrick", "orange", "steelblue", "slateblue", "tab:gray", "whitesmoke")
"""Colours of the reasons, in the order of `Reason`."""


def _share_cloud(ax, share: np.ndarray, axes: list[np.ndarray]):
    """Draw the paper's figure: voxels coloured by their share `[x, y, z]` of feasible poses."""
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    cloud = ax.scatter(*grid.T, c=share.ravel(), cmap="coolwarm", s=10, alpha=0.5, vmin=0, vmax=1)
    ax.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]", title="feasible share of orientations")
    ax.set_aspect("equal")
    ax.locator_params(nbins=5)
    return cloud


def _slice(ax, values: np.ndarray, axes: list[np.ndarray], across: int, **style) -> None:
    """Draw the middle slice of a field `[x, y, z]` across one axis."""
    middle = values.shape[across] // 2
    u, v = (i for i in range(3) if i != across)
    step = [np.diff(axes[i][:2])[0] / 2 if len(axes[i]) > 1 else 0.05 for i in (u, v)]
    extent = (
        axes[u][0] - step[0],
        axes[u][-1] + step[0],
        axes[v][0] - step[1],
        axes[v][-1] + step[1],
    )
    # an image's rows run along its vertical axis: transposed, u runs to the right and v upwards
    ax.imshow(np.take(values, middle, across).T, origin="lower", extent=extent, **style)
    ax.set(
        xlabel=f"{'xyz'[u]} [m]",
        ylabel=f"{'xyz'[v]} [m]",
        title=f"at {'xyz'[across]} = {round(float(axes[across][middle]), 2) + 0.0:.2f} m",
    )


def draw_map(path: Path, fmap: FeasibilityMap) -> None:
    """Draw the paper's figure (blue infeasible to red feasible), slices of it, and the reasons.

    Args:
        path: PNG to write.
        fmap: with reasons `[x, y, z, orientation]`.
    """
    reason = np.asarray(fmap.reason)
    share = (reason == Reason.FEASIBLE).mean(axis=-1)
    lower, spacing = np.asarray(fmap.lower), float(fmap.spacing)
    axes = [lower[i] + spacing * np.arange(n) for i, n in enumerate(share.shape)]
    counts = np.stack([(reason == r).mean(axis=-1) for r in Reason])
    fig = plt.figure(figsize=(15, 9), layout="constrained")
    cloud = fig.add_subplot(2, 3, 1, projection="3d")
    fig.colorbar(_share_cloud(cloud, share, axes), ax=cloud, shrink=0.7)
    names = [r.name.lower().replace("_", " ") for r in Reason]
    bars = fig.add_subplot(2, 3, 2)
    bars.barh(names, counts.mean(axis=(1, 2, 3)), color=_REASON_COLOURS, edgecolor="black")
    bars.invert_yaxis()
    bars.set(xlabel="share of poses", title="reasons")
    common = fig.add_subplot(2, 3, 3)
    _slice(
        common,
        counts.argmax(axis=0),
        axes,
        2,
        cmap=ListedColormap(_REASON_COLOURS),
        vmin=0,
        vmax=len(Reason) - 1,
    )
    common.set_title("most frequent reason, " + common.get_title())
    for across in range(3):
        ax = fig.add_subplot(2, 3, 4 + across)
        _slice(ax, share, axes, across, cmap="coolwarm", vmin=0, vmax=1)
    fig.savefig(path, dpi=110)
    plt.close(fig)
