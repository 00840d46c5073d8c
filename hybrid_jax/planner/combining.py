# SPDX-License-Identifier: MIT
"""traj_comb: the skill's and the joint agent's motion on one grid, and the choice between them."""

from dataclasses import dataclass

import jax
import numpy as np

from hybrid_jax.agents.switching import STEPS, Combined
from hybrid_jax.kernels.kinematics import manipulability
from hybrid_jax.planner.smoothing import at_places
from hybrid_jax.types import Source, Workcell

LEAST = 20
"""Grid points of a bridged gap, at least."""

_manipulability = jax.jit(jax.vmap(manipulability, (None, 0)))


@dataclass(frozen=True)
class Window:
    """A gap of a phase and the motion that bridges it."""

    first: int
    """Point of the skill's path at which it begins, ..."""
    last: int
    """... and ends."""
    path: np.ndarray
    """`[way point, joint]` from one to the other."""
    source: Source


@dataclass(frozen=True)
class PhasePath:
    """One phase between gripper events: the skill's joint path and its bridged gaps."""

    q: np.ndarray
    """`[point, joint]`."""
    feasible: np.ndarray
    """`[point]`."""
    windows: list[Window]
    """In order, apart from each other."""


def _length(q: np.ndarray) -> float:
    return float(np.abs(np.diff(q, axis=0)).sum()) + 1e-6


def _shares(lengths: list[float], least: list[int]) -> np.ndarray:
    """Grid points of each part: at least so many, the others by length; `STEPS` in all."""
    spare = STEPS - sum(least)
    counts = np.array(least) + np.floor(spare * np.array(lengths) / sum(lengths)).astype(int)
    counts[int(np.argmax(lengths))] += STEPS - counts.sum()
    return counts


def _grid(phase: PhasePath) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Place on the skill's path at each grid point, which window it is in (-1: none), and where.

    Where is a share of the window's length. A window takes as many grid points as its length
    asks for beside the skill's parts; the first point after it is its end.
    """
    cuts = [0, *(i for w in phase.windows for i in (w.first, w.last)), len(phase.q) - 1]
    lengths, least = [], []
    for number, (low, high) in enumerate(zip(cuts[:-1], cuts[1:], strict=True)):
        window = number % 2
        part = phase.windows[number // 2].path if window else phase.q[low : high + 1]
        lengths.append(_length(part))
        least.append(LEAST if window else 1)
    counts = _shares(lengths, least)
    skill, inside, where = [], [], []
    for number, (low, high, count) in enumerate(zip(cuts[:-1], cuts[1:], counts, strict=True)):
        last = number == len(counts) - 1
        skill.append(np.linspace(low, high, count, endpoint=last))
        inside.append(np.full(count, number // 2 if number % 2 else -1))
        where.append(np.linspace(0, 1, count, endpoint=False))
    return np.concatenate(skill), np.concatenate(inside), np.concatenate(where)


def _places(path: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """Places, in points of a polyline `[n, joint]`, of shares of its length."""
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    return np.interp(shares, length / max(length[-1], 1e-9), np.arange(len(path)))


def _portion(path: np.ndarray, low: float, high: float) -> np.ndarray:
    """The part of a polyline between two places, with all its points."""
    inner = np.arange(np.floor(low) + 1, np.ceil(high))
    return at_places(path, np.unique(np.concatenate([[low], inner, [high]])))


def combine(cell: Workcell, phase: PhasePath, scale: float) -> Combined:
    """Both motions of a phase on the grid of the switching agent.

    Args:
        cell: for manipulability.
        phase: the skill's joint path and the motions that bridge its gaps.
        scale: manipulability that counts as 1.
    """
    skill, inside, where = _grid(phase)
    q_skill = at_places(phase.q, skill)
    fine = phase.feasible[np.floor(skill).astype(int)] & phase.feasible[np.ceil(skill).astype(int)]
    q_drl = q_skill.copy()
    for number, window in enumerate(phase.windows):
        here = inside == number
        q_drl[here] = at_places(window.path, _places(window.path, where[here]))
    available = (inside >= 0).astype(np.float32)
    q = np.stack([q_skill, q_drl]).astype(np.float32)
    man = np.asarray(_manipulability(cell, q.reshape(-1, q.shape[-1])))
    return Combined(
        q,
        np.clip(man / scale, 0, 1).reshape(2, STEPS).astype(np.float32),
        np.stack([~fine, available == 0]).astype(np.float32),
        available,
    )


def follow_windows(phase: PhasePath) -> tuple[np.ndarray, np.ndarray]:
    """The skill, but every gap as it was bridged: way points and the source of each."""
    parts, sources, at = [], [], 0
    for window in phase.windows:
        parts += [phase.q[at : window.first + 1], window.path[1:-1]]
        sources += [Source.LFD, window.source]
        at = window.last
    parts.append(phase.q[at:])
    sources.append(Source.LFD)
    marks = [np.full(len(p), s, np.uint8) for p, s in zip(parts, sources, strict=True)]
    return np.concatenate(parts), np.concatenate(marks)


def assemble(choice: np.ndarray, phase: PhasePath) -> tuple[np.ndarray, np.ndarray]:
    """The chosen joint path `[point, joint]` and the source of each point.

    The way points of skill and windows are kept: the grid would cut their corners.
    """
    skill, inside, where = _grid(phase)
    choice = np.asarray(choice) * (inside >= 0)
    kind = np.where(choice == 1, inside, -1)
    cuts = np.flatnonzero(np.diff(kind)) + 1
    parts, sources = [], []
    for low, high in zip([0, *cuts], [*cuts, STEPS], strict=True):
        number, last = int(kind[low]), high - 1
        if number < 0:
            parts.append(_portion(phase.q, skill[low], skill[last]))
            sources.append(Source.LFD)
            continue
        window = phase.windows[number]
        ends = last + 1 == STEPS or inside[last + 1] != number
        share = np.array([where[low], 1.0 if ends else where[last]])
        parts.append(_portion(window.path, *_places(window.path, share)))
        sources.append(window.source)
    marks = [np.full(len(p), s, np.uint8) for p, s in zip(parts, sources, strict=True)]
    return np.concatenate(parts), np.concatenate(marks)
