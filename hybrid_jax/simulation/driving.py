# SPDX-License-Identifier: MIT
"""Serve many controlled plants at once: physics for all that ask, then plans for all that wait."""

import time
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np

from hybrid_jax.errors import InputError
from hybrid_jax.planner.records import PlanResult
from hybrid_jax.simulation.plant import Plan, Planned, Roll, Rolled, Steps
from hybrid_jax.skills.task import Task

Planning = Callable[[Sequence[Task]], list[PlanResult]]
"""Plans for many tasks at once."""


class Engine(Protocol):
    """What rolls states on; see `engines`."""

    def roll(self, models, states, commands) -> tuple[np.ndarray, np.ndarray]: ...


def drive(
    runs: Sequence[Steps],
    engine: Engine,
    plan: Planning | None = None,
    progress: Callable[[int, float], None] = lambda ended, seconds: None,
) -> list[Any]:
    """Carry on all runs to their ends.

    Plans are made when nobody asks for physics any more, so that a planner gets large batches.

    Args:
        runs: generators of wishes.
        engine: for physics.
        plan: for plans; may be left out if nobody asks for one.
        progress: is told how many runs have ended, and the simulated time of all.

    Returns:
        What each run returned.
    """
    answers: dict[int, Any] = dict.fromkeys(range(len(runs)))
    results: list[Any] = [None] * len(runs)
    wishes: dict[int, Roll | Plan] = {}
    simulated = 0.0
    while answers or wishes:
        for number, answer in answers.items():
            try:
                wishes[number] = runs[number].send(answer)
            except StopIteration as end:
                results[number] = end.value
        rolls = {n: w for n, w in wishes.items() if isinstance(w, Roll)}
        if rolls:
            answers = _roll(engine, rolls)
            simulated += sum(len(w.commands) * w.plant.dt for w in rolls.values())
        else:
            answers = _plan(plan, wishes)
        for number in answers:
            del wishes[number]
        progress(len(runs) - len(wishes) - len(answers), simulated)
    return results


def _roll(engine: Engine, wishes: dict[int, Roll]) -> dict[int, Rolled]:
    asked = list(wishes.values())
    states, touching = engine.roll(
        [wish.plant.model for wish in asked],
        np.stack([wish.plant.state for wish in asked]),
        np.stack([wish.commands for wish in asked]),
    )
    return {n: Rolled(s, t) for n, s, t in zip(wishes, states, touching, strict=True)}


def _plan(plan: Planning | None, wishes: dict[int, Plan]) -> dict[int, Planned]:
    if not wishes:
        return {}
    if plan is None:
        raise InputError("a run asks for a plan, and there is no planner")
    began = time.perf_counter()
    results = plan([wish.task for wish in wishes.values()])
    each = (time.perf_counter() - began) / len(wishes)
    return {n: Planned(result, each) for n, result in zip(wishes, results, strict=True)}
