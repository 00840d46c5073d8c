# SPDX-License-Identifier: MIT
"""Serve many controllers at once: physics for all that ask, then plans for all that wait."""

import itertools
import time
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

from hybrid_jax.contracts import PhysicsEngine, Planning, PlanResult
from hybrid_jax.errors import InputError
from hybrid_jax.execution.plant import PhysicsAnswer, PhysicsRequest, PlanAnswer, PlanRequest, Steps
from hybrid_jax.runtime.keys import fold_in


def drive(
    runs: Sequence[Steps],
    engine: PhysicsEngine,
    plan: Planning | None = None,
    progress: Callable[[int, float], None] = lambda ended, seconds: None,
) -> list[Any]:
    """Serve all runs until they end.

    Plans are made when no run asks for physics any more, so that a planner gets large batches.

    Args:
        runs: generators of requests.
        engine: for physics.
        plan: for plans; may be left out if no run asks for one.
        progress: is called with the number of ended runs and the simulated time of all runs [s].

    Returns:
        What each run returned.

    Raises:
        InputError: a run asks for a plan, and there is no planner.
    """
    answers: dict[int, Any] = dict.fromkeys(range(len(runs)))
    results: list[Any] = [None] * len(runs)
    requests: dict[int, PhysicsRequest | PlanRequest] = {}
    simulated = 0.0
    while answers or requests:
        for number, answer in answers.items():
            try:
                requests[number] = runs[number].send(answer)
            except StopIteration as end:
                results[number] = end.value
        rolls = {n: w for n, w in requests.items() if isinstance(w, PhysicsRequest)}
        if rolls:
            answers = _roll(engine, rolls)
            simulated += sum(len(w.commands) * w.plant.dt for w in rolls.values())
        else:
            answers = _plan(plan, requests)
        for number in answers:
            del requests[number]
        progress(len(runs) - len(requests) - len(answers), simulated)
    return results


def _roll(engine: PhysicsEngine, requests: dict[int, PhysicsRequest]) -> dict[int, PhysicsAnswer]:
    batch = list(requests.values())
    states, touching = engine.roll(
        [request.plant.model for request in batch],
        np.stack([request.plant.state for request in batch]),
        np.stack([request.commands for request in batch]),
    )
    return {n: PhysicsAnswer(s, t) for n, s, t in zip(requests, states, touching, strict=True)}


def _plan(plan: Planning | None, requests: dict[int, PlanRequest]) -> dict[int, PlanAnswer]:
    if not requests:
        return {}
    if plan is None:
        raise InputError("a run asks for a plan, and there is no planner")
    start_time = time.perf_counter()
    results = plan([request.task for request in requests.values()])
    seconds = (time.perf_counter() - start_time) / len(requests)
    return {n: PlanAnswer(result, seconds) for n, result in zip(requests, results, strict=True)}


def planning(plan: Callable[..., list[PlanResult]], seed: int) -> Planning:
    """A planner in the form that the scheduler calls; every batch gets its own random key.

    Args:
        plan: maps tasks, and a random key given as `key=`, to plans.
        seed: of the keys.

    Returns:
        A function from tasks to plans.
    """
    key, numbers = jax.random.key(seed), itertools.count()
    return lambda tasks: plan(tasks, key=fold_in(key, next(numbers)))
