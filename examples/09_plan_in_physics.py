# SPDX-License-Identifier: MIT
"""A plan carried out in physics: servos follow it, fingers hold by friction, contacts are watched.

python examples/09_plan_in_physics.py runs/gen3_handling-001
"""

import sys

import jax

import hybrid_jax as hj


def main(folder: str) -> None:
    """Plan one task of a trained run, carry it out, and print what became of it."""
    run = hj.open_run(folder)
    task = hj.make_task(run.cell, "block_1", hj.sample_scene(run.cell, seed=7))
    plan = hj.plan_motion(hj.load_planner(run), task, key=jax.random.key(0))
    print(f"{plan.status.name}: {plan.detail}")
    if plan.status is not hj.Status.OK:
        return
    report = hj.execute(run.cell, task, plan)
    print(
        f"{report.ending.value} in {report.seconds:.1f} s; success: {report.success}; "
        f"it slipped by {1e3 * report.slip:.1f} mm"
    )
    for touch in report.touches:
        print(f"  {touch}")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "runs/gen3_handling-001")
