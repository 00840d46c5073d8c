# SPDX-License-Identifier: MIT
"""OMPL's RRT-Connect on a task: between the same key poses, C MuJoCo as its checker."""

import time
from dataclasses import replace

import jax
import numpy as np

from hybrid_jax.planner.checking import CheckConfig, Engine
from hybrid_jax.planner.finishing import time_path
from hybrid_jax.planner.labelling import find_candidates
from hybrid_jax.planner.ompl_paths import OmplPlanner
from hybrid_jax.planner.records import PlannerConfig, PlanResult
from hybrid_jax.planner.scenes import inside, phase_scene, segment_kinds, task_scenes
from hybrid_jax.planner.turns import plan_in_turns
from hybrid_jax.skills.task import Task
from hybrid_jax.types import Source, Status, Workcell

SECONDS = 10.0
"""Time that a task may take."""
TRIES = 3
"""Configurations of a key pose that are tried, the nearest first."""


class OmplTasks:
    """Plans tasks as `plan_motion` does; the time of finding configurations counts as well."""

    def __init__(self, cell: Workcell, config: PlannerConfig, clearance: float = 0.0):
        """Args:
            cell: of the tasks.
            config: its labels, smoothing and timing are used.
            clearance: that its checker demands [m].
        """
        low, high = np.asarray(cell.joint_limits, float).T
        home = np.asarray(cell.home)
        # joints that turn without end would only make its space larger
        self.ompl = OmplPlanner(np.maximum(low, home - np.pi), np.minimum(high, home + np.pi))
        self.cell, self.config = cell, config
        self.engine = Engine(cell, CheckConfig(clearance=clearance))
        # its paths may touch: they are smoothed where that costs no contact, else left as they are
        smoothing = config.smoothing
        self.smooth, self.bare = (
            replace(smoothing, margin=clearance), replace(smoothing, margin=-1, widths=(0,)),
        )  # fmt: skip
        self.labels = replace(
            config.labels, key_margin=clearance, least_manipulability=0.0, candidates=8
        )

    def _goals(self, task: Task, scenes, k: int, start: np.ndarray, key) -> np.ndarray:
        """Configurations of a key pose, the nearest first."""
        last = len(task.carrying)
        if k == last and task.end is not None:
            return task.end[None]
        around = (k - 1, min(k, last - 1))
        before, after = (jax.tree.map(lambda a, i=i: a[i], scenes) for i in around)
        found, usable, _ = jax.device_get(find_candidates(
            self.cell, before, after, task.key_poses[k], 1.0, key, self.labels
        ))  # fmt: skip
        goals = found[usable]
        return goals[np.argsort(np.abs(goals - start).max(axis=1))][:TRIES]

    def way_points(self, task: Task, key) -> list[np.ndarray] | None:
        """Path over each unit segment, or None if a segment is not solved in time."""
        scenes, kinds = task_scenes(self.cell, task), segment_kinds(task)
        ends, start, paths = time.perf_counter() + SECONDS, np.asarray(task.start), []
        for k in range(1, len(task.key_poses)):
            self.engine.enter(phase_scene(self.cell, task, int(kinds[k - 1])))
            valid = lambda q: self.engine.collision(q) is None  # noqa: E731
            path = None
            for goal in self._goals(task, scenes, k, start, jax.random.fold_in(key, k)):
                left = ends - time.perf_counter()
                if left > 0 and path is None:
                    path = self.ompl.solve(valid, start, goal, left / 2, simplify=True)[0]
            if path is None:
                return None
            paths.append(path)
            start = path[-1].astype(np.float32)
        return paths

    def plan(self, task: Task, key) -> PlanResult:
        """Plan, then smooth and time as far as it goes; solved is what OMPL finds a path for."""
        return plan_in_turns(self.cell, [task], lambda near: [self._plan(near[0], key)])[0]

    def _plan(self, task: Task, key) -> PlanResult:
        paths = self.way_points(task, key)
        if paths is None:
            return PlanResult(Status.NO_PATH, "OMPL found no path in time")
        scenes, phases = task_scenes(self.cell, task), []
        for number, (low, high) in enumerate(task.phases):
            cell = inside(self.cell, scenes, low)
            q = np.concatenate([paths[low], *(p[1:] for p in paths[low + 1 : high])])
            marks = np.full(len(q), Source.RRT, np.uint8)
            speeds = self.config.timing, task.tool_speed(number)
            trajectory = time_path(cell, q, marks, self.smooth, *speeds)
            phases.append(trajectory or time_path(cell, q, marks, self.bare, *speeds))
        return PlanResult(Status.OK, "", phases)
