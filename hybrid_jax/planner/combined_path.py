# SPDX-License-Identifier: MIT
"""traj_comb: the skill's and the joint agent's motion on one grid, and the choice between them."""

from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from hybrid_jax.contracts import STEPS, Combined, Executor
from hybrid_jax.kernels.kinematics import chain_manipulability
from hybrid_jax.planner.smoothing import at_places
from hybrid_jax.runtime.kept_programs import kept
from hybrid_jax.types import KinematicChain, Source, Workcell

LEAST = 20
"""Smallest number of grid points of a bridged gap."""


@kept
def _manipulabilities(chain: KinematicChain, q):
    """Manipulability `[point]` at configurations `[point, joint]`."""
    return jax.vmap(chain_manipulability, (None, 0))(chain, q)


@dataclass(frozen=True)
class Window:
    """A gap of a phase and the motion that bridges it."""

    first: int
    """Point of the skill's path at which it begins."""
    last: int
    """Point of the skill's path at which it ends."""
    path: np.ndarray
    """`[way point, joint]` from the one point to the other [rad or m]."""
    source: Source
    """The method that found the motion."""


@dataclass(frozen=True)
class PhasePath:
    """One phase between gripper events: the skill's joint path and its bridged gaps."""

    q: np.ndarray
    """`[point, joint]` joint path along the skill [rad or m]."""
    feasible: np.ndarray
    """`[point]` True where the arm can follow the skill."""
    windows: list[Window]
    """Bridged gaps, in order and without overlap."""


def _length(q: np.ndarray) -> float:
    # a part of one point has no length, and lengths are divided by their sum
    return float(np.abs(np.diff(q, axis=0)).sum()) + 1e-6


def _shares(lengths: list[float], least: list[int]) -> np.ndarray:
    """Numbers of grid points `[part]`: the least ones, and the remaining points by length.

    The sum is `STEPS`.
    """
    remaining = STEPS - sum(least)
    counts = np.array(least) + np.floor(remaining * np.array(lengths) / sum(lengths)).astype(int)
    counts[int(np.argmax(lengths))] += STEPS - counts.sum()
    return counts


def _grid(phase: PhasePath) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The grid of a phase.

    Skill and windows share the grid points in proportion to their lengths. The first grid point
    after a window is the window's end.

    Returns:
        For each grid point `[STEPS]`: its place on the skill's path, in points of that path; the
        number of its window, -1 outside of all; its place in the part, as a share of the length.
    """
    # parts alternate: skill, window, skill, ..., so windows have odd numbers
    cuts = [0, *(i for w in phase.windows for i in (w.first, w.last)), len(phase.q) - 1]
    lengths, least = [], []
    for number, (low, high) in enumerate(zip(cuts[:-1], cuts[1:], strict=True)):
        is_window = number % 2
        part = phase.windows[number // 2].path if is_window else phase.q[low : high + 1]
        lengths.append(_length(part))
        least.append(LEAST if is_window else 1)
    counts = _shares(lengths, least)
    places, window_at, shares = [], [], []
    for number, (low, high, count) in enumerate(zip(cuts[:-1], cuts[1:], counts, strict=True)):
        is_last = number == len(counts) - 1
        places.append(np.linspace(low, high, count, endpoint=is_last))
        window_at.append(np.full(count, number // 2 if number % 2 else -1))
        shares.append(np.linspace(0, 1, count, endpoint=False))
    return np.concatenate(places), np.concatenate(window_at), np.concatenate(shares)


def _places(path: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """Places, in points of a polyline `[n, joint]`, of shares of its length."""
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    return np.interp(shares, length / max(length[-1], 1e-9), np.arange(len(path)))


def _portion(path: np.ndarray, low: float, high: float) -> np.ndarray:
    """The part of a polyline `[n, joint]` between two places, with all its points."""
    inner = np.arange(np.floor(low) + 1, np.ceil(high))
    return at_places(path, np.unique(np.concatenate([[low], inner, [high]])))


def both_motions(phase: PhasePath) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Both motions of a phase on the grid of the switching agent (traj_comb).

    Args:
        phase: the skill's joint path and the motions that bridge its gaps.

    Returns:
        Configurations of skill and joint agent `[2, STEPS, joint]` [rad or m], where they are not
        feasible `[2, STEPS]`, and where the joint agent has a motion `[STEPS]`.
    """
    places, window_at, shares = _grid(phase)
    q_skill = at_places(phase.q, places)
    ok = phase.feasible[np.floor(places).astype(int)] & phase.feasible[np.ceil(places).astype(int)]
    # outside of the windows the skill stands in for the motion that the joint agent does not have
    q_drl = q_skill.copy()
    for number, window in enumerate(phase.windows):
        in_window = window_at == number
        q_drl[in_window] = at_places(window.path, _places(window.path, shares[in_window]))
    available = window_at >= 0
    return np.stack([q_skill, q_drl]).astype(np.float32), np.stack([~ok, ~available]), available


def manipulabilities(cell: Workcell, q: np.ndarray) -> np.ndarray:
    """Manipulability `[...]` at configurations `[..., joint]`."""
    return np.asarray(_manipulabilities(cell.chain, q.reshape(-1, q.shape[-1]))).reshape(
        q.shape[:-1]
    )


def combine(
    cell: Workcell, phase: PhasePath, scale: float, execute: Executor | None = None
) -> Combined:
    """Both motions of a phase as a problem of the switching agent.

    Args:
        cell: the robot, for manipulability, and the scene of the phase.
        phase: the skill's joint path and the motions that bridge its gaps.
        scale: manipulability that counts as 1.
        execute: judges points by what becomes of them; as they are planned if None.

    Returns:
        Configurations, manipulability and feasibility of both motions on `STEPS` grid points, on
        the host, in float32.
    """
    q, infeasible, available = both_motions(phase)
    passed, collides = execute(cell.scene, q) if execute else (q, np.zeros(q.shape[:2], bool))
    man_share = np.clip(manipulabilities(cell, passed) / scale, 0, 1)
    leaves: list[Any] = [
        np.asarray(a, np.float32) for a in (q, man_share, infeasible | collides, available)
    ]
    return Combined(*leaves)


def follow_windows(phase: PhasePath) -> tuple[np.ndarray, np.ndarray]:
    """The skill's path with every gap replaced by the motion that bridges it.

    Args:
        phase: the skill's joint path and the motions that bridge its gaps.

    Returns:
        Way points `[point, joint]` [rad or m] and the `Source` of each `[point]`.
    """
    parts, sources, resume = [], [], 0
    for window in phase.windows:
        parts += [phase.q[resume : window.first + 1], window.path[1:-1]]
        sources += [Source.LFD, window.source]
        resume = window.last
    parts.append(phase.q[resume:])
    sources.append(Source.LFD)
    marks = [np.full(len(p), s, np.uint8) for p, s in zip(parts, sources, strict=True)]
    return np.concatenate(parts), np.concatenate(marks)


def assemble(choice: np.ndarray, phase: PhasePath) -> tuple[np.ndarray, np.ndarray]:
    """The joint path that follows a choice between skill and joint agent.

    The way points of skill and windows are kept: the grid would cut their corners.

    Args:
        choice: `[STEPS]` 0 for the skill, 1 for the joint agent; it counts only in windows.
        phase: the skill's joint path and the motions that bridge its gaps.

    Returns:
        Way points `[point, joint]` [rad or m] and the `Source` of each `[point]`.
    """
    places, window_at, shares = _grid(phase)
    choice = np.asarray(choice) * (window_at >= 0)
    chosen_window = np.where(choice == 1, window_at, -1)
    cuts = np.flatnonzero(np.diff(chosen_window)) + 1
    parts, sources = [], []
    for low, high in zip([0, *cuts], [*cuts, STEPS], strict=True):
        number, last = int(chosen_window[low]), high - 1
        if number < 0:
            parts.append(_portion(phase.q, places[low], places[last]))
            sources.append(Source.LFD)
            continue
        window = phase.windows[number]
        to_end = last + 1 == STEPS or window_at[last + 1] != number
        portion = np.array([shares[low], 1.0 if to_end else shares[last]])
        parts.append(_portion(window.path, *_places(window.path, portion)))
        sources.append(window.source)
    marks = [np.full(len(p), s, np.uint8) for p, s in zip(parts, sources, strict=True)]
    return np.concatenate(parts), np.concatenate(marks)
