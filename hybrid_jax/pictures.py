# SPDX-License-Identifier: MIT
"""Pictures of a run: learning curves, the feasibility map, a film of the execution."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt  # noqa: E402
import mujoco  # noqa: E402
import numpy as np  # noqa: E402

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
        axis.grid(alpha=0.3)
    fig.suptitle(title)
    fig.savefig(path, dpi=110)
    plt.close(fig)


def draw_map(path: Path, fmap: FeasibilityMap) -> None:
    """The paper's figure (blue infeasible to red feasible), a slice, and the reasons."""
    reason = np.asarray(fmap.reason)
    share = (reason == Reason.FEASIBLE).mean(axis=-1)
    lower, spacing = np.asarray(fmap.lower), float(fmap.spacing)
    grid = np.stack(
        np.meshgrid(
            *[lower[i] + spacing * np.arange(n) for i, n in enumerate(share.shape)], indexing="ij"
        ),
        -1,
    )
    fig = plt.figure(figsize=(15, 4.6), layout="constrained")
    cloud = fig.add_subplot(1, 3, 1, projection="3d")
    shown = cloud.scatter(
        *grid.reshape(-1, 3).T, c=share.ravel(), cmap="coolwarm", s=14, alpha=0.55, vmin=0, vmax=1
    )
    cloud.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    cloud.set_title("feasible share of orientations")
    fig.colorbar(shown, ax=cloud, shrink=0.7)
    middle = share.shape[2] // 2 if share.shape[2] > 1 else 0
    cut = fig.add_subplot(1, 3, 2)
    extent = (
        lower[0] - spacing / 2,
        lower[0] + spacing * (share.shape[0] - 0.5),
        lower[1] - spacing / 2,
        lower[1] + spacing * (share.shape[1] - 0.5),
    )
    cut.imshow(
        share[:, :, middle].T, origin="lower", extent=extent, cmap="coolwarm", vmin=0, vmax=1
    )
    cut.set(
        xlabel="x [m]", ylabel="y [m]", title=f"slice at z = {lower[2] + spacing * middle:.2f} m"
    )
    bars = fig.add_subplot(1, 3, 3)
    counts = [(reason == r).mean() for r in Reason]
    bars.barh([r.name.lower().replace("_", " ") for r in Reason], counts, color="tab:gray")
    bars.invert_yaxis()
    bars.set(xlabel="share of poses", title="reasons")
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

            imageio.mimwrite(folder / "demo.mp4", self.frames, fps=FPS, macro_block_size=1)
        except (ImportError, OSError, ValueError) as error:
            print(f"no demo.mp4 ({error}); the moments are in demo.png")
