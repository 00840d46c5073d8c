# SPDX-License-Identifier: MIT
"""The page: a handle on the tool, buttons to record, replay and save, the saved skills."""

from pathlib import Path

import numpy as np

from hybrid_jax.demonstrations.demonstration import (
    PARTIAL,
    Demonstration,
    load_demonstration,
    save_demonstration,
)
from hybrid_jax.demonstrations.filtering import continuous_signs, low_pass
from hybrid_jax.teach.recorder import RATE, Recorder
from hybrid_jax.types import Workcell
from hybrid_jax.web.page import WebPage
from hybrid_jax.web.scene import WebScene

_NONE = "(none yet)"


class TeachPage(WebPage):
    """The page on which the arm follows a handle; it is served until it is closed."""

    def __init__(
        self, cell: Workcell, library: Path, robot: str, host: str = "127.0.0.1", port: int = 8080
    ):
        """Open the page.

        Args:
            cell: the work cell whose arm is guided.
            library: folder that demonstrations are saved to.
            robot: kind of robot, as the recordings are to say.
            host: address to listen at; only this machine by default.
            port: the first one that is tried.
        """
        super().__init__(host, port, "hybrid_jax teach", RATE)
        self.library = library
        self.recorder = Recorder(cell, robot)
        self._scene = WebScene(self.server, cell.model)
        self._replay: list[np.ndarray] = []
        self._view()
        self._panel()
        self.start()

    def _view(self) -> None:
        tool = self.recorder.tool
        self.handle = self.server.scene.add_transform_controls(
            "/hand",
            scale=0.25,
            position=tool[:3],
            wxyz=tool[3:],
            line_width=4.0,
            depth_test=False,
        )
        self.server.initial_camera.position = (1.1, -0.7, 0.9)
        self.server.initial_camera.look_at = tuple(tool[:3])

    def _panel(self) -> None:
        gui = self.server.gui
        self._record = gui.add_button("Record")
        self._gripper = gui.add_checkbox("Gripper closed", initial_value=False)
        self._again = gui.add_button("Replay")
        self._home = gui.add_button("Handle to tool")
        self._name = gui.add_text("Name", initial_value="skill")
        self._note = gui.add_text("Note", initial_value="")
        self._save = gui.add_button("Save")
        self._saved = gui.add_dropdown("Saved", options=(_NONE,), initial_value=_NONE)
        self._show = gui.add_button("Show saved")
        self._record.on_click(lambda _: self.guarded(self._toggle))
        self._gripper.on_update(lambda _: setattr(self.recorder, "closed", self._gripper.value))
        self._again.on_click(lambda _: self.guarded(self._play))
        self._home.on_click(lambda _: self.guarded(self._fetch_handle))
        self._save.on_click(lambda _: self.guarded(self._keep))
        self._show.on_click(lambda _: self.guarded(self._draw_saved))
        self._list_saved()
        self.status.content = "Drag the handle; the arm follows."

    def _toggle(self) -> str:
        if self.recorder.recording:
            self.recorder.stop()
            self._record.label = "Record"
            return f"{self.recorder.samples} samples recorded. Replay, save, or record anew."
        self.recorder.start()
        self._record.label = "Stop"
        return "Recording."

    def _fetch_handle(self) -> str:
        tool = self.recorder.tool
        self.handle.position, self.handle.wxyz = tool[:3], tool[3:]
        return "The handle is at the tool."

    def _play(self) -> str:
        self._replay = self.recorder.frames()
        return f"Replaying {len(self._replay)} samples." if self._replay else "Nothing is recorded."

    def _keep(self) -> str:
        demo = self.recorder.demonstration(self._name.value.strip(), self._note.value)
        save_demonstration(self.library, demo)
        self._list_saved()
        self._draw(demo)
        return f"Saved {demo.name!r}: {demo.times[-1]:.1f} s, in {self.library}."

    def _list_saved(self) -> None:
        names = sorted(
            path.stem for path in self.library.glob("*.npz") if not path.stem.endswith(PARTIAL)
        )
        self._saved.options = tuple(names) or (_NONE,)

    def _draw_saved(self) -> str:
        if self._saved.value == _NONE:
            return "Nothing is saved yet."
        demo = load_demonstration(self.library / f"{self._saved.value}.npz")
        self._draw(demo)
        return f"{demo.name}: {demo.times[-1]:.1f} s, {demo.robot}. {demo.note}"

    def _draw(self, demo: Demonstration) -> None:
        smooth = low_pass(demo.times, continuous_signs(np.asarray(demo.poses, float)))
        self.server.scene.add_spline_catmull_rom(
            "/shown", smooth[::8, :3], color=(20, 120, 220), thickness=4.0, thickness_units="screen"
        )

    def _hand(self) -> np.ndarray:
        """Pose `[7]` of the handle; if it is no pose, the handle goes back to the tool."""
        hand = np.array([*self.handle.position, *self.handle.wxyz], float)
        if np.isfinite(hand).all() and np.linalg.norm(hand[3:]) > 0.5:
            return hand
        tool = self.recorder.tool
        self.handle.position, self.handle.wxyz = tool[:3], tool[3:]
        return tool

    def tick(self) -> None:
        """Show the next configuration of a replay, or follow the handle for one period."""
        # buttons act in other threads, under the same lock
        with self._lock:
            if self._replay:
                qpos = self._replay.pop(0)
            else:
                self.recorder.tick(self._hand())
                qpos = self.recorder.qpos
            self._scene.show(qpos)
