# SPDX-License-Identifier: MIT
"""The branch of every key pose, chosen over the whole task at once (IKLink, arXiv:2402.16154).

A leg is one unit segment: it begins on a candidate of its first key pose and ends on one of its
last. Where no feasible joint path joins the two, the leg has a gap, which the joint agent bridges.
The route with the fewest infeasible way points, then the shortest gaps, is a shortest path.
"""

from dataclasses import dataclass, replace

import jax
import numpy as np

from hybrid_jax.kernels.batching import padded_chunks
from hybrid_jax.planner.labelling import LabelConfig, Labels, label_tasks
from hybrid_jax.skills.task import Task
from hybrid_jax.types import Scene, Workcell

HANDOVER = 3
"""Way points by which a gap reaches into the feasible parts on both sides."""
GUARD = 1
"""Way points beside a gripper event that belong to the skill: no hand-over there, ..."""
LAST_RESORT = 1000.0
"""... unless no other route is left: what such a leg costs more, in infeasible way points."""
TOGETHER = 16
"""Tasks that are labelled in one call."""
GAP_COST, WAY_COST = 10.0, 5.0
"""Costs of a gap and of a radian between its ends, in infeasible way points."""


@dataclass(frozen=True)
class Leg:
    """One unit segment between two candidates."""

    q: np.ndarray
    """`[point, joint]` the skill's joint path: branch of the start, then branch of the end."""
    feasible: np.ndarray
    """`[point]`."""
    first: int
    """Point at which the gap begins: the joint agent takes over here."""
    last: int
    """Point at which it hands back; `first` where there is no gap."""
    name: tuple[int, int, int]
    """Segment and the candidates at its ends."""

    @property
    def has_gap(self) -> bool:
        return self.last > self.first


def _leading(ok: np.ndarray) -> np.ndarray:
    """How many points are feasible before the first one that is not, along the last axis."""
    return np.argmin(np.append(ok, np.zeros_like(ok[..., :1]), axis=-1), axis=-1)


class Routes:
    """All legs of one task, and what they cost."""

    def __init__(self, labels: Labels, events: np.ndarray, config: LabelConfig):
        """Args:
        labels: of one task, on the host.
        events: `[key pose]` does the gripper move there?
        config: thresholds of the labels.
        """
        self.labels, self.events = labels, events
        points = labels.ahead_ok.shape[-1]
        prefix, tail = _leading(labels.ahead_ok), _leading(labels.back_ok[..., ::-1])
        shape = np.broadcast_shapes(prefix[:, :, None].shape, tail[:, None].shape)
        self.first = np.broadcast_to(prefix[:, :, None] - 1, shape).copy()
        self.last = np.broadcast_to(points - tail[:, None], shape).copy()
        self._join(config.max_jump)
        self.cost = self._costs()

    def _join(self, max_jump: float) -> None:
        """Where both paths are feasible in between, change over where they are nearest."""
        ahead, back = self.labels.ahead[:, :, None], self.labels.back[:, None]
        jump = np.abs(ahead[..., :-1, :] - back[..., 1:, :]).max(axis=-1)
        at = np.arange(jump.shape[-1])
        both = (at <= self.first[..., None]) & (at + 1 >= self.last[..., None])
        jump = np.where(both, jump, np.inf)
        change, overlap = np.argmin(jump, axis=-1), both.any(axis=-1)
        self.joined = np.min(jump, axis=-1) <= max_jump
        self.first = np.where(overlap, change, self.first)
        self.last = np.where(overlap, change + 1, self.last)

    def _costs(self) -> np.ndarray:
        """`[segment, from, to]`, infinite where a leg must not be used."""
        labels, points, events = self.labels, self.labels.ahead.shape[2], self.events
        index = np.ix_(*map(np.arange, self.first.shape))
        begin, end = np.maximum(self.first, 0), np.minimum(self.last, points - 1)
        leave = labels.ahead[index[0], index[1], begin]
        resume = labels.back[index[0], index[2], end]
        away = WAY_COST * np.abs(leave - resume).max(axis=-1)
        cost = np.where(self.joined, away, GAP_COST + (end - begin) + away)
        start_guard = np.where(events[:-1], GUARD, 0)[:, None, None]
        end_guard = points - 1 - np.where(events[1:], GUARD, 0)[:, None, None]
        guarded = (self.first >= start_guard) & (self.last <= end_guard)
        cost = np.where(guarded | self.joined, cost, cost + LAST_RESORT)
        possible = (self.first >= 0) & (self.last <= points - 1)
        cost = np.where(possible, cost, np.inf)
        same = np.eye(cost.shape[1], dtype=bool) & labels.kept[:, :, None]
        cost = np.where(same, 0.0, cost)
        self.joined = self.joined | same
        pair = labels.usable[:-1, :, None] & labels.usable[1:, None]
        return np.where(pair, cost, np.inf)

    def cheapest(self) -> list[tuple[int, int, int]] | None:
        """Names of the legs of the cheapest route; None where there is none."""
        value, back = np.where(self.labels.usable[0], 0.0, np.inf), []
        for cost in self.cost:
            total = value[:, None] + cost
            back.append(np.argmin(total, axis=0))
            value = np.min(total, axis=0)
        at = int(np.argmin(value))
        if not np.isfinite(value[at]):
            return None
        names = []
        for segment in range(len(self.cost) - 1, -1, -1):
            before = int(back[segment][at])
            names.append((segment, before, at))
            at = before
        return names[::-1]

    def _least(self) -> list[float]:
        """Cost of the cheapest way to any candidate of each key pose; inf where there is none."""
        value = np.where(self.labels.usable[0], 0.0, np.inf)
        found = [float(value.min())]
        for cost in self.cost:
            value = np.min(value[:, None] + cost, axis=0)
            found.append(float(value.min()))
        return found

    def least_cost(self) -> float:
        """Cost of the cheapest route, in infeasible way points; inf where there is none."""
        return self._least()[-1]

    def blocked_segment(self) -> int:
        """First unit segment that no route gets over; the number of segments if there is none."""
        finite = np.isfinite(self._least())
        return len(self.cost) if finite.all() else max(0, int(np.argmin(finite)) - 1)

    def leg(self, name: tuple[int, int, int]) -> Leg:
        """A leg by its name."""
        segment, start, end = name
        labels, points = self.labels, self.labels.ahead.shape[2]
        ahead, back = labels.ahead[segment, start], labels.back[segment, end]
        if start == end and labels.kept[segment, start]:
            return Leg(ahead, np.ones(points, bool), 0, 0, name)
        first, last = int(self.first[name]), int(self.last[name])
        q = np.concatenate([ahead[: first + 1], back[first + 1 :]])
        if self.joined[name]:
            return Leg(q, np.ones(points, bool), 0, 0, name)
        index = np.arange(points)
        feasible = (index <= first) | (index >= last)
        low, high = (GUARD * int(self.events[segment + k]) for k in (0, 1))
        begin = max(min(low, first), first - HANDOVER)
        end_ = min(max(points - 1 - high, last), last + HANDOVER)
        return Leg(q, feasible, begin, end_, name)

    def forbid(self, name: tuple[int, int, int]) -> None:
        """Never use a leg again."""
        self.cost[name] = np.inf


def gripper_events(task: Task) -> np.ndarray:
    """`[key pose]` does the gripper move there?"""
    held = np.array([False, *task.carrying, False])
    return held[1:] != held[:-1]


def _without_steps(labels: Labels) -> Labels:
    """No path leaves the key pose that it begins at."""
    ahead, back = labels.ahead_ok.copy(), labels.back_ok.copy()
    ahead[..., -1] = back[..., :-1] = False
    return labels.replace(ahead_ok=ahead, back_ok=back, kept=np.zeros_like(labels.kept))


def label_paths(
    cell: Workcell,
    tasks: list[Task],
    scenes: list[Scene],
    poses: list[np.ndarray],
    scale: float,
    key: jax.Array,
    config: LabelConfig,
    direct: bool = False,
) -> list[Routes]:
    """Label the skills' paths of several tasks with as many key poses each.

    All of them end in a configuration that they name, or none does.

    Args:
        cell: robot and fixtures.
        tasks: what is to be done.
        scenes: of each task's unit segments.
        poses: `[segment, point, 8]` of each task.
        scale: manipulability that counts as 1.
        key: draws IK seeds; consumed.
        config: thresholds.
        direct: whether every segment is a gap from key pose to key pose, see `lfd.without_skills`.
    """
    found = []
    for index, count in padded_chunks(len(tasks), TOGETHER):
        some = jax.tree.map(lambda *a: np.stack(a), *[scenes[i] for i in index])
        starts, free = np.stack([tasks[i].start for i in index]), tasks[index[0]].end is None
        ends = None if free else np.stack([tasks[i].end for i in index])
        rows = np.stack([poses[i] for i in index])
        labels = jax.device_get(
            label_tasks(cell, some, rows, starts, ends, scale, key, index, config)
        )
        join = config
        if direct:  # between near key poses too: a step from one to the other is no skill's
            labels, join = _without_steps(labels), replace(config, max_jump=0.0)
        for i in range(count):
            one = jax.tree.map(lambda a, i=i: a[i], labels)
            found.append(Routes(one, gripper_events(tasks[index[i]]), join))
    return found
