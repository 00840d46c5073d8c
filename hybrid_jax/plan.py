# SPDX-License-Identifier: MIT
"""Plan a task with a trained run: `python -m hybrid_jax.plan --run DIR --task FILE --out FILE`."""

from pathlib import Path

from hybrid_jax.runtime.terminal import answer, run_main


def main(
    run: Path, task: Path, out: Path, seed: int = 0, quiet: bool = False, json: bool = False
) -> int:
    """Plan a task and write its trajectory; ends with exit code 1 if there is no plan.

    Args:
        run: folder of a trained run.
        task: JSON with `object`, and `scene_seed` or `object_poses`.
        out: file to write; .json or .csv (ROS's JointTrajectory), or .ls (TP program, where
            the cell says that its controller runs them). Without a plan only .json is written.
        seed: of IK and rollouts.
        quiet: print the answer only.
        json: print the answer as JSON.
    """
    import jax

    from hybrid_jax.runtime.devices import use_all_cores
    from hybrid_jax.runtime.kept_programs import load_ahead

    use_all_cores()
    load_ahead(f"plan with the run {run.resolve()}")  # while all the rest is imported
    from hybrid_jax.export.files import refuse_ending, write_plan

    refuse_ending(out)
    from hybrid_jax.planner.pipeline import plan_motion
    from hybrid_jax.runs.load_planner import load_planner
    from hybrid_jax.runs.run_folder import open_run
    from hybrid_jax.runtime.progress import working
    from hybrid_jax.tasks.registry import read_task
    from hybrid_jax.types import Status

    opened = open_run(run)
    problem, planner = read_task(opened.cell, task), load_planner(opened)
    with working("plan", "planning (a first time also compiles)", quiet):
        result = plan_motion(planner, problem, key=jax.random.key(seed))
    write_plan(out, opened.cell, problem, result)
    seconds = round(sum(float(t.times[-1]) for t in result.phases), 3)
    values = {
        "status": result.status.name,
        "detail": result.detail,
        "skills": result.skills,
        "motion_seconds": seconds,
        "shares": {source.name: round(share, 3) for source, share in result.shares.items()},
        "file": str(out) if out.is_file() else None,
    }
    answer(f"{result.status.name}: {result.detail}", values, json)
    return 0 if result.status is Status.OK else 1


if __name__ == "__main__":
    run_main(main)
