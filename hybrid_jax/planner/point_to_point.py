# SPDX-License-Identifier: MIT
"""Motions from one joint configuration to another: search, shorten, smooth, time, check.

This is the layer under the hybrid planner, without skills and agents, for any cell.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import jax
import numpy as np
from jaxtyping import Float, PRNGKeyArray

from hybrid_jax.contracts import PlanResult
from hybrid_jax.kernels.argument_checks import single_precision
from hybrid_jax.kernels.collision.motion_validation import path_clearance, path_is_free
from hybrid_jax.planner.phase_scenes import home_scene, in_scene
from hybrid_jax.planner.rrt_connect import RrtConfig, plan_paths
from hybrid_jax.planner.shortcutting import shortcut
from hybrid_jax.planner.smoothing import SmoothingConfig
from hybrid_jax.planner.task_validation import kernels_touch, within_limits
from hybrid_jax.planner.timing import RESTING, TimingConfig, resting
from hybrid_jax.planner.trajectory_check import CheckConfig, ConfigurationChecker, PhaseScene
from hybrid_jax.planner.trajectory_generation import motion_faults, time_path
from hybrid_jax.planner.turns import nearest_goal, rewound, turns_from, unlimited
from hybrid_jax.runtime.keys import fold_in
from hybrid_jax.types import Source, Status, Workcell

QUICK = RrtConfig(margin=0.001, calls=200)
"""A quick search beside the straight line, which finds most motions."""
WIDE = replace(QUICK, calls=1000, spread=np.inf)
"""A search in all of joint space."""
THOROUGH = replace(WIDE, calls=2000, spacing=QUICK.spacing / 2)
"""The same in steps so small that they seldom miss a thin obstacle."""
LONG = replace(WIDE, calls=8000)
"""A search of large trees, for pockets that are hard to leave and to enter."""
FINE = replace(QUICK, calls=800, spacing=QUICK.spacing / 4)
"""A search beside an edge, around what another one stepped over."""
LEAST_ROOM = 1e-6
"""Clearance that is asked for at ends that touch: no path is proven with it [m]."""


@dataclass(frozen=True)
class JointMotionConfig:
    """Settings of motions from one configuration to another."""

    searches: tuple[RrtConfig, ...] = (QUICK, WIDE, THOROUGH, THOROUGH, LONG)
    """Tried in turn, each with a random key of its own."""
    margin: float = 0.0002
    """Clearance that a path must be proven to keep on all its edges [m]."""
    tolerance: float = 0.0003
    """A path that comes this close to `margin` counts as blocked; a smaller value takes longer to
    prove [m]."""
    smoothing: SmoothingConfig = SmoothingConfig(margin=0.001, shortcut_rounds=12)
    """Shortcuts and smoothing of the path."""
    timing: TimingConfig = TimingConfig()
    """Speeds and sampling of the trajectory."""
    check: CheckConfig = CheckConfig()
    """What the trajectory must keep."""


def find_path(
    cell: Workcell, start: np.ndarray, goal: np.ndarray, config: JointMotionConfig, key
) -> np.ndarray | None:
    """Search for a path from one configuration to another, free of collision on all its edges.

    Args:
        cell: robot and fixtures, in the scene of the motion.
        start: `[joint]` [rad or m].
        goal: `[joint]` [rad or m].
        config: searches and margin.
        key: consumed.

    Returns:
        Way points `[point, joint]` [rad or m]; None if no search finds a path.
    """
    config = _within_room(cell, np.stack([start, goal]), config)
    return next(_paths(cell, start, goal, config, key), None)


def _paths(
    cell: Workcell, start: np.ndarray, goal: np.ndarray, config: JointMotionConfig, key
) -> Iterator[np.ndarray]:
    """Paths as those of `find_path`, one of each search that finds one."""
    for attempt, search in enumerate(config.searches):
        path = _search(cell, start, goal, search, fold_in(key, attempt))
        if path is None:
            continue
        # the search checks samples only and may step over a thin obstacle
        if not path_is_free(cell, path, config.margin, config.tolerance):
            path = _around(cell, path, config, fold_in(key, len(config.searches) + attempt))
        if path is not None:
            yield path


def _search(cell: Workcell, start: np.ndarray, goal: np.ndarray, search: RrtConfig, key):
    """Way points `[point, joint]` of one search, not proven; None if it finds none."""
    scene = jax.tree.map(lambda a: np.asarray(a)[None], cell.scene)
    ends = start[None].astype(np.float32), goal[None].astype(np.float32)
    return plan_paths(cell, scene, *ends, search, key=key)[0]


def _around(cell: Workcell, path: np.ndarray, config: JointMotionConfig, key) -> np.ndarray | None:
    """A path `[point, joint]` whose blocked edges are ways around; None where one has none."""
    pieces, fine = [path[:1]], replace(FINE, margin=config.searches[0].margin)
    is_free = lambda way: path_is_free(cell, way, config.margin, config.tolerance)  # noqa: E731
    for number, edge in enumerate(zip(path, path[1:], strict=False)):
        way = np.stack(edge)
        if not is_free(way):
            way = _search(cell, *edge, fine, fold_in(key, number))
            if way is None or not is_free(way):
                return None
        pieces.append(way[1:])
    return np.concatenate(pieces)


def _admit(checker: ConfigurationChecker, cell: Workcell, start, goal):
    """Start and goal as they can be planned, what was changed, and a refusal or None.

    Both C MuJoCo and the kernels must find them free; the kernels' primitives contain the solids.
    """
    ends, notes = [], []
    statuses = (("start", Status.START_INVALID), ("goal", Status.INVALID_TASK))
    for (name, status), q in zip(statuses, (start, goal), strict=True):
        q, note, fault = within_limits(cell, np.asarray(q), name)
        if fault:
            return ends, "", PlanResult(status, fault)
        ends, notes = [*ends, q], [*notes, note]
    for name, status, q in (
        ("start", Status.START_INVALID, ends[0]),
        ("goal", Status.TASK_INFEASIBLE, ends[1]),
    ):
        touched = (checker.collision(q) if checker.gap(q) <= 0 else None) or kernels_touch(cell, q)
        if touched:
            return ends, "", PlanResult(status, f"the {name} is not free: {touched}")
    return ends, " ".join(filter(None, notes)), None


@single_precision
def plan_joint_motion(
    cell: Workcell,
    start: Float[np.ndarray, " n"],
    goal: Float[np.ndarray, " n"],
    config: JointMotionConfig = JointMotionConfig(),
    *,
    key: PRNGKeyArray,
    scene: PhaseScene | None = None,
) -> PlanResult:
    """Plan a smooth, timed, checked motion from one configuration to another.

    Args:
        cell: any cell; the scene that it is in does not matter.
        start: `[joint]` [rad or m]; joints without limits may have any reading.
        goal: `[joint]` [rad or m]; joints without limits go the shorter way to it.
        config: settings.
        key: consumed.
        scene: where objects and fingers are, and what is held; as in the model's keyframe `home`
            if None.

    Returns:
        One trajectory of way points `[point, joint]` [rad or m] if the status is OK; it has passed
        the same final check as every plan, and is at rest where start and goal are the same. Where
        an end is closer to a contact than the check allows, the motion must be nine tenths as far
        from all contacts, and the detail says so. Bad ends raise nothing: the status says which is
        at fault.
    """
    checker, scene = ConfigurationChecker(cell, config.check), scene or home_scene(cell)
    scene_cell = in_scene(cell, scene)
    start, goal, turns = _near_home(cell, start, goal)
    checker.enter(scene)
    ends, note, refusal = _admit(checker, scene_cell, start, goal)
    if refusal:
        return refusal
    start, goal = ends
    config = _kept_by(scene_cell, checker, ends, config)
    if config.check != checker.config:
        kept = 1e3 * config.check.clearance
        near = f"(it keeps {kept:.2f} mm only, nine tenths of what start and goal have)"
        note = f"{note} {near}".strip()
        checker = ConfigurationChecker(cell, config.check)
    result = _plan_between(scene_cell, checker, scene, start, goal, config, key)
    if result.status is Status.OK:
        result = replace(result, detail=f"{result.detail} {note}".strip())
    return rewound(cell, result, turns) or result


def _within_room(cell: Workcell, ends: np.ndarray, config: JointMotionConfig) -> JointMotionConfig:
    """The settings with clearances of paths that the ends `[end, joint]` keep themselves."""
    gap = max(0.9 * float(path_clearance(cell, ends).min()), LEAST_ROOM)
    return replace(
        config,
        searches=tuple(replace(s, margin=min(s.margin, gap)) for s in config.searches),
        margin=min(config.margin, gap / 2),
        tolerance=min(config.tolerance, gap / 4),
        smoothing=replace(config.smoothing, margin=min(config.smoothing.margin, gap)),
    )


def _kept_by(
    cell: Workcell, checker: ConfigurationChecker, ends: list[np.ndarray], config: JointMotionConfig
) -> JointMotionConfig:
    """The settings with clearances that the ends `[joint]` keep themselves.

    Links of many arms pass within less than a millimetre of one another by design. An arm that
    stands so must be able to leave.
    """
    engine, clearance = min(checker.gap(q) for q in ends), config.check.clearance
    kept = replace(config.check, clearance=0.9 * engine if engine < clearance else clearance)
    return replace(_within_room(cell, np.asarray(ends), config), check=kept)


def _near_home(cell: Workcell, start, goal) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Start and goal in readings near home, and the turns that were taken off, each `[joint]`.

    Joints without limits then start within half a turn of home and go the shorter way.
    """
    start, goal = np.asarray(start, float), np.asarray(goal, float)
    if start.shape != cell.home.shape or goal.shape != start.shape:
        return start, goal, np.zeros(1)  # for `within_limits` to refuse
    if not (np.isfinite(start) & np.isfinite(goal)).all():
        return start, goal, np.zeros(1)
    turns = np.where(unlimited(cell), turns_from(cell, start, np.asarray(cell.home)), 0.0)
    return start - turns, nearest_goal(cell, start - turns, goal), turns


def _plan_between(
    cell: Workcell,
    checker: ConfigurationChecker,
    scene: PhaseScene,
    start,
    goal,
    config: JointMotionConfig,
    key,
) -> PlanResult:
    """A checked motion between two free configurations `[joint]`."""
    if np.abs(goal - start).max() < RESTING:
        return PlanResult(Status.OK, Status.OK.sentence, [resting(cell, start, goal, Source.RRT)])
    detail = f"no path was found from start to goal in {len(config.searches)} searches"
    result = PlanResult(Status.NO_PATH, detail)
    for path in _paths(cell, start, goal, config, key):
        # the search works in single precision: the ends are put back exactly
        path = np.concatenate([start[None], path[1:-1], goal[None]])
        result = _timed(cell, checker, scene, path, config)
        if result.status is Status.OK:
            break
    return result


def _timed(
    cell: Workcell,
    checker: ConfigurationChecker,
    scene: PhaseScene,
    path: np.ndarray,
    config: JointMotionConfig,
) -> PlanResult:
    """A checked trajectory along a path `[point, joint]`, shortened if that succeeds."""
    shortened = shortcut(cell, path, config.smoothing.margin, config.smoothing)
    result = PlanResult(Status.SEAM_FAILED, Status.SEAM_FAILED.sentence)
    for candidate in (shortened, path):
        marks = np.full(len(candidate), Source.RRT, np.uint8)
        trajectory = time_path(cell, candidate, marks, config.smoothing, config.timing)
        if trajectory is None:
            continue
        faults = motion_faults(cell, checker, scene, trajectory)
        if not faults:
            return PlanResult(Status.OK, Status.OK.sentence, [trajectory])
        result = PlanResult(Status.COLLISION, "; ".join(faults))
    return result
