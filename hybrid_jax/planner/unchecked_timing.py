# SPDX-License-Identifier: MIT
"""Joint paths as timed motions, whatever they touch: for what is executed without a check."""

from dataclasses import replace

import numpy as np

from hybrid_jax.kernels.collision.motion_validation import Measure
from hybrid_jax.planner import timing
from hybrid_jax.planner.records import Planner
from hybrid_jax.planner.smoothing import smooth_paths
from hybrid_jax.types import Trajectory


def executable(
    planner: Planner,
    measure: Measure | None,
    q: np.ndarray,
    sources: np.ndarray,
    tool_speed: float,
) -> Trajectory:
    """Way points as a timed motion, rounded where there is room, whatever they touch.

    Args:
        planner: robot and settings.
        measure: clearances on the path, in its scene; None leaves its corners as they are.
        q: `[point, joint]` way points [rad or m].
        sources: `[point]` `Source` of each.
        tool_speed: largest speed of the tool [m/s].
    """
    resting = timing.resting(planner.cell, q[0], q[-1], int(sources[-1]))
    if timing.is_resting(q):
        return resting
    smoothing, path = planner.config.smoothing, None
    if measure:
        (path,) = smooth_paths(measure, [(q, sources)], smoothing)
    if path is None:
        smoothing = replace(smoothing, margin=-1.0, widths=(0.0,))
        (path,) = smooth_paths(_unmeasured, [(q, sources)], smoothing)
    if path is None:
        return resting
    timed = timing.time_parameterize(planner.cell, [path], planner.config.timing, [tool_speed])
    return timed[0] or resting


def _unmeasured(rows: np.ndarray, q: np.ndarray, enough: float) -> np.ndarray:
    """A `Measure` that finds room everywhere."""
    return np.full(len(q), np.inf)
