# SPDX-License-Identifier: MIT
"""A whole plan: skills where they lead, the joint agent where they do not, one checked trajectory.

python -m hybrid_jax.train            # once, a few minutes
python examples/06_whole_plan.py runs/gen3_handling-001
"""

import sys

import jax

import hybrid_jax as hj


def main(folder: str) -> None:
    """Plan one task of a trained run, and write it as files."""
    run = hj.open_run(folder)
    planner = hj.load_planner(run)
    task = hj.make_task(run.cell, "block_1", hj.sample_scene(run.cell, seed=7))
    plan = hj.plan_motion(planner, task, key=jax.random.key(0))
    print(f"{plan.status.name}: {plan.detail}")
    if not plan.phases:
        return
    for source, share in plan.shares.items():
        print(f"  {share:4.0%} of the points come from {source.name}")
    for number, (phase, held) in enumerate(zip(plan.phases, task.phases, strict=True)):
        print(f"  phase {number}: key pose {held[0]} to {held[1]} in {phase.times[-1]:.2f} s")
    hj.write_plan("block_1.csv", run.cell, task, plan)
    hj.write_plan("block_1.json", run.cell, task, plan)
    print("written to block_1.csv and block_1.json")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "runs/gen3_handling-001")
