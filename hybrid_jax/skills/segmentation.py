# SPDX-License-Identifier: MIT
"""Exact task segmentation: with ordered key poses the plan is a shortest path.

`V(b) = min over a < b, k of V(a) + cost[a, b, k]`, in O(K^2 h). Oracle of the hierarchical DQN,
and the planner where exactness counts.
"""

import heapq
from dataclasses import dataclass

import numpy as np

from hybrid_jax.skills.costs import SegmentCosts

Plan = list[tuple[int, int, int]]
"""Segments (from key pose, to key pose, skill), in order."""


@dataclass(frozen=True)
class MissingSkill:
    """A part of a task that the library does not cover: the demonstration to give."""

    start: int
    end: int
    nearest_skill: str
    distance: float
    """Feature distance of the nearest skill [m]; inf where no skill has the right gripper state."""
    tolerance: float

    def __str__(self):
        return (
            f"key pose {self.start} to {self.end}: nearest skill {self.nearest_skill!r} at "
            f"{self.distance:.3f} m, allowed {self.tolerance:.3f} m"
        )


def optimal_plan(cost: np.ndarray, count: int) -> tuple[Plan, float]:
    """Cheapest admissible plan from key pose 0 to `count - 1`; empty and inf where none exists."""
    value = np.full(count, np.inf)
    value[0] = 0.0
    back: list = [None] * count
    for b in range(1, count):
        for a in range(b):
            k = int(np.argmin(cost[a, b]))
            total = value[a] + cost[a, b, k]
            if total < value[b]:
                value[b], back[b] = total, (a, b, k)
    if not np.isfinite(value[-1]):
        return [], float("inf")
    plan, at = [], count - 1
    while at > 0:
        plan.append(back[at])
        at = back[at][0]
    return plan[::-1], float(value[-1])


def best_plans(cost: np.ndarray, count: int, wanted: int) -> list[Plan]:
    """The cheapest admissible plans, best first: `wanted` of them, or as many as there are."""
    found: list[list[tuple[float, Plan]]] = [[(0.0, [])]]
    for b in range(1, count):
        longer = [
            (total + float(cost[a, b, k]), [*plan, (a, b, int(k))])
            for a in range(b)
            for k in np.flatnonzero(np.isfinite(cost[a, b]))
            for total, plan in found[a]
        ]
        found.append(heapq.nsmallest(wanted, longer))
    return [plan for _, plan in found[-1]]


def optimal_costs(tasks: SegmentCosts) -> np.ndarray:
    """`[task]` cost of the cheapest admissible plan of each task; inf where none exists."""
    cost, count = np.asarray(tasks.cost), np.asarray(tasks.count)
    return np.array([optimal_plan(c, int(n))[1] for c, n in zip(cost, count, strict=True)])


def missing_skills(
    cost: np.ndarray,
    nearest: np.ndarray,
    count: int,
    names: tuple[str, ...],
    tolerance: float,
    first: int = 0,
) -> list[MissingSkill]:
    """Unit segments that no admissible skill covers, alone or as part of a longer segment.

    Args:
        cost, nearest: see `SegmentCosts`.
        count: key poses.
        names: of the skills.
        tolerance: beyond which none is admissible [m].
        first: number of the first key pose.
    """
    forward = [np.isfinite(optimal_plan(cost, b + 1)[1]) for b in range(count)]
    forward[0] = True
    backward = [np.isfinite(optimal_plan(cost[a:, a:], count - a)[1]) for a in range(count)]
    backward[-1] = True
    covered = np.zeros(count - 1, bool)
    for a in range(count):
        for b in range(a + 1, count):
            if forward[a] and backward[b] and np.isfinite(cost[a, b]).any():
                covered[a:b] = True
    gaps = [a for a in range(count - 1) if not covered[a] and not np.isfinite(cost[a, a + 1]).any()]
    gaps = gaps or [a for a in range(count - 1) if not covered[a]]
    out = []
    for a in gaps:
        k = int(np.argmin(nearest[a, a + 1]))
        distance = float(nearest[a, a + 1, k])
        name = names[k] if np.isfinite(distance) and k < len(names) else "none"
        out.append(MissingSkill(first + a, first + a + 1, name, distance, tolerance))
    return out
