# SPDX-License-Identifier: MIT
"""Plan a task with a trained run: `python -m hybrid_jax.plan --run DIR --task FILE --out FILE`."""

from pathlib import Path

from hybrid_jax.compilecache import enable_compile_cache
from hybrid_jax.train import run_cli


def main(run: Path, task: Path, out: Path, seed: int = 0) -> int:
    """Plan a task and write its trajectory.

    Args:
        run: folder of a trained run.
        task: JSON with `object`, and `scene_seed` or `object_poses`.
        out: JSON file to write, in the layout of ROS's JointTrajectory.
        seed: of IK and rollouts.
    """
    enable_compile_cache()
    import jax  # noqa: PLC0415

    from hybrid_jax.export import to_joint_trajectory, write_json  # noqa: PLC0415
    from hybrid_jax.planner.loading import load_planner  # noqa: PLC0415
    from hybrid_jax.planner.pipeline import plan_motion  # noqa: PLC0415
    from hybrid_jax.runfolder import open_run  # noqa: PLC0415
    from hybrid_jax.skills.tasks import read_task  # noqa: PLC0415
    from hybrid_jax.types import Status  # noqa: PLC0415

    opened = open_run(run)
    wanted = read_task(opened.cell, task)
    result = plan_motion(load_planner(opened), wanted, key=jax.random.key(seed))
    write_json(out, to_joint_trajectory(opened.cell, wanted, result))
    print(f"{result.status.name}: {result.detail}")
    return 0 if result.status is Status.OK else 1


if __name__ == "__main__":
    run_cli(main)
