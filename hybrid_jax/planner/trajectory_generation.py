# SPDX-License-Identifier: MIT
"""Checked trajectories from the chosen legs of a task, one for each phase."""

from dataclasses import dataclass

import jax
import numpy as np

from hybrid_jax.kernels.collision.motion_validation import (
    Measure,
    measure_in_scenes,
    measure_some,
    path_clearance,
    path_is_free,
    paths_are_free,
)
from hybrid_jax.mjx.collision import smallest_clearance
from hybrid_jax.planner import combined_path, smoothing, timing, trajectory_check
from hybrid_jax.planner.branch_selection import Leg
from hybrid_jax.planner.bridging import Way
from hybrid_jax.planner.combined_path import PhasePath, Window
from hybrid_jax.planner.phase_scenes import inside, phase_scene, segment_kinds
from hybrid_jax.planner.records import Planner
from hybrid_jax.planner.shortcutting import shortcut_paths
from hybrid_jax.planner.task_validation import PROVEN
from hybrid_jax.planner.trajectory_check import PhaseScene
from hybrid_jax.tasks.task import Task
from hybrid_jax.types import Scene, Status, Trajectory, Workcell
from hybrid_jax.workcell.poses import pose_row


@dataclass(frozen=True)
class Fault:
    """The reason why a phase could not be finished."""

    status: Status
    """How planning of the phase ended."""
    detail: str
    """A sentence for people."""


@dataclass(frozen=True)
class Draft:
    """A phase that is to be finished."""

    task: Task
    """The task that it belongs to."""
    scenes: Scene
    """Scenes of the task's unit segments, leaves `[segment, ...]`."""
    number: int
    """Number of the phase in the task."""
    legs: list[Leg]
    """Legs of the phase, in order."""
    ways: dict[tuple, Way]
    """Motions over gaps, by the names of their legs."""


def first_scenes(drafts: list[Draft]) -> Scene:
    """The scenes in which phases begin, leaves `[draft, ...]`, on the host."""
    firsts = [(draft.scenes, draft.task.phases[draft.number][0]) for draft in drafts]
    scenes = [jax.tree.map(lambda a, k=k: a[k], stacked) for stacked, k in firsts]
    return jax.tree.map(lambda *a: np.stack(a), *scenes)


def phase_paths(planner: Planner, drafts: list[Draft], measure: Measure) -> list[PhasePath]:
    """The legs of each phase as one path; the motions over its gaps are shortened.

    Args:
        planner: margin and smoothing.
        drafts: the phases.
        measure: clearances in the scene of each phase.

    Returns:
        For each phase the skill's joint path `[point, joint]` and the motions over its gaps.
    """
    legs = [(number, leg) for number, draft in enumerate(drafts) for leg in draft.legs]
    gaps = [(i, leg.name) for i, leg in legs if leg.has_gap and leg.name in drafts[i].ways]
    shortened = shortcut_paths(
        measure_some(measure, np.array([number for number, _ in gaps], int)),
        [drafts[number].ways[name].path for number, name in gaps],
        planner.config.path_ik.margin,
        planner.config.smoothing,
    )
    bridged = dict(zip(gaps, shortened, strict=True))
    return [_phase_path(draft, number, bridged) for number, draft in enumerate(drafts)]


def _phase_path(draft: Draft, number: int, bridged: dict[tuple, np.ndarray]) -> PhasePath:
    """The legs of phase `number` as one path, with the motions that bridge its gaps."""
    q, feasible, windows, offset = [], [], [], 0
    for order, leg in enumerate(draft.legs):
        skip = int(order > 0)  # a key pose between two legs stands once
        path = bridged.get((number, leg.name))
        if path is not None:
            first, last = (offset + point - skip for point in (leg.first, leg.last))
            windows.append(Window(first, last, path, draft.ways[leg.name].source))
        q.append(leg.q[skip:])
        feasible.append(leg.feasible[skip:])
        offset += len(leg.q) - skip
    return PhasePath(np.concatenate(q), np.concatenate(feasible), windows)


def _candidates(planner: Planner, cell: Workcell, phase: PhasePath):
    """Joint paths of a phase, with sources: first the switch's choice, then all bridged gaps."""
    if not phase.windows:  # there is nothing to choose
        yield combined_path.follow_windows(phase)
        return
    combined = combined_path.combine(cell, phase, planner.scale, planner.execute)
    choice = planner.switch(combined)
    yield combined_path.assemble(choice, phase)
    if not (np.asarray(choice) == np.asarray(combined.available)).all():
        yield combined_path.follow_windows(phase)


def time_path(
    cell: Workcell,
    q: np.ndarray,
    sources: np.ndarray,
    smoothness: smoothing.SmoothingConfig,
    speed: timing.TimingConfig,
    tool_speed: float = np.inf,
) -> Trajectory | None:
    """Smooth and time a joint path.

    Args:
        cell: robot and scene.
        q: `[point, joint]` way points [rad or m].
        sources: `[point]` `Source` of each point.
        smoothness: widths and margin of smoothing.
        speed: shares of the limits, spacing of the result.
        tool_speed: largest speed of the tool [m/s].

    Returns:
        The trajectory; None if no smoothed path keeps the margin, or it cannot be timed.
    """
    if timing.is_resting(q):
        return timing.resting(cell, q[0], q[-1], int(sources[-1]))
    smoothed = smoothing.smooth(cell, q, sources, smoothness)
    return smoothed and timing.time_parameterize(cell, [smoothed], speed, [tool_speed])[0]


def motion_faults(
    cell: Workcell,
    checker: trajectory_check.ConfigurationChecker,
    scene: PhaseScene,
    trajectory: Trajectory,
    free: bool | None = None,
) -> list[str]:
    """What the final check finds wrong with a trajectory in a scene.

    The engine checks points of the motion. The kernels prove what lies between them, and see a
    capsule whose axis runs right through a thin box, which the engine does not.

    Args:
        cell: robot and the same scene, for the kernels.
        checker: C MuJoCo, with the thresholds.
        scene: the scene, for the checker.
        trajectory: to be judged, positions `[point, joint]`.
        free: True if the kernels have proven it free; None to ask them here.

    Returns:
        Sentences; none if nothing is wrong.
    """
    faults = trajectory_check.limit_faults(cell, trajectory, checker.config)
    points = trajectory_check.checked_points(trajectory.positions, checker.config.max_step)
    if free is None:
        free = path_is_free(cell, points, tolerance=PROVEN)
    if not free:
        gap = path_clearance(cell, points).min()
        where = "between the points that are looked at it is not proven free; there, "
        faults.append(f"{where if gap >= 0 else ''}clearance falls to {1e3 * gap:.1f} mm")
    if checker.config.backend == "mjx" and (gap := smallest_clearance(cell, points)) < 0:
        faults.append(f"by MJX, clearance falls to {1e3 * gap:.1f} mm")
    touched = trajectory_check.collision_fault(checker, scene, trajectory.positions)
    return [*faults, touched] if touched else faults


def find_faults(
    cell: Workcell,
    checker: trajectory_check.ConfigurationChecker,
    task: Task,
    number: int,
    trajectory: Trajectory,
    free: bool | None = None,
) -> list[str]:
    """What the final check finds wrong with a phase of a task.

    Args:
        cell: robot and the scene of the phase, for the kernels.
        checker: C MuJoCo, with the thresholds.
        task: the task.
        number: number of the phase.
        trajectory, free: see `motion_faults`.

    Returns:
        Sentences; none if nothing is wrong.
    """
    low, high = task.phases[number]
    # a held object may touch its support in the whole phase; the planner is stricter
    scene = phase_scene(cell, task, int(segment_kinds(task)[low]))
    faults = motion_faults(cell, checker, scene, trajectory, free)
    rows = {k: pose_row(task.key_poses[k]) for k in range(low + 1, high + 1)}
    path = trajectory.positions
    faults += trajectory_check.passing_faults(
        checker, path, {f"key pose {k}": rows[k] for k in range(low + 1, high)}
    )
    missed = trajectory_check.pose_fault(checker, path[-1], rows[high], f"key pose {high}")
    return [*faults, missed] if missed else faults


def finish_phases(
    planner: Planner, checker: trajectory_check.ConfigurationChecker, drafts: list[Draft]
) -> list[Trajectory | Fault]:
    """Switch, smooth, time and check the phases of one or many tasks, all together at each step.

    Args:
        planner: configuration and switch.
        checker: makes the final check.
        drafts: the phases.

    Returns:
        For each phase its trajectory, or the reason why there is none.
    """
    if not drafts:
        return []
    outcomes: list[Trajectory | Fault] = [
        Fault(Status.SEAM_FAILED, Status.SEAM_FAILED.sentence) for _ in drafts
    ]
    cell, scenes = planner.cell, first_scenes(drafts)
    measure = measure_in_scenes(cell, scenes)
    phases = enumerate(phase_paths(planner, drafts, measure))
    paths = [_candidates(planner, inside(cell, scenes, i), phase) for i, phase in phases]
    pending, tried = list(range(len(drafts))), {}
    while pending:
        # the next path of every phase that has no trajectory yet, as far as there is one
        candidates = {i: path for i in pending if (path := next(paths[i], None)) is not None}
        pending = list(candidates)
        tried |= candidates
        motions = _moving(planner, drafts, candidates, measure)
        free = _proven(cell, checker, scenes, motions)
        for i, motion in motions.items():
            scene_cell, draft = inside(cell, scenes, i), drafts[i]
            faults = find_faults(scene_cell, checker, draft.task, draft.number, motion, free[i])
            outcomes[i] = Fault(Status.COLLISION, "; ".join(faults)) if faults else motion
        pending = [i for i in pending if isinstance(outcomes[i], Fault)]
    for i, (q, _) in tried.items():
        if isinstance(fault := outcomes[i], Fault) and fault.status is Status.SEAM_FAILED:
            outcomes[i] = Fault(fault.status, fault.detail + _lack(planner, measure, i, q))
    return outcomes


def _lack(planner: Planner, measure: Measure, number: int, q: np.ndarray) -> str:
    """What the path `[point, joint]` of phase `number` lacks to be smoothed; empty if unknown."""
    config = planner.config.smoothing
    points = smoothing.densify(q, config.spacing / 2)
    gap = float(measure(np.full(len(points), number), points, config.margin).min())
    left, kept = (f"{1e3 * length:.1f} mm" for length in (gap, config.margin))
    text = f"; {left} of clearance are left on the way, and {kept} are kept"
    return text if gap < np.float32(config.margin) else ""


def _moving(
    planner: Planner,
    drafts: list[Draft],
    paths: dict[int, smoothing.MarkedPath],
    measure: Measure,
) -> dict[int, Trajectory]:
    """Smoothed and timed motions along paths, by the number of the draft; some may have none."""
    config, rows = planner.config, np.array(list(paths), int)
    # key poses between the legs of a phase: beside a bridge, rounding would leave them
    through = [np.array([leg.q[-1] for leg in drafts[i].legs]) for i in paths]
    smooth = smoothing.smooth_paths(
        measure_some(measure, rows), list(paths.values()), config.smoothing, through
    )
    smoothed = {int(i): path for i, path in zip(rows, smooth, strict=True) if path is not None}
    speeds = [drafts[i].task.tool_speed(drafts[i].number) for i in smoothed]
    timed = timing.time_parameterize(planner.cell, list(smoothed.values()), config.timing, speeds)
    motions = {i: motion for i, motion in zip(smoothed, timed, strict=True) if motion is not None}
    for i, (q, sources) in paths.items():
        if timing.is_resting(q):
            motions[i] = timing.resting(planner.cell, q[0], q[-1], int(sources[-1]))
    return motions


def _proven(
    cell: Workcell,
    checker: trajectory_check.ConfigurationChecker,
    scenes: Scene,
    motions: dict[int, Trajectory],
) -> dict[int, bool]:
    """Which motions the kernels prove free, each in the scene of its draft."""
    points = [
        trajectory_check.checked_points(motion.positions, checker.config.max_step)
        for motion in motions.values()
    ]
    rows = np.array(list(motions), int)
    motion_scenes = jax.tree.map(lambda a: a[rows], scenes)
    free = paths_are_free(cell, motion_scenes, points, tolerance=PROVEN)
    return dict(zip(motions, free.tolist(), strict=True))
