# SPDX-License-Identifier: MIT
"""Choice of the inverse-kinematics branch of every key pose, over the whole task at once.

A leg is one unit segment between a candidate configuration of its first key pose and one of its
last. Where no feasible joint path joins the two, the leg has a gap, which the joint agent bridges.
The route with the fewest infeasible way points, then the shortest gaps, is a shortest path over
the key poses (as in IKLink, arXiv:2402.16154).
"""

from dataclasses import dataclass, replace

import jax
import numpy as np

from hybrid_jax.planner.key_pose_ik import PathIkConfig
from hybrid_jax.planner.path_ik import Labels, label_tasks
from hybrid_jax.tasks.task import Task
from hybrid_jax.types import Scene, Workcell

HANDOVER = 3
"""Way points by which a gap is extended into the feasible parts on both sides."""
GUARD = 1
"""Way points beside a gripper event that belong to the skill: no gap begins or ends there."""
LAST_RESORT = 1000.0
"""Extra cost of a leg that breaks this rule: it is used only where no other route is left."""
TASKS_PER_CALL = 16
"""Tasks that are labelled in one call."""
GAP_COST, WAY_COST = 10.0, 5.0
"""Costs of a gap and of a radian between its ends, in infeasible way points."""


@dataclass(frozen=True)
class Leg:
    """One unit segment between two candidates."""

    q: np.ndarray
    """`[point, joint]` joint path along the skill [rad or m]: first on the branch of the start,
    then on that of the end."""
    feasible: np.ndarray
    """`[point]` True where the arm can follow the skill."""
    first: int
    """Point at which the gap begins: the joint agent takes over here."""
    last: int
    """Point at which the gap ends; equal to `first` where there is none."""
    name: tuple[int, int, int]
    """Segment, candidate of its first key pose, candidate of its last."""

    @property
    def has_gap(self) -> bool:
        """Must a part of the leg be bridged?"""
        return self.last > self.first


def _leading(ok) -> np.ndarray:
    """Number of feasible points before the first infeasible one, along the last axis."""
    # the infeasible point that is appended stops `argmin` where all the others are feasible
    return np.argmin(np.append(ok, np.zeros_like(ok[..., :1]), axis=-1), axis=-1)


class Routes:
    """All legs of one task and their costs.

    Arrays over legs are `[segment, from, to]`: the candidates at the segment's first and last key
    pose.
    """

    def __init__(self, labels: Labels, events: np.ndarray, config: PathIkConfig):
        """Compute the costs of all legs.

        Args:
            labels: labels of one task, on the host.
            events: `[key pose]` True where the gripper moves.
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
        """Change from the forward to the backward path where they are nearest.

        This needs a stretch on which both are feasible. A leg counts as joined, without a gap, if
        no joint jumps by more than `max_jump` [rad or m] there.
        """
        forward, backward = self.labels.ahead[:, :, None], self.labels.back[:, None]
        jump = np.abs(forward[..., :-1, :] - backward[..., 1:, :]).max(axis=-1)
        point = np.arange(jump.shape[-1])
        joinable = (point <= self.first[..., None]) & (point + 1 >= self.last[..., None])
        jump = np.where(joinable, jump, np.inf)
        change_point, has_overlap = np.argmin(jump, axis=-1), joinable.any(axis=-1)
        self.joined = np.min(jump, axis=-1) <= max_jump
        self.first = np.where(has_overlap, change_point, self.first)
        self.last = np.where(has_overlap, change_point + 1, self.last)

    def _costs(self) -> np.ndarray:
        """Costs `[segment, from, to]`; infinite where a leg must not be used."""
        labels, points, events = self.labels, self.labels.ahead.shape[2], self.events
        index = np.ix_(*map(np.arange, self.first.shape))
        # where a path has no feasible point, `first` is -1 or `last` is `points`: no index
        begin, end = np.maximum(self.first, 0), np.minimum(self.last, points - 1)
        leave = labels.ahead[index[0], index[1], begin]
        resume = labels.back[index[0], index[2], end]
        way_cost = WAY_COST * np.abs(leave - resume).max(axis=-1)
        cost = np.where(self.joined, way_cost, GAP_COST + (end - begin) + way_cost)
        start_guard = np.where(events[:-1], GUARD, 0)[:, None, None]
        end_guard = points - 1 - np.where(events[1:], GUARD, 0)[:, None, None]
        guarded = (self.first >= start_guard) & (self.last <= end_guard)
        cost = np.where(guarded | self.joined, cost, cost + LAST_RESORT)
        possible = (self.first >= 0) & (self.last <= points - 1)
        cost = np.where(possible, cost, np.inf)
        carried_on = np.eye(cost.shape[1], dtype=bool) & labels.kept[:, :, None]
        cost = np.where(carried_on, 0.0, cost)
        self.joined = self.joined | carried_on
        usable = labels.usable[:-1, :, None] & labels.usable[1:, None]
        return np.where(usable, cost, np.inf)

    def cheapest(self) -> list[tuple[int, int, int]] | None:
        """Names of the legs of the cheapest route, in order; None where there is none."""
        value, predecessors = np.where(self.labels.usable[0], 0.0, np.inf), []
        for cost in self.cost:
            total = value[:, None] + cost
            predecessors.append(np.argmin(total, axis=0))
            value = np.min(total, axis=0)
        candidate = int(np.argmin(value))
        if not np.isfinite(value[candidate]):
            return None
        names = []
        for segment in range(len(self.cost) - 1, -1, -1):
            predecessor = int(predecessors[segment][candidate])
            names.append((segment, predecessor, candidate))
            candidate = predecessor
        return names[::-1]

    def _least(self) -> list[float]:
        """Cost of the cheapest route to any candidate of each key pose; inf if there is none."""
        value = np.where(self.labels.usable[0], 0.0, np.inf)
        least_costs = [float(value.min())]
        for cost in self.cost:
            value = np.min(value[:, None] + cost, axis=0)
            least_costs.append(float(value.min()))
        return least_costs

    def least_cost(self) -> float:
        """Cost of the cheapest route, in infeasible way points; inf if there is none."""
        return self._least()[-1]

    def blocked_segment(self) -> int:
        """First unit segment that no route crosses; the number of segments if there is none."""
        finite = np.isfinite(self._least())
        return len(self.cost) if finite.all() else max(0, int(np.argmin(finite)) - 1)

    def leg(self, name: tuple[int, int, int]) -> Leg:
        """The leg with a name (see `Leg.name`)."""
        segment, start, end = name
        labels, points = self.labels, self.labels.ahead.shape[2]
        forward, backward = labels.ahead[segment, start], labels.back[segment, end]
        if start == end and labels.kept[segment, start]:
            return Leg(np.asarray(forward), np.ones(points, bool), 0, 0, name)
        first, last = int(self.first[name]), int(self.last[name])
        q = np.concatenate([forward[: first + 1], backward[first + 1 :]])
        if self.joined[name]:
            return Leg(q, np.ones(points, bool), 0, 0, name)
        index = np.arange(points)
        feasible = (index <= first) | (index >= last)
        # the hand-over moves into the feasible parts, but not beside a gripper event
        start_guard, end_guard = (GUARD * int(self.events[segment + k]) for k in (0, 1))
        gap_first = max(min(start_guard, first), first - HANDOVER)
        gap_last = min(max(points - 1 - end_guard, last), last + HANDOVER)
        return Leg(q, feasible, gap_first, gap_last, name)

    def forbid(self, name: tuple[int, int, int]) -> None:
        """Exclude the leg with a name from all further routes."""
        self.cost[name] = np.inf


def gripper_events(task: Task) -> np.ndarray:
    """`[key pose]` True where the gripper closes or opens."""
    held = np.array([False, *task.carrying, False])
    return held[1:] != held[:-1]


def _without_steps(labels: Labels) -> Labels:
    """Labels in which no path leaves the key pose at which it begins."""
    forward_ok, backward_ok = labels.ahead_ok.copy(), labels.back_ok.copy()
    forward_ok[..., -1] = backward_ok[..., :-1] = False
    return labels.replace(ahead_ok=forward_ok, back_ok=backward_ok, kept=np.zeros_like(labels.kept))


def label_paths(
    cell: Workcell,
    tasks: list[Task],
    scenes: list[Scene],
    poses: list[np.ndarray],
    scale: float,
    key: jax.Array,
    config: PathIkConfig,
    direct: bool = False,
) -> list[Routes]:
    """Label the skills' tool paths of several tasks.

    The tasks have the same number of key poses, and either all or none of them name the
    configuration to end in.

    Args:
        cell: robot and fixtures.
        tasks: what is to be done.
        scenes: for each task the scenes of its unit segments, leaves `[segment, ...]`.
        poses: for each task the tool poses `[segment, point, 8]`, unit dual quaternions.
        scale: manipulability that counts as 1.
        key: draws the seeds of inverse kinematics; consumed.
        config: thresholds.
        direct: whether every segment is a gap from key pose to key pose, see `lfd.without_skills`.

    Returns:
        The legs of each task.
    """
    routes = []
    for first in range(0, len(tasks), TASKS_PER_CALL):
        index = range(first, min(first + TASKS_PER_CALL, len(tasks)))
        batch = jax.tree.map(lambda *a: np.stack(a), *[scenes[i] for i in index])
        starts, any_end = np.stack([tasks[i].start for i in index]), tasks[index[0]].end is None
        ends = None if any_end else np.stack([np.asarray(tasks[i].end) for i in index])
        batch_poses = np.stack([poses[i] for i in index])
        labels = label_tasks(cell, batch, batch_poses, starts, ends, scale, key, index, config)
        join_config = config
        if direct:  # every segment is a gap, also where one small step would join its ends
            labels, join_config = _without_steps(labels), replace(config, max_jump=0.0)
        for row, number in enumerate(index):
            task_labels = jax.tree.map(lambda a, row=row: a[row], labels)
            routes.append(Routes(task_labels, gripper_events(tasks[number]), join_config))
    return routes
