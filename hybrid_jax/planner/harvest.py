# SPDX-License-Identifier: MIT
"""Collect the infeasible segments that RL-LfD leaves on random tasks (Algorithm 1, lines 4-7).

They are what the joint agent trains on, and its only training data.
"""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from hybrid_jax.errors import SegmentError
from hybrid_jax.kernels.collision import clearance
from hybrid_jax.planner.labelling import Bridge, LabelConfig, bridges, end_branches
from hybrid_jax.planner.lfd import SkillChooser, phase_cell, skill_path, stack_scenes
from hybrid_jax.skills.library import SkillConfig, SkillLibrary
from hybrid_jax.skills.task import Task, random_task
from hybrid_jax.types import Scene, Workcell, pytree

HANDOVER = 4
"""Way points by which a bridge reaches into the feasible parts on both sides."""
BRANCHES = 8
"""End configurations considered for a phase."""


@pytree
class Segments:
    """Problems of the joint agent; the leading axis runs over segments."""

    scene: Scene
    start: Array
    """`[segment, joint]`."""
    goal: Array
    """`[segment, joint]`."""


def single_segment(scene: Scene, start, goal) -> Segments:
    """One problem, with the leading axis of many."""
    rows = jax.tree.map(lambda a: jnp.asarray(a)[None], (scene, start, goal))
    return Segments(*rows)


@jax.jit
def _end_gaps(cell: Workcell, segments: Segments) -> dict[str, Array]:
    """Clearance `[segment]` at both ends [m]."""
    inside = jax.vmap(lambda scene, q: clearance(cell.replace(scene=scene), q))
    return {end: inside(segments.scene, getattr(segments, end)) for end in ("start", "goal")}


def refuse_infeasible(cell: Workcell, segments: Segments, margin: float) -> None:
    """Raise if an end of a segment violates the joint limits or has less clearance than `margin`.

    Raises:
        SegmentError: names the segment, its end, and the joint or the clearance.
    """
    low, high = np.asarray(cell.joint_limits).T
    for end, gaps in jax.device_get(_end_gaps(cell, segments)).items():
        q = np.asarray(getattr(segments, end))
        # a finite difference within float32's rounding is no violation
        outside = ~((q >= low - 1e-5) & (q <= high + 1e-5))
        for i, joint in np.argwhere(outside)[:1]:
            raise SegmentError(
                f"segment {i}: joint {cell.joint_names[joint]!r} of its {end} is {q[i, joint]:.4g},"
                f" outside its limits {low[joint]:.4g} to {high[joint]:.4g}"
            )
        for i in np.flatnonzero(~(gaps >= margin))[:1]:
            raise SegmentError(
                f"segment {i}: the clearance of its {end} is {1000 * gaps[i]:.1f} mm, "
                f"less than the {1000 * margin:.1f} mm to be kept"
            )


@dataclass(frozen=True)
class PhaseOptions:
    """One phase of a task, ready for the joint agent."""

    cell: Workcell
    """In the scene of the phase."""
    poses: np.ndarray
    """`[n, 8]` the skill's tool path."""
    bridges: list[Bridge]
    """Ways through, best first; empty where a key pose is infeasible."""


def bridge_ends(bridge: Bridge) -> tuple[int, int]:
    """Points at which the joint agent takes over and hands back."""
    return max(0, bridge.first - HANDOVER), min(len(bridge.q) - 1, bridge.last + HANDOVER)


def phase_options(
    cell: Workcell,
    task: Task,
    phase: int,
    poses: np.ndarray,
    start: np.ndarray,
    scale: float,
    config: LabelConfig,
    key,
) -> PhaseOptions:
    """Ways through one phase from a configuration; the last phase ends at the cell's home."""
    low, high = task.phases[phase]
    carrying = task.carrying[low]
    placed = not carrying and any(task.carrying[:low])
    inside = phase_cell(cell, task, carrying, placed)
    last = high == len(task.carrying)
    if last:
        ends = np.asarray(cell.home)[None]
    else:
        found, free = end_branches(
            inside, jnp.asarray(poses[-1]), jnp.asarray(start), key=key, config=config
        )
        ends = np.asarray(found)[np.asarray(free)]
    if not len(ends):
        return PhaseOptions(inside, poses, [])
    ends = ends[np.argsort(np.abs(ends - start).max(axis=1))][:BRANCHES]
    ends = np.concatenate([ends, ends[-1:].repeat(BRANCHES - len(ends), 0)])
    return PhaseOptions(
        inside, poses, bridges(inside, poses, start, ends, scale, config, exact_end=last)
    )


def task_segments(
    cell: Workcell,
    library: SkillLibrary,
    task: Task,
    choose: SkillChooser,
    skills: SkillConfig,
    labels: LabelConfig,
    scale: float,
    key,
) -> list[Segments]:
    """Infeasible segments of one task, phase after phase on the best branch."""
    path = skill_path(library, task, choose, skills)
    found, start = [], np.asarray(cell.home)
    for phase, poses in enumerate(path.phases):
        options = phase_options(
            cell, task, phase, poses, start, scale, labels, jax.random.fold_in(key, phase)
        )
        if not options.bridges:
            break
        for bridge in options.bridges[:2]:
            if bridge.first != bridge.last:
                first, last = bridge_ends(bridge)
                found.append(Segments(options.cell.scene, bridge.q[first], bridge.q[last]))
        start = options.bridges[0].q[-1]
    return found


def harvest(
    cell: Workcell,
    library: SkillLibrary,
    choose: SkillChooser,
    skills: SkillConfig,
    labels: LabelConfig,
    scale: float,
    *,
    tasks: range,
    seed: int,
    progress: Callable[[int, int], None] | None = None,
) -> Segments:
    """Infeasible segments of random tasks.

    Args:
        tasks: seeds of the tasks; those used for training are never evaluated on.
        seed: draws the IK seeds.
        progress: called with (tasks done, tasks in all).

    Raises:
        ValueError: no task left an infeasible segment: there is nothing to train on.
    """
    found: list[Segments] = []
    for done, number in enumerate(tasks, 1):
        key = jax.random.fold_in(jax.random.key(seed), number)
        found += task_segments(
            cell, library, random_task(cell, number), choose, skills, labels, scale, key
        )
        if progress:
            progress(done, len(tasks))
    if not found:
        raise ValueError("no random task left an infeasible segment; the skills alone suffice")
    return Segments(
        stack_scenes([s.scene for s in found]),
        jnp.stack([s.start for s in found]),
        jnp.stack([s.goal for s in found]),
    )
