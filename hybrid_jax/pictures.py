# SPDX-License-Identifier: MIT
"""Pictures of a run: learning curves, the feasibility map, a film of the execution."""

import warnings
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt  # noqa: E402
import mujoco  # noqa: E402
import numpy as np  # noqa: E402
from matplotlib.colors import ListedColormap  # noqa: E402

from hybrid_jax.feasibility.building import FeasibilityMap  # noqa: E402
from hybrid_jax.feasibility.judging import Reason  # noqa: E402
from hybrid_jax.types import Workcell  # noqa: E402

FPS = 12
"""Frames of a film per simulated second."""


def draw_curves(
    path: Path, rows: list[dict], title: str, unit: str, names: tuple[str, ...]
) -> None:
    """One panel for each metric over the training's steps."""
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
"""Of each `Reason`, in its order."""


def _share_cloud(ax, share: np.ndarray, axes: list[np.ndarray]):
    """The paper's figure: voxels coloured by the share of feasible orientations."""
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    shown = ax.scatter(*grid.T, c=share.ravel(), cmap="coolwarm", s=10, alpha=0.5, vmin=0, vmax=1)
    ax.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]", title="feasible share of orientations")
    ax.set_aspect("equal")
    ax.locator_params(nbins=5)
    return shown


def _slice(ax, values: np.ndarray, axes: list[np.ndarray], across: int, **style) -> None:
    """The middle slice of a field across one axis."""
    middle = values.shape[across] // 2
    u, v = (i for i in range(3) if i != across)
    step = [np.diff(axes[i][:2])[0] / 2 if len(axes[i]) > 1 else 0.05 for i in (u, v)]
    extent = (axes[u][0] - step[0], axes[u][-1] + step[0],
              axes[v][0] - step[1], axes[v][-1] + step[1])  # fmt: skip
    ax.imshow(np.take(values, middle, across).T, origin="lower", extent=extent, **style)
    ax.set(xlabel=f"{'xyz'[u]} [m]", ylabel=f"{'xyz'[v]} [m]",
           title=f"at {'xyz'[across]} = {round(axes[across][middle], 2) + 0.0:.2f} m")  # fmt: skip


def draw_map(path: Path, fmap: FeasibilityMap) -> None:
    """The paper's figure (blue infeasible to red feasible), slices of it, and the reasons."""
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
    _slice(common, counts.argmax(axis=0), axes, 2, cmap=ListedColormap(_REASON_COLOURS),
           vmin=0, vmax=len(Reason) - 1)  # fmt: skip
    common.set_title("most frequent reason, " + common.get_title())
    for across in range(3):
        ax = fig.add_subplot(2, 3, 4 + across)
        _slice(ax, share, axes, across, cmap="coolwarm", vmin=0, vmax=1)
    fig.savefig(path, dpi=110)
    plt.close(fig)


def make_renderer(model: mujoco.MjModel) -> mujoco.Renderer | None:
    """Off-screen renderer; None (and a sentence) where neither EGL nor OSMesa works."""
    try:
        return mujoco.Renderer(model, 360, 480)
    except Exception as error:  # noqa: BLE001  GL back ends raise whatever they like
        print(
            f"no film: off-screen rendering failed ({type(error).__name__}); install EGL or set "
            "MUJOCO_GL=osmesa with OSMesa installed. The rest of the run is not affected."
        )
        return None


class Film:
    """Collects frames of a simulation."""

    def __init__(self, cell: Workcell):
        self.renderer = make_renderer(cell.model)
        if self.renderer is not None:  # software renderers spend most of their time on shadows
            self.renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
            self.renderer.scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = 0
        self.camera = (
            "overview"
            if any(cell.model.camera(i).name == "overview" for i in range(cell.model.ncam))
            else -1
        )
        self.frames: list[np.ndarray] = []

    def watch(self, data: mujoco.MjData) -> None:
        """Take a frame if it is time for one."""
        if self.renderer is not None and data.time * FPS >= len(self.frames):
            self.renderer.update_scene(data, camera=self.camera)
            self.frames.append(self.renderer.render().copy())

    def save(self, folder: Path) -> None:
        """Write `demo.png` (six moments) and, where ffmpeg is there, `demo.mp4`."""
        if self.renderer is not None:
            self.renderer.close()
        if not self.frames:
            return
        moments = [self.frames[int(i)] for i in np.linspace(0, len(self.frames) - 1, 6)]
        rows = [np.concatenate(moments[:3], axis=1), np.concatenate(moments[3:], axis=1)]
        plt.imsave(folder / "demo.png", np.concatenate(rows))
        try:
            import imageio.v2 as imageio  # noqa: PLC0415

            with warnings.catch_warnings():
                # JAX warns of every fork; this child starts ffmpeg at once
                warnings.simplefilter("ignore", RuntimeWarning)
                imageio.mimwrite(folder / "demo.mp4", self.frames, fps=FPS, macro_block_size=1)
        except (ImportError, OSError, ValueError) as error:
            print(f"no demo.mp4 ({error}); the moments are in demo.png")
