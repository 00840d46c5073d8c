# SPDX-License-Identifier: MIT
"""The hybrid method online as the paper has it (Algorithms 1 and 3), without a proof.

Skills are followed by inverse kinematics from where the arm stands. Over an infeasible segment the
joint agent leads into a target area, and RL-LfD goes on from where it stops (`handover`). The
switching agent then chooses between both motions. What comes out is what the paper executes: drops
and collisions show in physics. `plan_checked` returns it only if it passes the final check.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from hybrid_jax.contracts import Combined, PlanResult, Segments
from hybrid_jax.errors import InputError
from hybrid_jax.kernels.argument_checks import single_precision
from hybrid_jax.kernels.collision.motion_validation import measure_here
from hybrid_jax.planner import combined_path
from hybrid_jax.planner.combined_path import PhasePath, Window
from hybrid_jax.planner.handover import hand_over, nearest_state
from hybrid_jax.planner.key_pose_ik import Judge
from hybrid_jax.planner.lfd import SkillPath, skill_paths, without_skills
from hybrid_jax.planner.phase_scenes import inside, task_scenes
from hybrid_jax.planner.records import Planner
from hybrid_jax.planner.skill_following import Followed, fewest_infeasible, first_gap, follow
from hybrid_jax.planner.task_validation import admit
from hybrid_jax.planner.trajectory_check import ConfigurationChecker
from hybrid_jax.planner.trajectory_generation import find_faults
from hybrid_jax.planner.unchecked_timing import executable
from hybrid_jax.runtime.keys import fold_in
from hybrid_jax.tasks.task import Task
from hybrid_jax.types import Scene, Source, Status, Workcell


def task_judge(planner: Planner, task: Task) -> Judge:
    """The scenes of a task's segments, with the thresholds of its points."""
    scenes = jax.device_get(task_scenes(planner.cell, task))
    return Judge(planner.cell, scenes, planner.scale, planner.config.path_ik)


def paths_of(planner: Planner, tasks: list[Task]) -> list[list[SkillPath]]:
    """traj_LfD of tasks, by one or several plans (Algorithm 2).

    In a transit, which no skill shows, the tool stays and then is at the next key pose: this jump
    is a gap like others, between two stretches of poses.
    """
    config = planner.config
    if config.direct:
        return without_skills(tasks)
    found = skill_paths(planner.library, tasks, planner.choose, config.skills, config.plans)
    for task, paths in zip(tasks, found, strict=True):
        if task.transit:
            for path in filter(lambda path: len(path.poses), paths):
                ends = path.poses[0][[0, -1]]
                path.poses[0] = np.repeat(ends, path.poses.shape[1] // 2, axis=0)
    return found


class _Segment:
    """One unit segment: the skill's joint path and the agent's ways over its gaps."""

    def __init__(self):
        self.q: list[np.ndarray] = []
        self.feasible: list[np.ndarray] = []
        self.windows: list[Window] = []
        self.offset = 0

    def add(self, path: Followed, count: int) -> None:
        """Append the first points of a followed path."""
        self.q.append(path.q[:count])
        self.feasible.append(path.feasible[:count])
        self.offset += count

    def end_in(self, q: np.ndarray) -> None:
        """Append a configuration `[joint]` that has the last pose too."""
        self.q.append(q[None])
        self.feasible.append(np.ones(1, bool))

    def bridge(self, path: Followed, begin: int, goal: int, way: np.ndarray) -> None:
        """Append a path up to its point `goal`, where the agent's way from point `begin` ends."""
        self.windows.append(Window(self.offset + begin, self.offset + goal, way, Source.DRL))
        self.add(path, goal)


def _segment(
    planner: Planner, judge: Judge, number: int, poses: np.ndarray, start: np.ndarray, key: Array
) -> _Segment:
    """Follow one segment; over its gaps the agent leads (Algorithm 3), if there is one.

    Args:
        planner: agent and settings.
        judge: scenes and thresholds.
        number: of the segment.
        poses: `[point, 8]` the skill's poses.
        start: `[joint]` where the arm stands [rad or m].
        key: consumed.
    """
    config, explore, found = planner.config.handover, planner.explore, _Segment()
    scene = jax.tree.map(lambda a: a[number], judge.scenes)
    (path,) = follow(judge, np.array([number]), poses[None], start[None], key_pose_first=True)
    for attempt in range(config.tries if config and explore else 0):
        assert config and explore
        gap = first_gap(path.feasible, config.island)
        if gap is None or gap[1] == len(path.q) - 1:  # at the key pose nothing leads around it
            break
        handover = hand_over(
            judge,
            scene,
            number,
            path,
            gap,
            explore,
            fold_in(key, attempt),
            config,
            planner.config.skills.map,
        )
        if handover is None:
            break
        begin, taken = handover
        found.bridge(path, begin, gap[1] + 1, taken.way)
        path = taken.rest
    found.add(path, len(path.q))
    return found


def _straight_to(planner: Planner, judge: Judge, number: int, poses, start, key) -> _Segment:
    """The agent alone, from where the arm stands into the target area of the segment's end."""
    config, explore, found = planner.config.handover, planner.explore, _Segment()
    if not (config and explore):
        raise InputError("there is no joint agent that could lead from key pose to key pose")
    (path,) = follow(judge, np.array([number]), poses[None], start[None], key_pose_first=True)
    scene = jax.tree.map(lambda a: a[number][None], judge.scenes)
    ends = jax.tree.map(jnp.asarray, (start[None], path.q[-1:]))
    rollouts = explore(Segments(scene, *ends), key)[0]
    i, k = nearest_state(judge.cell, rollouts, poses[-1], config)
    way = np.concatenate([start[None], rollouts[i, : k + 1]])
    ends = Followed(poses[[0, -1]], way[[0, -1]], np.array([False, True]), np.zeros(2, bool))
    found.bridge(ends, 0, 1, way)
    found.add(Followed(ends.poses[1:], ends.q[1:], ends.feasible[1:], ends.roomy[1:]), 1)
    return found


def _phase_path(segments: list[_Segment]) -> PhasePath:
    """The segments of a phase as one path; a key pose between two of them stands once."""
    q, feasible, windows, offset = [], [], [], 0
    for order, segment in enumerate(segments):
        skip = int(order > 0)
        windows += [
            Window(w.first + offset - skip, w.last + offset - skip, w.path, w.source)
            for w in segment.windows
        ]
        q.append(np.concatenate(segment.q)[skip:])
        feasible.append(np.concatenate(segment.feasible)[skip:])
        offset += len(q[-1])
    return PhasePath(np.concatenate(q), np.concatenate(feasible), windows)


def task_phases(planner: Planner, task: Task, paths: list[SkillPath], key: Array):
    """Both motions of all phases of a task, before the switching agent chooses.

    Args:
        planner: agents and settings.
        task: what is to be done.
        paths: of RL-LfD, by one or several plans.
        key: consumed.

    Returns:
        The skill path that is followed, the judge of its points, and a `PhasePath` for each phase.
    """
    judge, start = task_judge(planner, task), np.asarray(task.start, np.float32)
    path = fewest_infeasible(judge, paths, start)
    lead = _straight_to if planner.config.direct else _segment
    segments, q = [], start
    for number, poses in enumerate(path.poses):
        segments.append(lead(planner, judge, number, poses, q, fold_in(key, number)))
        q = segments[-1].q[-1][-1]
    if task.end is not None:  # the paper knows key poses only: another joint line leads there
        segments[-1].end_in(np.asarray(task.end, np.float32))
    return path, judge, [_phase_path(segments[low:high]) for low, high in task.phases]


def combine(cell: Workcell, phase: PhasePath, unit: float, clear: float) -> Combined:
    """Both motions of a phase with the paper's man' and COL, see `combined_path.both_motions`.

    Args:
        cell: robot and the scene of the phase.
        phase: the skill's joint path and the agent's ways.
        unit: man(theta_0), the manipulability at home.
        clear: clearance below which a point counts as COL [m].
    """
    q, _, available = combined_path.both_motions(phase)
    gap = measure_here(cell)(np.zeros(q[..., 0].size, int), q.reshape(-1, q.shape[-1]), clear)
    leaves = (
        q,
        combined_path.manipulabilities(cell, q) / unit,
        (gap < np.float32(clear)).reshape(q.shape[:2]),
        available,
    )
    arrays: list[Any] = [np.asarray(leaf, np.float32) for leaf in leaves]
    return Combined(*arrays)


def switch_problem(planner: Planner, cell: Workcell, phase: PhasePath) -> Combined:
    """The switching agent's problem of a phase, by the planner's settings; see `combine`."""
    config = planner.config.handover
    assert config
    return combine(cell, phase, planner.scale, config.clear)


def _chosen(planner: Planner, cell: Workcell, phase: PhasePath) -> tuple[np.ndarray, np.ndarray]:
    """The joint path that the switching agent chooses, with its sources."""
    if not phase.windows or planner.config.direct:
        return combined_path.follow_windows(phase)
    return combined_path.assemble(planner.switch(switch_problem(planner, cell, phase)), phase)


def _plan(planner: Planner, task: Task, paths: list[SkillPath], key: Array) -> PlanResult:
    """An unchecked plan of one task."""
    if not len(paths[0].poses):
        missing = "; ".join(map(str, paths[0].missing))
        return PlanResult(Status.NEED_DEMO, f"record a demonstration for {missing}")
    path, judge, phases = task_phases(planner, task, paths, key)
    motions, stands = [], np.asarray(task.start, float)
    for number, (phase, (low, _)) in enumerate(zip(phases, task.phases, strict=True)):
        cell = inside(planner.cell, judge.scenes, low)
        q, sources = _chosen(planner, cell, phase)
        # a phase begins exactly where the one before has ended
        q, sources = np.concatenate([stands[None], q]), np.concatenate([sources[:1], sources])
        speed = task.tool_speed(number)
        motions.append(executable(planner, measure_here(cell), q, sources, speed))
        stands = motions[-1].positions[-1]
    names = [planner.library.names[k] for _, _, k in path.plan]
    return PlanResult(Status.OK, "as the paper executes it, not checked", motions, names)


@single_precision
def plan_unchecked(planner: Planner, tasks: Sequence[Task], *, key: Array) -> list[PlanResult]:
    """Plan tasks as the paper does; nothing is proven, and nothing is refused.

    Args:
        planner: with an `explore` and a `handover`.
        tasks: what is to be done.
        key: draws the agent's actions; consumed.

    Returns:
        One result for each task: trajectories with positions `[point, joint]` [rad or m], or the
        demonstration that is missing.
    """
    todo = list(tasks)
    return [
        _plan(planner, task, task_paths, fold_in(key, number))
        for number, (task, task_paths) in enumerate(zip(todo, paths_of(planner, todo), strict=True))
    ]


def plan_checked(planner: Planner, tasks: Sequence[Task], key: Array) -> list[PlanResult]:
    """Plan tasks as the paper does; what the final check refuses is no plan.

    Arguments and results are those of `pipeline.plan_batch`.
    """
    checker, results = ConfigurationChecker(planner.cell, planner.config.check), []
    for number, task in enumerate(tasks):
        task, note, refusal = admit(planner.cell, checker, task)
        if refusal:
            results.append(refusal)
            continue
        (result,) = plan_unchecked(planner, [task], key=fold_in(key, number))
        results.append(_judged(planner, checker, task, result, note))
    return results


def _judged(
    planner: Planner, checker: ConfigurationChecker, task: Task, result: PlanResult, note: str
) -> PlanResult:
    """The plan if it passes the final check, else the reason why not."""
    if result.status is not Status.OK:
        return result
    scenes: Scene = jax.device_get(task_scenes(planner.cell, task))
    for number, motion in enumerate(result.phases):
        cell = inside(planner.cell, scenes, task.phases[number][0])
        if faults := find_faults(cell, checker, task, number, motion):
            detail = f"phase {number}: {'; '.join(faults)}"
            return PlanResult(Status.COLLISION, detail, skills=result.skills)
    return replace(result, detail=" ".join(filter(None, [result.status.sentence, note])))
