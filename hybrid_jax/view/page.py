# SPDX-License-Identifier: MIT
"""The page: one tab each for tasks, map, skills and learning curves, beside the cell."""

import threading
import time
from pathlib import Path

import jax
import numpy as np

from hybrid_jax.demonstrations.demonstration import load_demonstrations
from hybrid_jax.demonstrations.filtering import clean
from hybrid_jax.feasibility.map_files import load_map
from hybrid_jax.planner.pipeline import plan_motion
from hybrid_jax.planner.records import Planner
from hybrid_jax.runs.load_planner import load_planner
from hybrid_jax.runs.run_folder import Run
from hybrid_jax.tasks.task import Task, as_rows
from hybrid_jax.types import Status
from hybrid_jax.view.curves import add_curves
from hybrid_jax.view.map_cloud import MapCloud
from hybrid_jax.view.motion import RATE, motion_of, resting_qpos
from hybrid_jax.view.playback import Playback
from hybrid_jax.view.robot_look import RobotLook, arm_bodies
from hybrid_jax.view.task_panel import INVITATION, TaskPanel
from hybrid_jax.web.page import WebPage
from hybrid_jax.web.scene import WebScene
from hybrid_jax.workcell.assets import demonstrations_folder
from hybrid_jax.workcell.layout import home_qpos

_NONE = "(none)"
TASKS = "tasks"
"""Folder of a run that the page saves tasks to."""


class ViewPage(WebPage):
    """The page of a run; it is served until it is closed."""

    def __init__(
        self, run: Run, host: str = "127.0.0.1", port: int = 8080, look: Path | None = None
    ):
        """Open the page.

        Args:
            run: to show, as far as its stages are finished.
            host: address to listen at; only this machine by default.
            port: the first one that is tried.
            look: MJCF whose meshes stand for the arm in the picture.
        """
        super().__init__(host, port, "hybrid_jax view", RATE)
        self.run = run
        self._planner: Planner | None = None
        self._planning_since: float | None = None
        self._planning = threading.Lock()
        cell = run.cell
        self._scene = WebScene(self.server, cell.model, without=arm_bodies(cell) if look else ())
        self._look = RobotLook(self.server, cell, look) if look else None
        self._fill()
        self.server.initial_camera.position = (1.5, -1.1, 1.2)
        self.server.initial_camera.look_at = (0.35, 0.0, 0.25)
        self.start()

    def _fill(self) -> None:
        run, tabs = self.run, self.server.gui.add_tab_group()
        fmap = load_map(run.path("map.npz"), run.cell) if run.finished("map") else None
        with tabs.add_tab("Task"):
            self._task_tab(fmap)
        with tabs.add_tab("Map"):
            self.map = MapCloud(self.server, fmap) if fmap is not None else None
            if fmap is None:
                self.server.gui.add_markdown("This run has no feasibility map yet.")
        with tabs.add_tab("Skills"):
            self._skill_tab()
        with tabs.add_tab("Learning"):
            self.curves = add_curves(self.server, run)

    def _task_tab(self, fmap) -> None:
        gui, cell = self.server.gui, self.run.cell
        if cell.source.task is None:
            self.status.content = "This cell has no task data: write CELL.toml beside its MJCF."
            self.task = self.playback = None
            self.show(home_qpos(cell.model))
            return
        self.playback = None
        self.task = TaskPanel(self.server, cell, fmap, self._new_task, self.guarded)
        self._plan = gui.add_button("Plan")
        self._hide = gui.add_checkbox("Hide handles", initial_value=False)
        self.playback = Playback(self.server, self.show)
        self._name = gui.add_text("Task file", initial_value="task.json")
        self._save = gui.add_button("Save task")
        self._plan.on_click(lambda _: self._press_plan())
        self._hide.on_update(lambda _: self.task.hide(self._hide.value))
        self._save.on_click(lambda _: self.guarded(self._keep))
        self.status.content = INVITATION

    def _skill_tab(self) -> None:
        folder = self.run.skills or demonstrations_folder()
        self._skills = {demo.name: demo for demo in load_demonstrations(folder)}
        self._skill = self.server.gui.add_dropdown("Skill", options=(_NONE, *self._skills))
        self._about = self.server.gui.add_markdown(f"{len(self._skills)} demonstrations.")
        self._skill.on_update(lambda _: self._draw_skill())

    def show(self, qpos: np.ndarray) -> None:
        """Draw a configuration of the whole cell `[nq]`."""
        with self.server.atomic():
            self._scene.show(qpos)
            if self._look:
                self._look.show(qpos)

    def _new_task(self, task: Task) -> None:
        """Show the start of a new task, and drop the last plan, which was of another task."""
        if self.playback:
            self.playback.load(None)
        self.show(resting_qpos(self.run.cell, task.object_poses, task.start))

    def _press_plan(self) -> None:
        """Plan, unless a plan is being made already; other buttons work meanwhile."""
        if not self._planning.acquire(blocking=False):
            return
        try:
            self.unlocked(self.plan)
        finally:
            self._planning.release()

    def plan(self) -> str:
        """Plan the present task and show the plan; returns a sentence about it."""
        task, start_time = self.task.task, time.perf_counter()
        self._planning_since = start_time
        try:
            self._planner = self._planner or load_planner(self.run)
            result = plan_motion(self._planner, task, key=jax.random.key(self.run.seed))
        finally:
            self._planning_since = None
        # planning does not hold the page's lock, so key poses may be dragged meanwhile
        if task is not self.task.task:
            return "The task has changed meanwhile: plan again."
        elapsed = time.perf_counter() - start_time
        if result.status is not Status.OK:
            self.playback.load(None)
            return f"**{result.status.name}:** {result.detail}"
        self.playback.load(motion_of(self.run.cell, task, result))
        shares = ", ".join(f"{s.name} {x:.0%}" for s, x in result.shares.items() if x)
        return f"**OK** after {elapsed:.2f} s: {shares}"

    def _keep(self) -> str:
        return self.task.save(self.run.path(TASKS), str(self._name.value).strip())

    def _draw_skill(self) -> None:
        demo = self._skills.get(self._skill.value)
        if demo is None:
            self.server.scene.remove_by_name("/skill")
            self._about.content = f"{len(self._skills)} demonstrations."
            return
        path = as_rows(clean(demo))[:, :3]
        self.server.scene.add_spline_catmull_rom(
            "/skill", path[::4], color=(20, 160, 90), thickness=4.0, thickness_units="screen"
        )
        grip = "closed" if demo.closed else "open"
        self._about.content = (
            f"**{demo.name}**: {demo.note}, gripper {grip}, {demo.times[-1]:.1f} s, {demo.robot}"
        )

    def tick(self) -> None:
        """Advance the playback, and show for how long planning has been running."""
        since = self._planning_since
        if since is not None:
            seconds = int(time.perf_counter() - since)
            text = f"Planning, {seconds} s (a first time also compiles, for a minute or two)"
            if self.status.content != text:
                self.status.content = text
        if self.playback:
            self.playback.tick()
