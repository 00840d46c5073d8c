# SPDX-License-Identifier: MIT
"""The feasibility map as a point cloud: one point a voxel, sliced, and filtered by reason."""

import matplotlib
import numpy as np
import viser

from hybrid_jax.feasibility.building import FeasibilityMap
from hybrid_jax.feasibility.evaluation import Reason

_ALL = "all"
_SHARE = "feasible share"
_POINT, _SLICED = 0.15, 0.6
"""Size of a point as a share of a voxel, where all are shown and in a slice."""


def reason_names() -> list[str]:
    """Names of the reasons in words, in the order of `Reason`."""
    return [reason.name.lower().replace("_", " ") for reason in Reason]


def voxel_shares(fmap: FeasibilityMap, turn: int | None) -> np.ndarray:
    """Share of each reason in each voxel, over all orientations or in one.

    Args:
        fmap: with reasons `[x, y, z, orientation]`.
        turn: index of the orientation; None for all.

    Returns:
        `[x, y, z, reason]` shares from 0 to 1.
    """
    reason = np.asarray(fmap.reason)
    selected = reason if turn is None else reason[..., turn : turn + 1]
    return np.stack([(selected == r).mean(axis=-1) for r in Reason], axis=-1)


def centres(fmap: FeasibilityMap) -> np.ndarray:
    """Centres of the voxels `[x, y, z, 3]` [m]."""
    shape, lower, step = fmap.reason.shape[:3], np.asarray(fmap.lower), float(fmap.spacing)
    axes = [lower[i] + step * np.arange(n) for i, n in enumerate(shape)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1)


def chosen_points(
    shares: np.ndarray, points: np.ndarray, reason: int | None, axis: int | None, place: float
) -> tuple[np.ndarray, np.ndarray]:
    """Voxels that are shown, and the share that colours each.

    Args:
        shares: `[x, y, z, reason]` from `voxel_shares`.
        points: `[x, y, z, 3]` from `centres` [m].
        reason: shows the voxels with a share of it above 0, coloured by that share; None shows all,
            coloured by the feasible share.
        axis: 0 to 2 for the slice nearest to `place` along x, y or z; None for all voxels.
        place: coordinate of the slice [m].

    Returns:
        `[n, 3]` points [m] and `[n]` shares.
    """
    value = shares[..., Reason.FEASIBLE if reason is None else reason]
    mask = np.ones(value.shape, bool) if reason is None else value > 0
    if axis is not None:
        coordinates = points[..., axis]
        nearest = coordinates.ravel()[np.abs(coordinates.ravel() - place).argmin()]
        mask &= np.isclose(coordinates, nearest)
    return points[mask], value[mask]


class MapCloud:
    """The point cloud and its controls."""

    def __init__(self, server: viser.ViserServer, fmap: FeasibilityMap):
        """Add cloud and controls to a page."""
        self._server, self._map, self._points = server, fmap, centres(fmap)
        flat = self._points.reshape(-1, 3)
        self._low, self._high = flat.min(axis=0), flat.max(axis=0)
        gui, turns = server.gui, fmap.reason.shape[-1]
        self.shown = gui.add_checkbox("Show map", initial_value=True)
        self.reason = gui.add_dropdown("Reason", options=(_SHARE, *reason_names()))
        # a slice leaves the arm in sight
        self.axis = gui.add_dropdown("Slice", options=(_ALL, "x", "y", "z"), initial_value="y")
        self.place = gui.add_slider("Slice at [%]", min=0, max=100, step=1, initial_value=50)
        self.turn = gui.add_slider(
            "Orientation (0: all)", min=0, max=turns, step=1, initial_value=0
        )
        self.told = gui.add_markdown("")
        for control in (self.shown, self.reason, self.axis, self.place, self.turn):
            control.on_update(lambda _: self.draw())
        self.draw()

    def draw(self) -> None:
        """Draw the cloud as the controls say."""
        reason = None if self.reason.value == _SHARE else reason_names().index(self.reason.value)
        axis = None if self.axis.value == _ALL else "xyz".index(self.axis.value)
        turn = int(self.turn.value) - 1 if self.turn.value else None
        i = axis or 0
        place = float(self._low[i] + self.place.value / 100 * (self._high[i] - self._low[i]))
        shares = voxel_shares(self._map, turn)
        points, values = chosen_points(shares, self._points, reason, axis, place)
        self.told.content = self._sentence(shares, reason, axis, place, len(points))
        if not self.shown.value or not len(points):
            self._server.scene.remove_by_name("/map")
            return
        colours = matplotlib.colormaps["coolwarm"](values)[:, :3]
        self._server.scene.add_point_cloud(
            "/map",
            points,
            (255 * colours).astype(np.uint8),
            point_shape="circle",
            point_size=(_POINT if axis is None else _SLICED) * float(self._map.spacing),
        )

    def _sentence(self, shares, reason, axis, place, count: int) -> str:
        label = "feasible" if reason is None else reason_names()[reason]
        mean_share = shares[..., Reason.FEASIBLE if reason is None else reason].mean()
        slice_text = "" if axis is None else f", {'xyz'[axis]} = {place:.2f} m"
        return f"{count} voxels{slice_text}; {100 * mean_share:.1f} % of the poses: {label}"
