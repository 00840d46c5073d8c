# SPDX-License-Identifier: MIT
"""Picture of a feasibility map: the paper's voxels in the cell, slices through it, and reasons."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402
from matplotlib.colors import ListedColormap  # noqa: E402
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection  # noqa: E402
from scipy.spatial.transform import Rotation  # noqa: E402

from hybrid_jax.feasibility.building import FeasibilityMap  # noqa: E402
from hybrid_jax.feasibility.evaluation import Reason  # noqa: E402
from hybrid_jax.types import Workcell  # noqa: E402

REASON_COLOURS = ("firebrick", "orange", "steelblue", "slateblue", "tab:gray", "whitesmoke")
"""Colours of the reasons, in the order of `Reason`."""
SHARES = "coolwarm"
"""Colours of the feasible share, as in the paper: blue where no orientation is feasible, to red."""
_CORNERS = np.array(np.meshgrid(*[(-1.0, 1.0)] * 3, indexing="ij")).reshape(3, 8).T
_EDGES = [
    (a, b) for a in range(8) for b in range(a) if np.abs(_CORNERS[a] - _CORNERS[b]).sum() == 2.0
]


def fixture_edges(cell: Workcell) -> np.ndarray:
    """Edges `[fixture, 12, 2, 3]` of the boxes around the cell's fixtures [m]."""
    fixtures = cell.fixtures
    boxes = []
    for number in np.flatnonzero(fixtures.active):
        pose = np.asarray(fixtures.pose[number], float)
        half = np.asarray(fixtures.half_extents[number] + fixtures.radius[number], float)
        turned = Rotation.from_quat(pose[3:], scalar_first=True).apply(_CORNERS * half)
        boxes.append([[pose[:3] + turned[a], pose[:3] + turned[b]] for a, b in _EDGES])
    return np.array(boxes).reshape(-1, len(_EDGES), 2, 3)


def outline(edges: np.ndarray, across: int, place: float) -> np.ndarray:
    """Outline of a box in a plane across an axis.

    Args:
        edges: `[12, 2, 3]` of the box [m].
        across: number of the axis.
        place: where the plane cuts it [m].

    Returns:
        `[n, 2]` corners in turn, in the other two axes' order; none where they do not meet.
    """
    low, high = edges[:, 0, across] - place, edges[:, 1, across] - place
    cut = low * high < 0
    share = (low[cut] / (low[cut] - high[cut]))[:, None]
    points = edges[cut, 0] + share * (edges[cut, 1] - edges[cut, 0])
    corners = np.delete(points, across, axis=1)
    spokes = corners - corners.mean(axis=0) if len(corners) else corners
    return corners[np.argsort(np.arctan2(spokes[:, 1], spokes[:, 0]))]


def exposed_faces(filled: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Faces of voxels that no other voxel covers.

    Args:
        filled: `[x, y, z]` True where there is a voxel.

    Returns:
        Corners `[face, 4, 3]` in numbers of the grid's planes, and the voxel `[face, 3]` of each.
    """
    padded, faces, owners = np.pad(filled, 1), [], []
    for axis in range(3):
        square = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
        for side in (0, 1):
            neighbour = np.roll(padded, 1 - 2 * side, axis)[1:-1, 1:-1, 1:-1]
            voxels = np.argwhere(filled & ~neighbour)
            faces.append(voxels[:, None] + np.insert(square, axis, side, axis=1))
            owners.append(voxels)
    return np.concatenate(faces), np.concatenate(owners)


def _lines(edges: np.ndarray) -> Line3DCollection:
    """Edges `[fixture, 12, 2, 3]` as lines that end at the picture's box."""
    return Line3DCollection(
        edges.reshape(-1, 2, 3), colors="black", linewidths=0.8, axlim_clip=True
    )


def _voxels(ax, share: np.ndarray, axes: list[np.ndarray], edges: np.ndarray) -> None:
    """Draw the paper's figure, cut open, in the cell: cubes by their feasible share `[x, y, z]`."""
    spacing = [np.diff(a[:2])[0] if len(a) > 1 else 0.1 for a in axes]
    bounds = [np.append(a - s / 2, a[-1] + s / 2) for a, s in zip(axes, spacing, strict=True)]
    x, y, _ = np.meshgrid(*axes, indexing="ij")
    cut_open = (x > np.median(axes[0])) & (y < np.median(axes[1]))
    faces, owners = exposed_faces((share > 0) & ~cut_open)
    corners = np.stack([bounds[axis][faces[..., axis]] for axis in range(3)], axis=-1)
    colours = matplotlib.colormaps[SHARES](share[tuple(owners.T)])
    light = np.where(faces[:, 0] == faces[:, 2], [1.0, 0.85, 0.7], 0.0).max(axis=1)[:, None]
    colours[:, :3] *= light  # sides of a cube differ, as under a lamp
    cubes = Poly3DCollection(corners, facecolors=colours, edgecolors=(0, 0, 0, 0.15))
    # a cell may have no fixtures, and a map no feasible pose: matplotlib fails at no lines
    for collection in ([cubes] if len(faces) else []) + ([_lines(edges)] if len(edges) else []):
        ax.add_collection3d(collection, autolim=False)
    limits = [(b[0] - 0.1, b[-1] + 0.1) for b in bounds]
    ax.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    ax.set(xlim=limits[0], ylim=limits[1], zlim=limits[2])
    ax.set_title("feasible share of orientations, cut open")
    ax.view_init(elev=28, azim=-50)
    ax.set_aspect("equal")
    ax.locator_params(nbins=5)


def _slice(ax, values: np.ndarray, axes: list[np.ndarray], across: int, edges, **style):
    """Draw the middle slice of a field `[x, y, z]` across one axis, with the fixtures' outlines."""
    middle = values.shape[across] // 2
    place = float(axes[across][middle])
    u, v = (i for i in range(3) if i != across)
    step = [np.diff(axes[i][:2])[0] / 2 if len(axes[i]) > 1 else 0.05 for i in (u, v)]
    extent = (
        axes[u][0] - step[0],
        axes[u][-1] + step[0],
        axes[v][0] - step[1],
        axes[v][-1] + step[1],
    )
    # an image's rows run along its vertical axis: transposed, u runs to the right and v upwards
    image = ax.imshow(np.take(values, middle, across).T, origin="lower", extent=extent, **style)
    for box in edges:
        corners = outline(box, across, place)
        if len(corners):
            ax.fill(*corners.T, facecolor=(0, 0, 0, 0.25), edgecolor="black", lw=1.0)
    ax.set(
        xlabel=f"{'xyz'[u]} [m]",
        ylabel=f"{'xyz'[v]} [m]",
        title=f"at {'xyz'[across]} = {round(place, 2) + 0.0:.2f} m",
        xlim=extent[:2],
        ylim=extent[2:],
    )
    return image


def draw_map(path: Path, cell: Workcell, fmap: FeasibilityMap) -> None:
    """Draw the paper's figure (blue infeasible to red feasible), slices of it, and the reasons.

    Args:
        path: PNG to write.
        cell: whose fixtures are drawn in.
        fmap: with reasons `[x, y, z, orientation]`.
    """
    reason, edges = np.asarray(fmap.reason), fixture_edges(cell)
    counts = np.stack([(reason == r).mean(axis=-1) for r in Reason])
    share, lower, spacing = counts[Reason.FEASIBLE], np.asarray(fmap.lower), float(fmap.spacing)
    axes = [lower[i] + spacing * np.arange(n) for i, n in enumerate(share.shape)]
    fig = plt.figure(figsize=(16, 10))
    _voxels(fig.add_subplot(2, 3, 1, projection="3d"), share, axes, edges)
    names = [r.name.lower().replace("_", " ") for r in Reason]
    bars = fig.add_subplot(2, 3, 2)
    bars.barh(names, counts.mean(axis=(1, 2, 3)), color=REASON_COLOURS, edgecolor="black")
    bars.invert_yaxis()
    bars.set(xlabel="share of poses", title="reasons")
    common, last = fig.add_subplot(2, 3, 3), len(Reason) - 1
    colours = ListedColormap(REASON_COLOURS)
    _slice(common, counts.argmax(axis=0), axes, 2, edges, cmap=colours, vmin=0, vmax=last)
    common.set_title("most frequent reason, " + common.get_title())
    for across in range(3):
        ax = fig.add_subplot(2, 3, 4 + across)
        image = _slice(ax, share, axes, across, edges, cmap=SHARES, vmin=0, vmax=1)
    fig.colorbar(image, ax=fig.axes[-1], shrink=0.8, label="feasible share")
    fig.tight_layout()
    fig.savefig(path, dpi=110)
    plt.close(fig)
