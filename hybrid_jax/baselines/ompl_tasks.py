# SPDX-License-Identifier: MIT
"""Plans of tasks by OMPL's RRT-Connect, between the same key poses, with C MuJoCo as checker."""

import time
from dataclasses import replace

import jax
import numpy as np

from hybrid_jax.baselines.ompl_paths import OmplPlanner
from hybrid_jax.contracts import PlanResult
from hybrid_jax.planner.key_pose_ik import Judge, draw_seeds, find_candidates
from hybrid_jax.planner.phase_scenes import inside, phase_scene, segment_kinds, task_scenes
from hybrid_jax.planner.records import PlannerConfig
from hybrid_jax.planner.trajectory_check import CheckConfig, ConfigurationChecker
from hybrid_jax.planner.trajectory_generation import time_path
from hybrid_jax.planner.turns import plan_in_turns
from hybrid_jax.tasks.task import Task
from hybrid_jax.types import Source, Status, Workcell

SECONDS = 10.0
"""Time limit of a task [s]."""
TRIES = 3
"""Number of configurations of a key pose that are tried, the nearest first."""


class OmplTasks:
    """A planner of tasks by OMPL; its time limit includes inverse kinematics of key poses."""

    def __init__(self, cell: Workcell, config: PlannerConfig, clearance: float = 0.0):
        """Set up OMPL and its checker.

        Args:
            cell: the cell of the tasks.
            config: settings; those of labels, smoothing and timing are used.
            clearance: clearance that the checker demands [m].
        """
        low, high = np.asarray(cell.joint_limits, float).T
        home = np.asarray(cell.home)
        # joints that turn without end would only make its space larger
        self.ompl = OmplPlanner(np.maximum(low, home - np.pi), np.minimum(high, home + np.pi))
        self.cell, self.config = cell, config
        self.checker = ConfigurationChecker(cell, CheckConfig(clearance=clearance))
        # its paths may touch: they are smoothed where that costs no contact, else left as they are
        smoothing = config.smoothing
        self.smooth, self.bare = (
            replace(smoothing, margin=clearance),
            replace(smoothing, margin=-1, widths=(0,)),
        )
        self.labels = replace(
            config.path_ik, key_margin=clearance, least_manipulability=0.0, candidates=8
        )

    def _goals(self, task: Task, scenes, k: int, start: np.ndarray, key) -> np.ndarray:
        """Configurations `[goal, joint]` of key pose `k`, those nearest to `start` first."""
        last = len(task.carrying)
        if k == last and task.end is not None:
            return task.end[None]
        around, pose = np.array([[k - 1, min(k, last - 1)]]), task.key_poses[None, k]
        judge = Judge(self.cell, jax.device_get(scenes), 1.0, self.labels)
        found = find_candidates(judge, around, pose, draw_seeds(judge, 1, key, k))
        candidates, usable, _ = (a[0] for a in found)
        goals = candidates[usable]
        return goals[np.argsort(np.abs(goals - start).max(axis=1))][:TRIES]

    def way_points(self, task: Task, key) -> list[np.ndarray] | None:
        """Plan from key pose to key pose, within `SECONDS`.

        Returns:
            Way points `[point, joint]` [rad or m] of each unit segment; None if a segment is not
            solved in time.
        """
        scenes, kinds = task_scenes(self.cell, task), segment_kinds(task)
        deadline, start, paths = time.perf_counter() + SECONDS, np.asarray(task.start), []
        for k in range(1, len(task.key_poses)):
            self.checker.enter(phase_scene(self.cell, task, int(kinds[k - 1])))
            valid = lambda q: self.checker.collision(q) is None  # noqa: E731
            path = None
            for goal in self._goals(task, scenes, k, start, jax.random.fold_in(key, k)):
                seconds_left = deadline - time.perf_counter()
                if seconds_left > 0 and path is None:
                    path = self.ompl.solve(valid, start, goal, seconds_left / 2, simplify=True)[0]
            if path is None:
                return None
            paths.append(path)
            start = path[-1].astype(np.float32)
        return paths

    def plan(self, task: Task, key) -> PlanResult:
        """Plan a task, then smooth and time the paths as far as that succeeds.

        Returns:
            A result that is OK wherever OMPL finds paths; trajectories have positions
            `[point, joint]` [rad or m].
        """
        return plan_in_turns(self.cell, [task], lambda batch: [self._plan(batch[0], key)])[0]

    def _plan(self, task: Task, key) -> PlanResult:
        """Plan a task whose start is near home."""
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
