# SPDX-License-Identifier: MIT
"""What a borrowed accelerator shows in eight minutes: one row after the other, as it is measured.

    python -m benchmarks.accelerator --json FILE

Nothing here is of one device. A row is printed and written at once, so that a time limit loses only
those that were not reached: the quick ones come first. The planner is untrained; its programs are
those of a trained one.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import tyro

from benchmarks.report import metric, rate, write
from hybrid_jax.agents import joint, training
from hybrid_jax.contracts import Segments
from hybrid_jax.envs.segments import free_pairs
from hybrid_jax.feasibility.building import build_feasibility_map
from hybrid_jax.kernels.collision.clearance import clearance
from hybrid_jax.planner.pipeline import plan_batch
from hybrid_jax.runs.presets import DEFAULT, SMOKE
from hybrid_jax.runs.seeds import LATENCY
from hybrid_jax.runs.warm_up import blank_planner
from hybrid_jax.runtime.devices import use_all_cores
from hybrid_jax.runtime.provenance import write_figures
from hybrid_jax.tasks.registry import random_task
from hybrid_jax.workcell.load import load_workcell

MINUTES = 8.0
"""Time after which no further row is begun [min]."""


def clearances(cell, tiny: bool) -> Iterator[dict]:
    """Rate of exact clearances in one call."""
    count = 512 if tiny else 65536
    low, high = np.asarray(cell.joint_limits).T
    q = np.random.default_rng(0).uniform(low, high, (count, len(low))).astype(np.float32)
    measure = jax.jit(jax.vmap(clearance, (None, 0)))
    per_second, first = rate(lambda: measure(cell, q), count)
    note = f"{count} configurations a call; the first call took {first:.1f} s"
    yield metric("accelerator.clearances", per_second, "1/s", "higher", note)


def plans(cell, tiny: bool) -> Iterator[dict]:
    """Seconds of the first plan, and plans a second of batches."""
    planner, count = blank_planner(cell, SMOKE if tiny else DEFAULT), 2 if tiny else 64
    tasks = [random_task(cell, seed) for seed in LATENCY[: 3 * count]]
    began = time.perf_counter()
    plan_batch(planner, tasks[:1], key=jax.random.key(0))
    took = time.perf_counter() - began
    yield metric("accelerator.first_plan", took, "s", "lower", "nothing kept, unless by the caller")
    plan_batch(planner, tasks[:count], key=jax.random.key(0))  # compiles
    began = time.perf_counter()
    results = plan_batch(planner, tasks[count : 2 * count], key=jax.random.key(1))
    per_second = count / (time.perf_counter() - began)
    solved = sum(result.status.name == "OK" for result in results)
    note = f"batch of {count}, {solved} planned; agents untrained"
    yield metric("accelerator.plans", per_second, "1/s", "higher", note)


def steps(cell, tiny: bool) -> Iterator[dict]:
    """Training steps of the joint agent a second, updates included."""
    config = (SMOKE if tiny else DEFAULT).joint
    scenes = jax.tree.map(lambda a: np.asarray(a)[None], cell.scene)
    ends = np.asarray(cell.home)[None]
    pairs = free_pairs(cell, Segments(scenes, ends, ends), 64 if tiny else 1024)
    settings = config.training
    few = replace(settings, steps=4 * settings.envs * settings.unroll)
    rates: list[float] = []
    training.train(
        joint.make_env(cell, pairs, config),
        joint.make_net(cell, config),
        few,
        report=lambda _, __, values: rates.append(float(np.mean(values["rate"]))),
    )
    note = f"{settings.envs} environments, the best of {len(rates)} updates"
    yield metric("accelerator.training_steps", max(rates), "1/s", "higher", note)


def map_poses(cell, tiny: bool) -> Iterator[dict]:
    """Poses of a feasibility map a second, compiled."""
    config = (SMOKE if tiny else DEFAULT).map
    seconds = []
    for seed in (0, 1):
        began = time.perf_counter()
        build_feasibility_map(cell, config, seed=seed)
        seconds.append(time.perf_counter() - began)
    note = f"{config.size:,} poses; the first map took {seconds[0]:.1f} s"
    yield metric("accelerator.map_poses", config.size / seconds[1], "1/s", "higher", note)


def main(json: Path | None = None, minutes: float = MINUTES, tiny: bool = False) -> None:
    """Measure what the time allows.

    Args:
        json: file to write the figures to, anew after each row.
        minutes: time after which no further row is begun.
        tiny: as little of everything as shows that it runs.
    """
    use_all_cores()
    cell, rows, began = load_workcell("gen3_handling"), [], time.perf_counter()
    parts: list[Callable] = [clearances, plans, map_poses, steps]
    for part in parts:
        if time.perf_counter() - began > 60 * minutes:
            break
        for row in part(cell, tiny):
            rows.append(row)
            print(f"{row['key']} {row['value']:.4g} {row['unit']}", flush=True)
            if json:
                write_figures(json, rows, {"LATENCY": LATENCY})
    write(rows, None)


if __name__ == "__main__":
    tyro.cli(main)
