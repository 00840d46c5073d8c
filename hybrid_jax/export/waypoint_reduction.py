# SPDX-License-Identifier: MIT
"""Few way points between which even joint motion keeps to a trajectory, for controllers' programs.

A program is a list of timed joint moves, in any vendor's language.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.interpolate import BPoly

from hybrid_jax.types import Workcell
from hybrid_jax.workcell.layout import home_qpos

TOLERANCE = 5e-5
"""Largest deviation of the tool from the trajectory at any time, with even joint motion [m]."""
JOINT_TOLERANCE = 1e-3
"""Largest deviation of a joint from the trajectory at any time [rad or m]."""
LEAST = 8
"""Duration of the shortest move: the interpolation period of common controllers [ms]."""


@dataclass(frozen=True)
class RestToRest:
    """One motion from rest to rest."""

    command: str
    """Command to the gripper before the motion; "" for none."""
    stamps: np.ndarray
    """`[point]` time from the phase's beginning, whole [ms], as programs state them."""
    q: np.ndarray
    """`[point, joint]` configurations at these times [rad or m]."""


def rest_to_rest(trajectory: dict) -> Iterator[RestToRest]:
    """Phases sampled every millisecond; between its points the trajectory is a quintic."""
    points, commands = (
        trajectory["points"],
        {g["point"]: g["command"] for g in trajectory["gripper"]},
    )
    for phase in trajectory["phases"]:
        first, last = phase["first"], phase["last"]
        times = np.array([p["time_from_start"] for p in points[first : last + 1]])
        kinds = ("positions", "velocities", "accelerations")
        rows = np.array([[p[k] for k in kinds] for p in points[first : last + 1]])
        knots, duration = times - times[0], times[-1] - times[0]
        stamps = np.arange(int(np.ceil(1e3 * duration - 1e-6)) + 1)
        q = BPoly.from_derivatives(knots, rows)(np.minimum(stamps / 1e3, duration))
        # a command stands at the last point before its phase; for the first phase, at point 0
        yield RestToRest(commands.get(first - 1 if first else 0, ""), stamps, q)


def tool_levers(cell: Workcell, q: np.ndarray) -> np.ndarray:
    """`[point, 3, joint]` position Jacobian of the tool at `[point, joint]` [m/rad or 1]."""
    model, layout = cell.model, cell.source.layout
    data, jacobians = mujoco.MjData(model), np.empty((len(q), 3, len(layout.joints)))
    data.qpos[:], jacobian = home_qpos(model), np.empty((3, model.nv))
    for row, values in zip(jacobians, q, strict=True):
        data.qpos[list(layout.qpos)] = values
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_jacSite(model, data, jacobian, None, layout.tool_site)
        row[:] = jacobian[:, list(layout.dofs)]
    return jacobians


def reduced(stamps: np.ndarray, q: np.ndarray, levers: np.ndarray) -> list[int]:
    """Points between which even joint motion keeps to a trajectory, within the tolerances.

    Args:
        stamps: `[point]` times [ms].
        q: `[point, joint]` configurations [rad or m].
        levers: `[point, 3, joint]` position Jacobians of the tool [m/rad or 1].

    Returns:
        Indices of these points, the first and the last among them.
    """
    indices, last = [0], len(stamps) - 1
    while indices[-1] < last:
        first, end = indices[-1], min(last, indices[-1] + LEAST)
        while end < last and _even(stamps, q, levers, first, end + 1):
            end += 1
        indices.append(end)
    # the last move may be too short: it takes a part of the move before it, which is even anyway
    if len(indices) > 2 and last - indices[-2] < LEAST <= (last - indices[-3]) / 2:
        indices[-2] = last - LEAST
    return indices


def _even(stamps, q: np.ndarray, levers: np.ndarray, first: int, last: int) -> bool:
    window = slice(first, last + 1)
    share = (stamps[window] - stamps[first]) / (stamps[last] - stamps[first])
    deviation = q[first] + share[:, None] * (q[last] - q[first]) - q[window]
    tool = np.linalg.norm(np.einsum("pij,pj->pi", levers[window], deviation), axis=1)
    return bool(np.abs(deviation).max() <= JOINT_TOLERANCE and tool.max() <= TOLERANCE)
