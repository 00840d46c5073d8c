# SPDX-License-Identifier: MIT
"""Exact task segmentation: with ordered key poses the plan is a shortest path.

`V(b) = min over a < b, k of V(a) + cost[a, b, k]`, in O(K^2 h) for K key poses and h skills. It is
the oracle of the hierarchical DQN, and the planner where exactness counts.
"""

import heapq
from dataclasses import dataclass

import numpy as np

from hybrid_jax.skills.costs import SegmentCosts

SkillPlan = list[tuple[int, int, int]]
"""Segments (from key pose, to key pose, skill), in order."""


@dataclass(frozen=True)
class MissingSkill:
    """A part of a task that the library does not cover, for which a demonstration is needed."""

    start: int
    """Key pose at which the part begins."""
    end: int
    """Key pose at which it ends."""
    nearest_skill: str
    """Name of the skill with the smallest distance; `none` where no skill fits the gripper."""
    distance: float
    """Feature distance of the nearest skill [m]; inf where no skill has the right gripper state."""
    tolerance: float
    """Largest distance that is admissible [m]."""

    def __str__(self):
        return (
            f"key pose {self.start} to {self.end}: nearest skill {self.nearest_skill!r} at "
            f"{self.distance:.3f} m, allowed {self.tolerance:.3f} m"
        )


def optimal_plan(cost: np.ndarray, count: int) -> tuple[SkillPlan, float]:
    """Cheapest admissible plan from key pose 0 to `count - 1`, and its cost.

    Args:
        cost: `[a, b, skill]` [m] as in `SegmentCosts`; inf where a skill is not admissible.
        count: number of key poses.

    Returns:
        Plan and cost [m]; empty and inf where no plan exists.
    """
    value = np.full(count, np.inf)
    value[0] = 0.0
    came_from: list = [None] * count
    for b in range(1, count):
        for a in range(b):
            k = int(np.argmin(cost[a, b]))
            total = value[a] + cost[a, b, k]
            if total < value[b]:
                value[b], came_from[b] = total, (a, b, k)
    if not np.isfinite(value[-1]):
        return [], float("inf")
    plan, key_pose = [], count - 1
    while key_pose > 0:
        plan.append(came_from[key_pose])
        key_pose = came_from[key_pose][0]
    return plan[::-1], float(value[-1])


def best_plans(cost: np.ndarray, count: int, wanted: int) -> list[SkillPlan]:
    """The cheapest admissible plans, the best first.

    Args:
        cost: `[a, b, skill]` [m] as in `SegmentCosts`; inf where a skill is not admissible.
        count: number of key poses.
        wanted: how many plans; there may be fewer.
    """
    # as many plans are enough at each key pose: a cheap plan extends one of the cheapest
    plans_to: list[list[tuple[float, SkillPlan]]] = [[(0.0, [])]]
    for b in range(1, count):
        candidates = [
            (total + float(cost[a, b, k]), [*plan, (a, b, int(k))])
            for a in range(b)
            for k in np.flatnonzero(np.isfinite(cost[a, b]))
            for total, plan in plans_to[a]
        ]
        plans_to.append(heapq.nsmallest(wanted, candidates))
    return [plan for _, plan in plans_to[-1]]


def optimal_costs(tasks: SegmentCosts) -> np.ndarray:
    """Cost of the cheapest admissible plan of each task.

    Args:
        tasks: batch with `cost` `[task, a, b, skill]` and `count` `[task]`.

    Returns:
        `[task]` [m]; inf where a task has no plan.
    """
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
        cost, nearest: `[a, b, skill]` [m], see `SegmentCosts`.
        count: number of key poses.
        names: of the skills.
        tolerance: distance beyond which no skill is admissible [m].
        first: number that messages give to the first key pose.
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
    # a unit segment with a skill of its own is uncovered only because others are: those are named
    gaps = [a for a in range(count - 1) if not covered[a] and not np.isfinite(cost[a, a + 1]).any()]
    gaps = gaps or [a for a in range(count - 1) if not covered[a]]
    missing = []
    for a in gaps:
        k = int(np.argmin(nearest[a, a + 1]))
        distance = float(nearest[a, a + 1, k])
        name = names[k] if np.isfinite(distance) and k < len(names) else "none"
        missing.append(MissingSkill(first + a, first + a + 1, name, distance, tolerance))
    return missing
