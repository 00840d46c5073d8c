# SPDX-License-Identifier: MIT
"""OMPL on many tasks: a process on each core, as its users spread a batch."""

import multiprocessing
import os
import time

import jax

from hybrid_jax.planner.records import PlannerConfig
from hybrid_jax.runtime.devices import usable_cores
from hybrid_jax.tasks.registry import random_task
from hybrid_jax.types import Status
from hybrid_jax.workcell.load import load_workcell

LONGEST = 1800.0
"""Nobody waits longer for another process [s]."""


def plans_per_second(workcell: str, warm: range, tasks: range) -> tuple[float, float]:
    """Plans per second of all cores together, and the share of tasks that are solved.

    Args:
        workcell: name of the cell.
        warm: seeds of tasks that each process compiles on, which is not timed.
        tasks: seeds of tasks that are spread over the processes.
    """
    cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else None
    count = usable_cores()
    context = multiprocessing.get_context("spawn")
    gate, answers = context.Barrier(count + 1), context.Queue()
    workers = [
        context.Process(
            target=_work,
            args=(workcell, warm, tasks[i::count], cores and cores[i], gate, answers),
            daemon=True,
        )
        for i in range(count)
    ]
    for worker in workers:
        worker.start()
    gate.wait(LONGEST)
    began = time.perf_counter()
    solved = sum(answers.get(timeout=LONGEST) for _ in workers)
    seconds = time.perf_counter() - began
    for worker in workers:
        worker.join()
    return len(tasks) / seconds, solved / len(tasks)


def _work(workcell: str, warm: range, tasks: range, core: int | None, gate, answers) -> None:
    """Plan some tasks on one core; answers with how many are solved."""
    if core is not None:
        os.sched_setaffinity(0, {core})
    from hybrid_jax.baselines.ompl_tasks import OmplTasks

    cell = load_workcell(workcell)
    ompl = OmplTasks(cell, PlannerConfig())

    def plan(numbers: range) -> int:
        results = [ompl.plan(random_task(cell, n), jax.random.key(n)) for n in numbers]
        return sum(result.status is Status.OK for result in results)

    try:
        plan(warm)
    except BaseException:
        gate.abort()  # whoever waits is told
        raise
    gate.wait(LONGEST)
    answers.put(plan(tasks))
