# SPDX-License-Identifier: MIT
"""Plan a task with a trained run: `python -m hybrid_jax.plan --run DIR --task FILE --out FILE`."""

from pathlib import Path

from hybrid_jax.errors import InputError
from hybrid_jax.runtime.terminal import answer, run_main


def main(
    task: Path,
    out: Path,
    run: Path | None = None,
    server: str = "",
    seed: int = 0,
    quiet: bool = False,
    json: bool = False,
) -> int:
    """Plan a task and write its trajectory; ends with exit code 1 if there is no plan.

    Args:
        task: JSON with `object`, and `scene_seed` or `object_poses`.
        out: file to write; .json or .csv (ROS's JointTrajectory), or .ls (TP program, where
            the cell says that its controller runs them). Without a plan only .json is written.
        run: folder of a trained run.
        server: address of a `hybrid_jax.serve` that plans instead, such as http://127.0.0.1:8321.
        seed: of IK and rollouts.
        quiet: print the answer only.
        json: print the answer as JSON.
    """
    if (run is None) == (not server):
        raise InputError("name either the folder of a run, --run DIR, or a server, --server URL")
    if run is None:
        values = by_server(server, task, out, seed)
    else:
        values = plan_with_run(run, task, out, seed, quiet)
    values["file"] = str(out) if out.is_file() else None
    answer(f"{values['status']}: {values['detail']}", values, json)
    return 0 if values["status"] == "OK" else 1


def by_server(server: str, task: Path, out: Path, seed: int) -> dict:
    """Let a server plan, and write its answer; returns what is printed."""
    from hybrid_jax.runtime.output_files import write_text
    from hybrid_jax.serve.client import ask_for_plan

    values = ask_for_plan(server, task, out.name, seed)
    text = values.pop("text")
    if text is not None:
        write_text(out, text)
    return values


def plan_with_run(run: Path, task: Path, out: Path, seed: int, quiet: bool) -> dict:
    """Load a run, plan and write the plan; returns what is printed."""
    import jax

    from hybrid_jax.runtime.devices import use_all_cores
    from hybrid_jax.runtime.kept_programs import load_ahead

    use_all_cores()
    load_ahead(f"plan with the run {run.resolve()}")  # while all the rest is imported
    from hybrid_jax.export.files import plan_summary, refuse_ending, write_plan

    refuse_ending(out)
    from hybrid_jax.planner.pipeline import plan_motion
    from hybrid_jax.runs.load_planner import load_planner
    from hybrid_jax.runs.run_folder import open_run
    from hybrid_jax.runtime.program_durations import being_made
    from hybrid_jax.runtime.progress import working
    from hybrid_jax.tasks.registry import read_task

    opened = open_run(run)
    problem, planner = read_task(opened.cell, task), load_planner(opened)
    with working("plan", "planning", quiet, being_made):
        result = plan_motion(planner, problem, key=jax.random.key(seed))
    write_plan(out, opened.cell, problem, result)
    return plan_summary(result)


if __name__ == "__main__":
    run_main(main)
