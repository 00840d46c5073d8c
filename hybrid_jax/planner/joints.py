# SPDX-License-Identifier: MIT
"""From one joint configuration to another in any cell: search, shorten, smooth, time, check.

The layer under the hybrid planner, without skills and agents.
"""

from dataclasses import dataclass, replace

import jax
import numpy as np
from jaxtyping import Float, PRNGKeyArray

from hybrid_jax.kernels.edges import path_is_free
from hybrid_jax.kernels.inputs import single_precision
from hybrid_jax.keys import fold_in
from hybrid_jax.planner import smoothing
from hybrid_jax.planner.checking import CheckConfig, Engine, PhaseScene
from hybrid_jax.planner.finishing import motion_faults, time_path
from hybrid_jax.planner.records import PlanResult
from hybrid_jax.planner.refusing import kernels_touch, within_limits
from hybrid_jax.planner.scenes import home_scene, in_scene
from hybrid_jax.planner.smoothing import SmoothingConfig
from hybrid_jax.planner.timing import RESTING, TimingConfig, resting
from hybrid_jax.planner.turns import nearest_goal, rewound, turns_from, unlimited
from hybrid_jax.rrt import RrtConfig, plan_paths
from hybrid_jax.types import Source, Status, Workcell

QUICK = RrtConfig(workers=16, margin=0.001, capacity=512, calls=150)
"""Finds most motions: few nodes, as every call of the kernel pays for the room they might need."""
THOROUGH = replace(
    QUICK, capacity=4096, calls=1000, samples=16, spacing=QUICK.spacing / 2, spread=np.inf
)
"""Everywhere, and in steps that thin obstacles seldom fall between."""


@dataclass(frozen=True)
class JointMotionConfig:
    """Settings of the layer."""

    searches: tuple[RrtConfig, ...] = (QUICK, THOROUGH, THOROUGH, THOROUGH)
    """Tried in turn, each with a random key of its own."""
    margin: float = 0.0002
    """Clearance that a path that was found is proven to keep on all its edges [m], ..."""
    tolerance: float = 0.0003
    """... with so much more where it is measured; less takes longer [m]."""
    smoothing: SmoothingConfig = SmoothingConfig(margin=0.001, shortcut_rounds=12)
    """Of the path that was found."""
    timing: TimingConfig = TimingConfig()
    """Speeds and sampling of the trajectory."""
    check: CheckConfig = CheckConfig()
    """What the trajectory must keep."""


def find_path(
    cell: Workcell, start: np.ndarray, goal: np.ndarray, config: JointMotionConfig, key
) -> np.ndarray | None:
    """Way points `[point, joint]` from start to goal in the scene of the cell; None if none."""
    scene = jax.tree.map(lambda a: np.asarray(a)[None], cell.scene)
    ends = start[None].astype(np.float32), goal[None].astype(np.float32)
    for attempt, search in enumerate(config.searches):
        path = plan_paths(cell, scene, *ends, search, key=fold_in(key, attempt))[0]
        if path is None:
            continue
        if path_is_free(cell, path, config.margin, config.tolerance):
            return path
    return None


def _admit(engine: Engine, cell: Workcell, scene: PhaseScene, start, goal):
    """Start and goal as they can be planned, what was changed, and a refusal or None.

    Both judges are asked: C MuJoCo, and the kernels, whose primitives contain what they stand for.
    """
    ends, notes = [], []
    statuses = (("start", Status.START_INVALID), ("goal", Status.INVALID_TASK))
    for (name, status), q in zip(statuses, (start, goal), strict=True):
        q, note, fault = within_limits(cell, np.asarray(q), name)
        if fault:
            return ends, "", PlanResult(status, fault)
        ends, notes = [*ends, q], [*notes, note]
    engine.enter(scene)
    for name, status, q in (
        ("start", Status.START_INVALID, ends[0]), ("goal", Status.TASK_INFEASIBLE, ends[1]),
    ):  # fmt: skip
        touched = engine.collision(q) or kernels_touch(cell, q)
        if touched:
            return ends, "", PlanResult(status, f"the {name} is not free: {touched}")
    return ends, " ".join(filter(None, notes)), None


@single_precision
def plan_joint_motion(
    cell: Workcell,
    start: Float[np.ndarray, "n"],
    goal: Float[np.ndarray, "n"],
    config: JointMotionConfig = JointMotionConfig(),
    *,
    key: PRNGKeyArray,
    scene: PhaseScene | None = None,
) -> PlanResult:
    """A smooth, timed, checked motion from one configuration to another.

    Args:
        cell: any cell; the scene that it is in does not matter.
        start: `[joint]` [rad or m]; joints without limits may have any reading.
        goal: `[joint]` [rad or m]; joints without limits go the shorter way to it.
        config: settings.
        key: consumed.
        scene: where objects and fingers are, what is held; as in the model's keyframe `home` if
            None.

    Returns:
        One trajectory of way points `[point, joint]` [rad or m] if the status is OK; it has passed
        the same final check as every plan. At rest where start and goal are the same. Bad ends
        raise nothing: the status says which is at fault.
    """
    engine, scene = Engine(cell, config.check), scene or home_scene(cell)
    inside = in_scene(cell, scene)
    start, goal, turns = _near_home(cell, start, goal)
    ends, note, refusal = _admit(engine, inside, scene, start, goal)
    if refusal:
        return refusal
    start, goal = ends
    found = _plan_between(inside, engine, scene, start, goal, config, key)
    if found.status is Status.OK:
        found = replace(found, detail=f"{found.detail} {note}".strip())
    return rewound(cell, found, turns) or found


def _near_home(cell: Workcell, start, goal) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Both ends where joints without limits start within half a turn of home and go the shorter
    way; and the turns that were taken off."""
    start, goal = np.asarray(start, float), np.asarray(goal, float)
    if start.shape != cell.home.shape or goal.shape != start.shape:
        return start, goal, np.zeros(1)  # for `within_limits` to refuse
    if not (np.isfinite(start) & np.isfinite(goal)).all():
        return start, goal, np.zeros(1)
    turns = np.where(unlimited(cell), turns_from(cell, start, np.asarray(cell.home)), 0.0)
    return start - turns, nearest_goal(cell, start - turns, goal), turns


def _plan_between(
    cell: Workcell, engine: Engine, scene: PhaseScene, start, goal, config: JointMotionConfig, key
) -> PlanResult:
    """A checked motion between two free configurations."""
    if np.abs(goal - start).max() < RESTING:
        return PlanResult(Status.OK, Status.OK.sentence, [resting(cell, start, goal, Source.RRT)])
    path = find_path(cell, start, goal, config, key)
    if path is None:
        detail = f"no path was found from start to goal in {len(config.searches)} searches"
        return PlanResult(Status.NO_PATH, detail)
    path = np.concatenate([start[None], path[1:-1], goal[None]])
    short = smoothing.shortcut(cell, path, config.smoothing.margin, config.smoothing)
    found = PlanResult(Status.SEAM_FAILED, Status.SEAM_FAILED.sentence)
    for way in (short, path):
        marks = np.full(len(way), Source.RRT, np.uint8)
        trajectory = time_path(cell, way, marks, config.smoothing, config.timing)
        if trajectory is None:
            continue
        faults = motion_faults(cell, engine, scene, trajectory)
        if not faults:
            return PlanResult(Status.OK, Status.OK.sentence, [trajectory])
        found = PlanResult(Status.COLLISION, "; ".join(faults))
    return found
