# SPDX-License-Identifier: MIT
"""What the switching agent trains on: both motions of the phases of random tasks."""

from collections.abc import Sequence
from dataclasses import replace

import jax
from jax import Array

from hybrid_jax.agents.switching import Combined
from hybrid_jax.kernels.edges import measure_in_scenes
from hybrid_jax.planner.checking import Engine
from hybrid_jax.planner.combining import combine
from hybrid_jax.planner.finishing import Draft, first_scenes, phase_paths
from hybrid_jax.planner.pipeline import Job, bridge_jobs, choose_route, prepare
from hybrid_jax.planner.records import Planner
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
    drafts = [draft for job in ready for draft in _drafts(planner, job)]
    if not drafts:
        return []
    measure = measure_in_scenes(planner.cell, first_scenes(drafts))
    paths = phase_paths(planner, drafts, measure)
    return [combine(planner.cell, path, planner.scale) for path in paths]


def _drafts(planner: Planner, job: Job) -> list[Draft]:
    """The phases of a job that have gaps, all of them bridged."""
    found = []
    for number, (low, high) in enumerate(job.task.phases):
        legs = job.legs[low:high]
        gaps = [leg.name for leg in legs if leg.has_gap]
        if gaps and (planner.bridge is None or all(name in job.ways for name in gaps)):
            found.append(Draft(job.task, job.scenes, number, legs, job.ways))
    return found
