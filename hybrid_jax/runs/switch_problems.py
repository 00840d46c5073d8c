# SPDX-License-Identifier: MIT
"""Training problems of the switching agent: both motions of the phases of tasks."""

from collections.abc import Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
from jax import Array

from hybrid_jax.contracts import Combined
from hybrid_jax.errors import InputError
from hybrid_jax.kernels.collision.motion_validation import measure_in_scenes
from hybrid_jax.planner.combined_path import combine
from hybrid_jax.planner.phase_scenes import inside
from hybrid_jax.planner.pipeline import Job, bridge_jobs, choose_route, prepare
from hybrid_jax.planner.records import Planner
from hybrid_jax.planner.trajectory_check import ConfigurationChecker
from hybrid_jax.planner.trajectory_generation import Draft, first_scenes, phase_paths
from hybrid_jax.runtime.terminal import remark
from hybrid_jax.tasks.task import Task


def switch_problems(planner: Planner, tasks: Sequence[Task], key: Array) -> Combined:
    """Problems of the switching agent: the phases of some tasks that have gaps, stacked.

    Where the joint agent bridges no gap at all, as one that was trained for seconds, the skills'
    motions stand in for its own; so they do where no phase has a gap. A line says so.

    Args:
        planner: with a joint agent.
        tasks: whose phases are looked for.
        key: random key.

    Returns:
        `[problem, ...]`: configurations `[problem, 2, STEPS, joint]` [rad].

    Raises:
        InputError: no task has a route along skills.
    """
    phases = combined_phases(planner, tasks, key)
    if not phases:
        remark(
            f"switch: the joint agent bridged no gap of {len(tasks)} tasks (train it for longer, "
            "unless skills alone suffice); their problems hold the skills' motions alone"
        )
        without = replace(planner, bridge=None)
        phases = combined_phases(without, tasks, key) or combined_phases(
            without, tasks, key, gaps_only=False
        )
    if not phases:
        raise InputError(f"none of {len(tasks)} random tasks has a route along skills")
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *phases)


def combined_phases(
    planner: Planner, tasks: Sequence[Task], key: Array, *, gaps_only: bool = True
) -> list[Combined]:
    """Combined trajectory (traj_comb) of every phase with a gap, on the best route of each task.

    Phases with a gap that the joint agent does not bridge are left out; without a joint agent,
    the skill's own motion stands in for both.

    Args:
        planner: its `bridge` may be None.
        tasks: whose phases are looked for.
        key: random key.
        gaps_only: whether phases without a gap are left out.

    Returns:
        One problem a phase, with configurations `[2, STEPS, joint]` [rad].
    """
    key_label, key_bridge = jax.random.split(key)
    config = replace(planner.config, path_ik=planner.config.first_look)
    # what the fallback bridges is no choice between skill and joint agent
    planner = replace(planner, config=config, fallback=None)
    checker = ConfigurationChecker(planner.cell, planner.config.check)
    _, jobs = prepare(planner, checker, tasks, key_label)
    for job in jobs.values():
        choose_route(planner, checker, job)
    ready = [job for job in jobs.values() if not job.done]
    if planner.bridge is not None:
        bridge_jobs(planner, ready, key_bridge)
    drafts = [draft for job in ready for draft in _drafts(planner, job, gaps_only)]
    if not drafts:
        return []
    cell, scenes = planner.cell, first_scenes(drafts)
    paths = phase_paths(planner, drafts, measure_in_scenes(cell, scenes))
    return [
        combine(inside(cell, scenes, i), path, planner.scale, planner.execute)
        for i, path in enumerate(paths)
    ]


def _drafts(planner: Planner, job: Job, gaps_only: bool) -> list[Draft]:
    """Drafts of the phases of a job, or of those that have gaps, all of them bridged."""
    drafts = []
    for number, (low, high) in enumerate(job.task.phases):
        legs = job.legs[low:high]
        gaps = [leg.name for leg in legs if leg.has_gap]
        if (gaps or not gaps_only) and (
            planner.bridge is None or all(name in job.ways for name in gaps)
        ):
            drafts.append(Draft(job.task, job.scenes, number, legs, job.ways))
    return drafts
