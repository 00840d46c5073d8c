# SPDX-License-Identifier: MIT
"""The demonstration at the end of a training: a few tasks of the cell, carried out in physics."""

from dataclasses import asdict, dataclass

import numpy as np

from hybrid_jax.planner.pipeline import plan_batch
from hybrid_jax.planner.records import Planner
from hybrid_jax.simulation.driving import Planning
from hybrid_jax.simulation.inspecting import EXACT, Trial, inspect_parts
from hybrid_jax.simulation.runs import planning, sort_scene
from hybrid_jax.skills.scenes import require_task_data
from hybrid_jax.types import Workcell
from hybrid_jax.workcell.description import Handling, Inspection


@dataclass(frozen=True)
class Shown:
    """What was shown."""

    rows: list[dict]
    """Of each object: name, success, cause, detail, shares of the sources."""
    frames: np.ndarray
    """`[frame, nq]` one for each tick."""
    touched: int
    """Contacts that should not have been."""


def show(planner: Planner, seed: int, count: int) -> Shown:
    """Do the tasks of `count` objects of the cell, in physics."""
    cell = planner.cell
    return _SHOWS[type(require_task_data(cell))](
        cell, planning(planner, plan_batch, seed), seed, count
    )


def _sorting(cell: Workcell, plan: Planning, seed: int, count: int) -> Shown:
    """Sort objects of one scene, one after the other."""
    names = list(cell.source.layout.object_names)[-count:]
    done = sort_scene(cell, plan, seed, names)
    return Shown([asdict(report) for report in done.reports], done.frames, len(done.touches))


def _inspecting(cell: Workcell, plan: Planning, seed: int, count: int) -> Shown:
    """Brush parts, each in a scene of its own."""
    parts = [spec.name for spec in require_task_data(cell).objects]
    trials = [Trial(parts[3 * i % len(parts)], seed + i) for i in range(count)]
    reports = inspect_parts(cell, plan, trials)
    rows = [
        {"name": r.trial.part, "success": r.succeeded(*EXACT), "cause": r.cause, "detail": r.detail,
         "shares": r.shares, "planning_s": r.planning_s, "cycle_s": r.seconds}
        for r in reports
    ]  # fmt: skip
    return Shown(rows, np.concatenate([r.frames for r in reports]),
                 sum(len(r.touches) for r in reports))  # fmt: skip


_SHOWS = {Handling: _sorting, Inspection: _inspecting}
