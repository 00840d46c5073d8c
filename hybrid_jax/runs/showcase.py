# SPDX-License-Identifier: MIT
"""The demonstration at the end of a training: a few tasks of the cell, carried out in physics."""

import functools
from dataclasses import asdict, dataclass

import numpy as np

from hybrid_jax.contracts import Planning
from hybrid_jax.execution.batches import planning, sort_scene
from hybrid_jax.execution.inspection import EXACT, Trial, inspect_parts
from hybrid_jax.planner.pipeline import plan_batch
from hybrid_jax.planner.records import Planner
from hybrid_jax.tasks.scene_sampling import require_task_data
from hybrid_jax.types import Workcell
from hybrid_jax.workcell.description import Handling, Inspection


@dataclass(frozen=True)
class Shown:
    """Outcome of the demonstration."""

    rows: list[dict]
    """One for each object: name, success, cause, detail, shares of the sources."""
    frames: np.ndarray
    """`[frame, nq]` MuJoCo's `qpos` after each tick."""
    touched: int
    """Number of contacts that were not allowed."""


def show(planner: Planner, seed: int, count: int) -> Shown:
    """Carry out the tasks of `count` objects of the planner's cell in physics.

    Args:
        planner: makes the plans.
        seed: of scenes and plans.
        count: number of objects (handling) or trials (inspection).
    """
    cell = planner.cell
    return _SHOWS[type(require_task_data(cell))](
        cell, planning(functools.partial(plan_batch, planner), seed), seed, count
    )


def _sorting(cell: Workcell, plan: Planning, seed: int, count: int) -> Shown:
    """Sort objects of one scene, one after the other."""
    names = list(cell.source.layout.object_names)[-count:]
    report = sort_scene(cell, plan, seed, names)
    return Shown([asdict(entry) for entry in report.reports], report.frames, len(report.touches))


def _inspecting(cell: Workcell, plan: Planning, seed: int, count: int) -> Shown:
    """Brush parts, each in its own scene."""
    parts = [spec.name for spec in require_task_data(cell).objects]
    trials = [Trial(parts[3 * i % len(parts)], seed + i) for i in range(count)]
    reports = inspect_parts(cell, plan, trials)
    rows = [
        {
            "name": r.trial.part,
            "success": r.succeeded(*EXACT),
            "cause": r.cause,
            "detail": r.detail,
            "shares": r.shares,
            "planning_s": r.planning_s,
            "cycle_s": r.seconds,
        }
        for r in reports
    ]
    return Shown(
        rows, np.concatenate([r.frames for r in reports]), sum(len(r.touches) for r in reports)
    )


_SHOWS = {Handling: _sorting, Inspection: _inspecting}
