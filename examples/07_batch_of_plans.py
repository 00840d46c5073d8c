# SPDX-License-Identifier: MIT
"""Many plans at once: a batch goes through every stage in a few compiled programs.

python examples/07_batch_of_plans.py runs/gen3_handling-001
"""

import sys
import time
from collections import Counter

import jax

import hybrid_jax as hj


def main(folder: str, count: int = 8) -> None:
    """Plan the same object in several scenes, twice: the first batch compiles."""
    hj.use_all_cores()
    run = hj.open_run(folder)
    planner = hj.load_planner(run)
    scenes = [hj.sample_scene(run.cell, seed) for seed in range(count)]
    tasks = [hj.make_task(run.cell, "bolt_1", scene) for scene in scenes]
    for attempt in ("first", "second"):
        began = time.perf_counter()
        plans = hj.plan_batch(planner, tasks, key=jax.random.key(0))
        seconds = time.perf_counter() - began
        states = Counter(plan.status.name for plan in plans)
        print(f"{attempt} batch: {dict(states)} in {seconds:.1f} s")
    for plan in plans:
        if plan.status is not hj.Status.OK:
            print(f"  {plan.status.name}: {plan.detail}")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "runs/gen3_handling-001")
