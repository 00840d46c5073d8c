# SPDX-License-Identifier: MIT
"""Playback of a plan: time slider, clearance over time, path of the tool by source."""

import time
from collections.abc import Callable

import numpy as np
import viser
from viser import uplot

from hybrid_jax.types import Source
from hybrid_jax.view.motion import RATE, Motion

COLOURS = {Source.LFD: (30, 120, 220), Source.DRL: (235, 120, 20), Source.RRT: (150, 60, 190)}
"""Colours of the tool's path, by source (red, green, blue)."""
NAMES = {Source.LFD: "skill", Source.DRL: "joint agent", Source.RRT: "RRT-Connect"}


class Playback:
    """Shows the frames of a motion."""

    def __init__(self, server: viser.ViserServer, show: Callable[[np.ndarray], None]):
        """Add the controls to a page.

        Args:
            server: of the page.
            show: draws a configuration `[nq]`.
        """
        self._server, self._show, self.motion = server, show, None
        self._began: float | None = None
        self.button = server.gui.add_button("Play", disabled=True)
        self.at = server.gui.add_slider(
            "Time [s]", min=0.0, max=1.0, step=0.01, initial_value=0.0, disabled=True
        )
        self.told = server.gui.add_markdown("")
        self.chart = server.gui.add_uplot(
            (np.zeros(2), np.zeros(2)),
            (uplot.Series(label="time [s]"), uplot.Series(label="mm", stroke="#1478dc")),
            scales={"x": uplot.Scale(time=False)},
            title="clearance [mm]",
            aspect=1.8,
            visible=False,
        )
        self.button.on_click(lambda _: self.toggle())
        self.at.on_update(lambda _: self.draw())

    def load(self, motion: Motion | None) -> None:
        """Show a motion from its start; None removes the last one."""
        self.motion, self._began = motion, None
        self.button.disabled = self.at.disabled = motion is None
        self.chart.visible = motion is not None
        self.button.label, self.told.content = "Play", ""
        if motion is None:
            self._server.scene.remove_by_name("/way")
            return
        self.at.max = float(motion.times[-1])
        self.chart.data = (motion.times, 1e3 * motion.clearances)
        pieces = np.stack([motion.tools[:-1], motion.tools[1:]], axis=1)
        # a piece has the source of the point that it leads to
        colours = np.array([COLOURS[Source(int(s))] for s in motion.sources[1:]], np.uint8)
        self._server.scene.add_line_segments(
            "/way",
            pieces,
            np.repeat(colours[:, None], 2, axis=1),
            thickness=4.0,
            thickness_units="screen",
        )
        self.at.value = 0.0
        self.draw()

    def toggle(self) -> None:
        """Play the motion, or stop it."""
        if self.motion is None:
            return
        if self._began is not None:
            self._began, self.button.label = None, "Play"
            return
        begin = 0.0 if self.at.value >= self.at.max - 1 / RATE else float(self.at.value)
        self._began, self.button.label = time.monotonic() - begin, "Stop"

    def tick(self) -> None:
        """While playing, move the slider to the present time."""
        began, motion = self._began, self.motion
        if began is None or motion is None:
            return
        elapsed = min(time.monotonic() - began, float(motion.times[-1]))
        self.at.value = elapsed  # draws it
        if elapsed >= motion.times[-1]:
            self._began, self.button.label = None, "Play"

    def draw(self) -> None:
        """Show the frame nearest to the slider's time."""
        motion = self.motion
        if motion is None:
            return
        frame = int(np.abs(motion.times - self.at.value).argmin())
        self._show(motion.qpos[frame])
        source = Source(int(motion.sources[frame]))
        gap, smallest = 1e3 * motion.clearances[frame], 1e3 * motion.clearances.min()
        self.told.content = (
            f"{motion.times[frame]:.1f} of {motion.times[-1]:.1f} s, **{NAMES[source]}**, "
            f"clearance **{gap:.1f} mm** (least {smallest:.1f})"
        )
