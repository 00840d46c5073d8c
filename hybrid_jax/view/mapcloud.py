# SPDX-License-Identifier: MIT
"""The feasibility map as a cloud: one point a voxel, sliced, and filtered by reason."""

import matplotlib
import numpy as np
import viser

from hybrid_jax.feasibility.building import FeasibilityMap
from hybrid_jax.feasibility.judging import Reason

_ALL = "all"
_SHARE = "feasible share"
_POINT = 0.15
"""Size of a point, as a share of a voxel."""


def reason_names() -> list[str]:
    """Reasons as people read them."""
    return [reason.name.lower().replace("_", " ") for reason in Reason]


def voxel_shares(fmap: FeasibilityMap, turn: int | None) -> np.ndarray:
    """Share of each reason in each voxel `[x, y, z, reason]`, over all orientations or of one."""
    reason = np.asarray(fmap.reason)
    chosen = reason if turn is None else reason[..., turn : turn + 1]
    return np.stack([(chosen == r).mean(axis=-1) for r in Reason], axis=-1)


def centres(fmap: FeasibilityMap) -> np.ndarray:
    """Voxel centres `[x, y, z, 3]` [m]."""
    shape, lower, step = fmap.reason.shape[:3], np.asarray(fmap.lower), float(fmap.spacing)
    axes = [lower[i] + step * np.arange(n) for i, n in enumerate(shape)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1)


def chosen_points(
    shares: np.ndarray, points: np.ndarray, reason: int | None, axis: int | None, place: float
) -> tuple[np.ndarray, np.ndarray]:
    """Which voxels are shown, and the share that colours each.

    Args:
        shares: see `voxel_shares`.
        points: see `centres`.
        reason: shows the voxels that have any of it, coloured by how much; None shows all, coloured
            by how much is feasible.
        axis: 0 to 2 to show the slice nearest to `place` [m] along it; None for all.
        place: see there.

    Returns:
        `[n, 3]` points and `[n]` shares.
    """
    value = shares[..., Reason.FEASIBLE if reason is None else reason]
    shown = np.ones(value.shape, bool) if reason is None else value > 0
    if axis is not None:
        at = points[..., axis]
        nearest = at.ravel()[np.abs(at.ravel() - place).argmin()]
        shown &= np.isclose(at, nearest)
    return points[shown], value[shown]


class MapCloud:
    """The cloud and its controls."""

    def __init__(self, server: viser.ViserServer, fmap: FeasibilityMap):
        """Add both to a page."""
        self._server, self._map, self._points = server, fmap, centres(fmap)
        flat = self._points.reshape(-1, 3)
        self._low, self._high = flat.min(axis=0), flat.max(axis=0)
        gui, turns = server.gui, fmap.reason.shape[-1]
        self.shown = gui.add_checkbox("Show map", initial_value=False)
        self.reason = gui.add_dropdown("Reason", options=(_SHARE, *reason_names()))
        self.axis = gui.add_dropdown("Slice", options=(_ALL, "x", "y", "z"))
        self.place = gui.add_slider("Slice at [%]", min=0, max=100, step=1, initial_value=50)
        self.turn = gui.add_slider(
            "Orientation (0: all)", min=0, max=turns, step=1, initial_value=0
        )
        self.told = gui.add_markdown("")
        for control in (self.shown, self.reason, self.axis, self.place, self.turn):
            control.on_update(lambda _: self.draw())
        self.draw()

    def draw(self) -> None:
        """Show what the controls say."""
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
            "/map", points, (255 * colours).astype(np.uint8), point_shape="circle",
            point_size=_POINT * float(self._map.spacing),
        )  # fmt: skip

    def _sentence(self, shares, reason, axis, place, count: int) -> str:
        which = "feasible" if reason is None else reason_names()[reason]
        whole = shares[..., Reason.FEASIBLE if reason is None else reason].mean()
        where = "" if axis is None else f", {'xyz'[axis]} = {place:.2f} m"
        return f"{count} voxels{where}; {100 * whole:.1f} % of the poses: {which}"
