# SPDX-License-Identifier: MIT
"""The hybrid planner: Algorithm 1 of the paper, online, for one task or many at once.

All tasks of a batch go through the stages together: labels and bridges are one program each.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial

import jax
import numpy as np
from jax import Array

from hybrid_jax.contracts import PlanResult
from hybrid_jax.kernels.argument_checks import single_precision
from hybrid_jax.kernels.collision.motion_validation import clearances_in_scenes
from hybrid_jax.planner.branch_selection import Leg, Routes, label_paths
from hybrid_jax.planner.bridging import Way, bridge_gaps
from hybrid_jax.planner.infeasible_segments import gap_segment
from hybrid_jax.planner.lfd import SkillPath, skill_paths, without_skills
from hybrid_jax.planner.phase_scenes import task_scenes
from hybrid_jax.planner.records import Planner
from hybrid_jax.planner.target_area import plan_checked
from hybrid_jax.planner.task_validation import admit, too_close, why_infeasible
from hybrid_jax.planner.trajectory_check import ConfigurationChecker
from hybrid_jax.planner.trajectory_generation import Draft, Fault, finish_phases
from hybrid_jax.planner.turns import plan_in_turns
from hybrid_jax.runtime.keys import fold_in, split
from hybrid_jax.tasks.task import Task
from hybrid_jax.types import Scene, Status, Trajectory

SEARCHED = {Status.TASK_INFEASIBLE, Status.NO_PATH, Status.SEAM_FAILED, Status.COLLISION}
"""Statuses of failed searches: a more thorough search may still find a plan."""
PARTS, LEAST_PART = 2, 16
"""Parts of a batch that are planned in parallel, and the smallest number of tasks of a part."""


@dataclass
class Job:
    """One task on its way through the stages."""

    task: Task
    note: str
    """What was changed before planning, as a sentence; mostly empty."""
    names: list[str]
    """Names of the skills of the plan, in order."""
    scenes: Scene
    """Scenes of the unit segments, leaves `[segment, ...]`."""
    routes: Routes
    legs: list[Leg] = field(default_factory=list)
    """Legs of the route that is being tried."""
    ways: dict[tuple, Way] = field(default_factory=dict)
    """Motions over gaps, by the names of their legs."""
    phases: dict[int, tuple[tuple, Trajectory]] = field(default_factory=dict)
    """Finished phases by number: the names of their legs, and the trajectory."""
    status: Status = Status.TASK_INFEASIBLE
    detail: str = ""
    done: bool = False

    def result(self) -> PlanResult:
        """The answer to the task."""
        if self.status is Status.OK:
            phases = [self.phases[i][1] for i in sorted(self.phases)]
            detail = " ".join(filter(None, [self.status.sentence, self.note]))
            return PlanResult(self.status, detail, phases, self.names)
        return PlanResult(self.status, self.detail, skills=self.names)


def plan_motion(planner: Planner, task: Task, *, key: Array) -> PlanResult:
    """Plan a task; every returned trajectory has passed the final check.

    Args:
        planner: cell, skills and agents.
        task: key poses `[K, 8]` in a scene.
        key: draws IK seeds and rollouts; consumed.

    Returns:
        A trajectory for each phase, way points `[point, joint]` [rad] at times [s]; or a status
        that is not OK and a sentence. A bad task raises nothing: its status is INVALID_TASK.
    """
    return plan_batch(planner, [task], key=key)[0]


@single_precision
def plan_batch(planner: Planner, tasks: Sequence[Task], *, key: Array) -> list[PlanResult]:
    """Plan several tasks at once.

    Large batches go through the stages in parts, so that the host finishes the tasks of one while
    the device works on those of another.

    Args:
        planner: cell, skills and agents; its functions are called from two threads.
        tasks: each in a scene of its own.
        key: draws IK seeds and rollouts; consumed.

    Returns:
        One result for each task, see `plan_motion`.
    """
    return plan_in_turns(planner.cell, list(tasks), lambda batch: _plan_parts(planner, batch, key))


def _plan_parts(planner: Planner, tasks: Sequence[Task], key: Array) -> list[PlanResult]:
    """Plan a batch, in several parts if it is large enough."""
    if planner.config.handover:
        return plan_checked(planner, tasks, key)
    count = max(1, min(PARTS, len(tasks) // LEAST_PART))
    parts = [tasks[i::count] for i in range(count)]
    if count == 1:
        return _plan_part(planner, tasks, key)
    with ThreadPoolExecutor(count) as pool:
        keys = [fold_in(key, i) for i in range(count)]
        results = list(pool.map(partial(_plan_part, planner), parts, keys))
    # part i % count holds every count-th task
    return [results[i % count][i // count] for i in range(len(tasks))]


@single_precision
def _plan_part(planner: Planner, tasks: Sequence[Task], key: Array) -> list[PlanResult]:
    """Plan all tasks with few candidates, then with all candidates those that have no plan yet."""
    config = planner.config
    if config.quick_path_ik is None:
        return _plan_once(planner, tasks, key)
    quick = replace(planner, config=replace(config, path_ik=config.quick_path_ik))
    results = _plan_once(quick, tasks, key)
    unsolved = [i for i, result in enumerate(results) if result.status in SEARCHED]
    if unsolved:
        retried = _plan_once(planner, [tasks[i] for i in unsolved], fold_in(key, len(tasks)))
        for i, result in zip(unsolved, retried, strict=True):
            results[i] = result
    return results


def _plan_once(planner: Planner, tasks: Sequence[Task], key: Array) -> list[PlanResult]:
    """Plan tasks together, each by its cheapest routes in turn."""
    key_label, key_bridge = split(key, 2)
    checker, config = ConfigurationChecker(planner.cell, planner.config.check), planner.config
    results, jobs = prepare(planner, checker, tasks, key_label)
    for attempt in range(config.attempts):
        active = [job for job in jobs.values() if not job.done]
        for job in active:
            choose_route(planner, checker, job)
        active = [job for job in active if not job.done]
        if not active:
            break
        bridge_jobs(planner, active, fold_in(key_bridge, attempt))
        finish_jobs(planner, checker, active)
    return [jobs[i].result() if i in jobs else results[i] for i in range(len(tasks))]


def prepare(
    planner: Planner, checker: ConfigurationChecker, tasks: Sequence[Task], key: Array
) -> tuple[dict[int, PlanResult], dict[int, Job]]:
    """Answers to tasks that cannot be planned, and jobs for the others, by the task's number."""
    results, admitted = {}, {}
    for number, task in enumerate(tasks):
        task, note, refusal = admit(planner.cell, checker, task)
        if refusal:
            results[number] = refusal
        else:
            admitted[number] = task, note
    scenes = {i: task_scenes(planner.cell, task) for i, (task, _) in admitted.items()}
    for number, touched in starts_touch(planner, admitted, scenes).items():
        detail = f"the arm collides where it stands: {touched}"
        results[number] = PlanResult(Status.START_INVALID, detail)
        del admitted[number]
    # Alg. 1, l. 28: call Algorithm 2 to calculate the task-space trajectory traj_LfD
    planned, config = [task for task, _ in admitted.values()], planner.config
    task_paths = (
        without_skills(planned)
        if config.direct
        else skill_paths(planner.library, planned, planner.choose, config.skills, config.plans)
    )
    covered = []
    for (number, (task, note)), paths in zip(admitted.items(), task_paths, strict=True):
        if len(paths[0].poses):
            covered += [(number, task, note, path) for path in paths]
        else:
            missing = "; ".join(str(m) for m in paths[0].missing)
            detail = f"record a demonstration for {missing}"
            results[number] = PlanResult(Status.NEED_DEMO, detail)
    return results, _label(planner, covered, scenes, key)


def starts_touch(
    planner: Planner, tasks: dict[int, tuple[Task, str]], scenes: dict[int, Scene]
) -> dict[int, str]:
    """What the kernels find wrong with starts of tasks, in words, by the task's number."""
    if not tasks:
        return {}
    first_scenes = [jax.tree.map(lambda a: a[0], scenes[i]) for i in tasks]
    gaps = clearances_in_scenes(
        planner.cell,
        jax.tree.map(lambda *a: np.stack(a), *first_scenes),
        np.arange(len(tasks)),
        np.stack([np.asarray(task.start, float) for task, _ in tasks.values()]),
    )
    contacts = {i: too_close(float(gap)) for i, gap in zip(tasks, gaps, strict=True)}
    return {i: contact for i, contact in contacts.items() if contact}


def _label(
    planner: Planner,
    covered: list[tuple[int, Task, str, SkillPath]],
    scenes_of: dict[int, Scene],
    key: Array,
) -> dict[int, Job]:
    """Label paths by inverse kinematics, FJ and not-FJ (Alg. 1, l. 32-34); one job a task."""
    jobs: dict[int, Job] = {}
    # one program labels tasks with equally many segments, all with or all without an end
    kinds = [(len(path.poses), task.end is None) for _, task, _, path in covered]
    for kind in set(kinds):
        numbers, tasks, notes, paths = zip(
            *(row for row, row_kind in zip(covered, kinds, strict=True) if row_kind == kind),
            strict=True,
        )
        scenes = [scenes_of[number] for number in numbers]
        task_routes = label_paths(
            planner.cell,
            list(tasks),
            scenes,
            [path.poses for path in paths],
            planner.scale,
            fold_in(key, kind[0]),
            planner.config.path_ik,
            planner.config.direct,
        )
        for row in zip(numbers, tasks, notes, paths, scenes, task_routes, strict=True):
            number, task, note, path, scene, routes = row
            # of several plans of a task, the one with the fewest infeasible way points is kept
            if number not in jobs or routes.least_cost() < jobs[number].routes.least_cost():
                names = [planner.library.names[k] for _, _, k in path.plan]
                jobs[number] = Job(task, note, names, scene, routes)
    return jobs


def choose_route(planner: Planner, checker: ConfigurationChecker, job: Job) -> None:
    """Choose the cheapest remaining route of a job; the job is done if there is none."""
    names = job.routes.cheapest()
    if names is None:
        job.done = True
        if not job.detail:
            job.detail = why_infeasible(planner.cell, checker, job.task, job.routes)
        return
    job.legs = [job.routes.leg(name) for name in names]


def bridge_jobs(planner: Planner, jobs: list[Job], key: Array) -> None:
    """Bridge the gaps of routes by Algorithm 3: traj_DRL (Alg. 1, l. 29-31)."""
    gaps = [
        (job, leg) for job in jobs for leg in job.legs if leg.has_gap and leg.name not in job.ways
    ]
    if not gaps:
        return
    segments = [gap_segment(leg, job.scenes) for job, leg in gaps]
    ways = bridge_gaps(planner.bridge, planner.fallback, segments, key)
    for (job, leg), way in zip(gaps, ways, strict=True):
        if way is not None:
            job.ways[leg.name] = way
            continue
        start, end = leg.name[0], leg.name[0] + 1
        job.status, job.detail = Status.NO_PATH, why_unbridged(planner, start, end)
        job.routes.forbid(leg.name)


def why_unbridged(planner: Planner, start: int, end: int) -> str:
    """A sentence about a gap between two key poses that has not been bridged."""
    gap = "" if planner.config.direct else " around an infeasible part of the skill's path"
    where = f"key pose {start} to {end}: no way{gap}"
    methods = {"the joint agent": planner.bridge, "the fallback planner": planner.fallback}
    tried = " or ".join(name for name, method in methods.items() if method)
    found = f" was found by {tried}" if tried else ": nothing is there to look for one"
    return where + found


def finish_jobs(planner: Planner, checker: ConfigurationChecker, jobs: list[Job]) -> None:
    """Concatenate, let the switching policy choose (Alg. 1, l. 35-37), then time and check."""
    drafts: list[tuple[Job, Draft]] = []
    for job in jobs:
        if any(leg.has_gap and leg.name not in job.ways for leg in job.legs):
            continue
        job.status, job.done = Status.OK, True
        for number, (low, high) in enumerate(job.task.phases):
            legs = job.legs[low:high]
            if number not in job.phases or job.phases[number][0] != _names(legs):
                drafts.append((job, Draft(job.task, job.scenes, number, legs, job.ways)))
    finished = finish_phases(planner, checker, [draft for _, draft in drafts])
    for (job, draft), phase in zip(drafts, finished, strict=True):
        if not isinstance(phase, Fault):
            job.phases[draft.number] = _names(draft.legs), phase
            continue
        if job.done:  # the first phase that fails is the one to name
            job.status, job.detail = phase.status, f"phase {draft.number}: {phase.detail}"
            job.done = False
        for name in _names([leg for leg in draft.legs if leg.has_gap] or draft.legs):
            job.routes.forbid(name)


def _names(legs: list[Leg]) -> tuple:
    return tuple(leg.name for leg in legs)
