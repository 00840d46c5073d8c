# SPDX-License-Identifier: MIT
"""From the chosen legs of a task to checked trajectories, one for each phase."""

from dataclasses import dataclass

import jax
import numpy as np

from hybrid_jax.kernels.edges import (
    Measure,
    measure_in_scenes,
    measure_some,
    path_clearance,
    path_is_free,
    paths_are_free,
)
from hybrid_jax.planner import checking, combining, smoothing, timing
from hybrid_jax.planner.bridging import Way
from hybrid_jax.planner.checking import PhaseScene
from hybrid_jax.planner.combining import PhasePath, Window
from hybrid_jax.planner.records import Planner
from hybrid_jax.planner.refusing import PROVEN
from hybrid_jax.planner.routing import Leg
from hybrid_jax.planner.scenes import inside, phase_scene, segment_kinds
from hybrid_jax.skills.task import Task
from hybrid_jax.types import Scene, Status, Trajectory, Workcell


@dataclass(frozen=True)
class Fault:
    """Why a phase could not be finished."""

    status: Status
    detail: str


@dataclass(frozen=True)
class Draft:
    """A phase that is to be finished."""

    task: Task
    scenes: Scene
    """Of each unit segment of the task."""
    number: int
    legs: list[Leg]
    """Of the phase."""
    ways: dict[tuple, Way]
    """Over the gaps of the legs, by their names."""


def first_scenes(drafts: list[Draft]) -> Scene:
    """The scene in which each phase begins, stacked; on the host."""
    firsts = [(draft.scenes, draft.task.phases[draft.number][0]) for draft in drafts]
    scenes = [jax.tree.map(lambda a, k=k: a[k], some) for some, k in firsts]
    return jax.tree.map(lambda *a: np.stack(a), *scenes)


def phase_paths(planner: Planner, drafts: list[Draft], measure: Measure) -> list[PhasePath]:
    """The legs of each phase as one path; the detours over its gaps are cut short.

    Args:
        planner: margin and smoothing.
        drafts: the phases.
        measure: clearances in the scene of each.
    """
    gaps = [
        (number, leg.name)
        for number, draft in enumerate(drafts)
        for leg in draft.legs
        if leg.has_gap and leg.name in draft.ways
    ]
    short = smoothing.shortcut_paths(
        measure_some(measure, np.array([number for number, _ in gaps], int)),
        [drafts[number].ways[name].path for number, name in gaps],
        planner.config.labels.margin, planner.config.smoothing,
    )  # fmt: skip
    bridged = dict(zip(gaps, short, strict=True))
    return [_phase_path(draft, number, bridged) for number, draft in enumerate(drafts)]


def _phase_path(draft: Draft, number: int, bridged: dict[tuple, np.ndarray]) -> PhasePath:
    """The legs of phase `number` as one path, with the motions that bridge its gaps."""
    q, feasible, windows, at = [], [], [], 0
    for place, leg in enumerate(draft.legs):
        skip = int(place > 0)  # a key pose between two legs stands once
        path = bridged.get((number, leg.name))
        if path is not None:
            first, last = (at + point - skip for point in (leg.first, leg.last))
            windows.append(Window(first, last, path, draft.ways[leg.name].source))
        q.append(leg.q[skip:])
        feasible.append(leg.feasible[skip:])
        at += len(leg.q) - skip
    return PhasePath(np.concatenate(q), np.concatenate(feasible), windows)


def _candidates(planner: Planner, phase: PhasePath):
    """Joint paths of a phase with their sources: the switch's choice, then the designed seams."""
    if not phase.windows:  # there is nothing to choose
        yield combining.follow_windows(phase)
        return
    combined = combining.combine(planner.cell, phase, planner.scale)
    choice = planner.switch(combined)
    yield combining.assemble(choice, phase)
    if not (np.asarray(choice) == np.asarray(combined.available)).all():
        yield combining.follow_windows(phase)


def time_path(
    cell: Workcell,
    q: np.ndarray,
    sources: np.ndarray,
    smoothness: smoothing.SmoothingConfig,
    speed: timing.TimingConfig,
    tool_speed: float = np.inf,
) -> Trajectory | None:
    """Smooth and time a joint path; None if it keeps no margin."""
    if timing.is_resting(q):
        return timing.resting(cell, q[0], q[-1], int(sources[-1]))
    smoothed = smoothing.smooth(cell, q, sources, smoothness)
    return smoothed and timing.time_parameterize(cell, [smoothed], speed, [tool_speed])[0]


def motion_faults(
    cell: Workcell,
    engine: checking.Engine,
    scene: PhaseScene,
    trajectory: Trajectory,
    free: bool | None = None,
) -> list[str]:
    """What the final check finds wrong with a trajectory in a scene.

    The engine looks at points of the motion. The kernels prove what lies between them, and see a
    capsule whose axis runs right through a thin box, which the engine does not.

    Args:
        cell: in the same scene.
        engine: with the thresholds.
        scene: for the engine.
        trajectory: to be judged.
        free: did the kernels prove it? They are asked where this is not given.
    """
    faults = checking.limit_faults(cell, trajectory, engine.config)
    points = checking.checked_points(trajectory.positions, engine.config.max_step)
    if free is None:
        free = path_is_free(cell, points, tolerance=PROVEN)
    if not free:
        gap = path_clearance(cell, points).min()
        where = "between the points that are looked at it is not proven free; there, "
        faults.append(f"{where if gap >= 0 else ''}clearance falls to {1e3 * gap:.1f} mm")
    touched = checking.collision_fault(engine, scene, trajectory.positions)
    return [*faults, touched] if touched else faults


def find_faults(
    cell: Workcell,
    engine: checking.Engine,
    task: Task,
    number: int,
    trajectory: Trajectory,
    free: bool | None = None,
) -> list[str]:
    """What the final check finds wrong with a phase of a task; the cell is in its scene.

    Args:
        cell, engine: that see it.
        task, number: what the phase is to do.
        trajectory, free: how it does it, see `motion_faults`.
    """
    low, high = task.phases[number]
    scene = phase_scene(cell, task, int(segment_kinds(task)[low]))
    faults = motion_faults(cell, engine, scene, trajectory, free)
    rows = {k: checking.pose_row(task.key_poses[k]) for k in range(low + 1, high + 1)}
    path = trajectory.positions
    faults += checking.passing_faults(
        engine, path, {f"key pose {k}": rows[k] for k in range(low + 1, high)}
    )
    missed = checking.pose_fault(engine, path[-1], rows[high], f"key pose {high}")
    return [*faults, missed] if missed else faults


def finish_phases(
    planner: Planner, engine: checking.Engine, drafts: list[Draft]
) -> list[Trajectory | Fault]:
    """Switch, smooth, time and check phases, of one task or of many, together at each step.

    Args:
        planner: configuration and switch.
        engine: that judges at last.
        drafts: the phases.
    """
    if not drafts:
        return []
    found: list[Trajectory | Fault] = [
        Fault(Status.SEAM_FAILED, Status.SEAM_FAILED.sentence) for _ in drafts
    ]
    cell, scenes = planner.cell, first_scenes(drafts)
    measure = measure_in_scenes(cell, scenes)
    paths = [_candidates(planner, phase) for phase in phase_paths(planner, drafts, measure)]
    going = list(range(len(drafts)))
    while going:
        tried = {i: next(paths[i], None) for i in going}
        going = [i for i in going if tried[i] is not None]
        moving = _moving(planner, drafts, {i: tried[i] for i in going}, measure)
        free = _proven(cell, engine, scenes, moving)
        for i, motion in moving.items():
            here, draft = inside(cell, scenes, i), drafts[i]
            faults = find_faults(here, engine, draft.task, draft.number, motion, free[i])
            found[i] = Fault(Status.COLLISION, "; ".join(faults)) if faults else motion
        going = [i for i in going if isinstance(found[i], Fault)]
    return found


def _moving(
    planner: Planner,
    drafts: list[Draft],
    paths: dict[int, smoothing.MarkedPath],
    measure: Measure,
) -> dict[int, Trajectory]:
    """Smoothed and timed motions along the paths of some drafts, where there are any."""
    config, rows = planner.config, np.array(list(paths), int)
    smooth = smoothing.smooth_paths(
        measure_some(measure, rows), list(paths.values()), config.smoothing
    )
    kept = {int(i): path for i, path in zip(rows, smooth, strict=True) if path is not None}
    speeds = [drafts[i].task.tool_speed(drafts[i].number) for i in kept]
    timed = timing.time_parameterize(planner.cell, list(kept.values()), config.timing, speeds)
    found = {i: motion for i, motion in zip(kept, timed, strict=True) if motion is not None}
    for i, (q, sources) in paths.items():
        if timing.is_resting(q):
            found[i] = timing.resting(planner.cell, q[0], q[-1], int(sources[-1]))
    return found


def _proven(
    cell: Workcell, engine: checking.Engine, scenes: Scene, motions: dict[int, Trajectory]
) -> dict[int, bool]:
    """Which motions the kernels prove free, each in its scene of `scenes`."""
    points = [
        checking.checked_points(motion.positions, engine.config.max_step)
        for motion in motions.values()
    ]
    rows = np.array(list(motions), int)
    own = jax.tree.map(lambda a: a[rows], scenes)
    free = paths_are_free(cell, own, points, tolerance=PROVEN)
    return dict(zip(motions, free.tolist(), strict=True))
