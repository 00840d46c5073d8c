# SPDX-License-Identifier: MIT
"""What the switching agent trains on: both motions of the phases of random tasks."""

from collections.abc import Sequence
from dataclasses import replace

import jax
from jax import Array

from hybrid_jax.agents.switching import Combined
from hybrid_jax.planner.checking import Engine
from hybrid_jax.planner.combining import PhasePath, combine
from hybrid_jax.planner.finishing import phase_path
from hybrid_jax.planner.pipeline import Job, bridge_jobs, choose_route, prepare
from hybrid_jax.planner.records import Planner
from hybrid_jax.planner.scenes import inside
from hybrid_jax.skills.task import Task


def combined_phases(planner: Planner, tasks: Sequence[Task], key: Array) -> list[Combined]:
    """traj_comb of every phase with a gap, on the best route of each task.

    Phases with a gap that the joint agent does not bridge are left out; without a joint agent,
    the skill's own motion stands in for both.
    """
    key_label, key_bridge = jax.random.split(key)
    planner = replace(planner, config=replace(planner.config, labels=planner.config.first_look))
    engine = Engine(planner.cell, planner.config.check)
    _, jobs = prepare(planner, engine, tasks, key_label)
    for job in jobs.values():
        choose_route(planner, engine, job)
    ready = [job for job in jobs.values() if not job.done]
    if planner.bridge is not None:
        bridge_jobs(planner, None, ready, key_bridge)
    found = []
    for job in ready:
        found += [combine(planner.cell, path, planner.scale) for path in _phases(planner, job)]
    return found


def _phases(planner: Planner, job: Job) -> list[PhasePath]:
    """The phases of a job that have gaps, all of them bridged."""
    found = []
    for low, high in job.task.phases:
        legs = job.legs[low:high]
        gaps = [leg.name for leg in legs if leg.has_gap]
        if gaps and (planner.bridge is None or all(name in job.ways for name in gaps)):
            cell = inside(planner.cell, job.scenes, low)
            found.append(phase_path(cell, legs, job.ways, planner))
    return found
