# SPDX-License-Identifier: MIT
"""Say what is wrong with a cell: `python -m hybrid_jax.check CELL [--tasks 10]`."""

from collections import Counter
from pathlib import Path

import tyro

from hybrid_jax.progress import working
from hybrid_jax.terminal import answer, run_main


def main(
    cell: tyro.conf.Positional[str],
    tasks: int = 0,
    skills: Path | None = None,
    tool: str = "",
    package_path: tuple[Path, ...] = (),
    quiet: bool = False,
    json: bool = False,
) -> int:
    """Look a cell over; ends with exit code 1 if something is wrong.

    Args:
        cell: name of a shipped cell, or an MJCF, URDF or MJB file.
        tasks: random tasks of the cell to plan as well, without any training (minutes: the
            planner is compiled first).
        skills: folder of demonstrations to plan with; the shipped ones if not given.
        tool: site or link that is the tool, where the model does not tell.
        package_path: folders that hold the ROS packages of a URDF's meshes.
        quiet: print the answer only.
        json: print the answer as JSON.
    """
    from hybrid_jax.workcell.assets import find_workcell  # noqa: PLC0415
    from hybrid_jax.workcell.diagnosis import WRONG, diagnose  # noqa: PLC0415
    from hybrid_jax.workcell.load import load_workcell  # noqa: PLC0415

    path = find_workcell(cell)
    with working("check", "looking the model over", quiet):
        found = diagnose(path, tool=tool, package_paths=package_path)
        last = []
        if all(finding.level != WRONG for finding in found):
            loaded = load_workcell(path, tool=tool, package_paths=package_path)
            wrong, last = look_at_home(loaded)
            found = [*wrong, *found]
        fit = all(finding.level != WRONG for finding in found)
    rows = [(finding.level, finding.text) for finding in found]
    if fit and tasks:
        fit, doubts, sentence = plan_tasks(loaded, tasks, skills, quiet)
        rows, last = rows + doubts, [*last, sentence]
    text = "\n".join([*(f"{level:9s} {line}" for level, line in rows), *last])
    findings = [{"level": level, "text": line} for level, line in rows]
    answer(text, {"fit": fit, "findings": findings, "summary": last}, json)
    return 0 if fit else 1


def look_at_home(cell) -> tuple[list, list[str]]:
    """What the kernels find wrong with a cell at home; what the package sees in it, in a line."""
    from hybrid_jax.kernels.collision import clearance  # noqa: PLC0415
    from hybrid_jax.kernels.distance import FAR  # noqa: PLC0415
    from hybrid_jax.workcell.diagnosis import DOUBTFUL, WRONG, Finding  # noqa: PLC0415

    gap, found = float(clearance(cell, cell.home)), []
    if gap < 0:
        text = (
            f"the home configuration collides: the kernels' primitives overlap by "
            f"{-1e3 * gap:.1f} mm, where C MuJoCo sees no contact; change the keyframe 'home', or "
            "make a geom smaller"
        )
        return [Finding(WRONG, text)], []
    if gap >= FAR / 2:
        found = [Finding(DOUBTFUL, "there is nothing in the cell that the arm could touch")]
        told = "nothing to touch"
    else:
        told = f"clearance at home {1e3 * gap:.0f} mm"
    line = (
        f"fit to plan in: {len(cell.joint_names)} joints, tool {_tool(cell)}, "
        f"{cell.robot.shapes.count} primitives of the robot, {cell.fixtures.count} of fixtures, "
        f"{cell.objects.count} of its {len(cell.source.layout.object_names)} objects; {told}"
    )
    return found, [line]


def _tool(cell) -> str:
    """The tool's site, and the body that it is on."""
    site = cell.model.site(cell.source.layout.tool_site)
    return f"{site.name!r} on {cell.model.body(int(site.bodyid[0])).name!r}"


def plan_tasks(
    cell, count: int, skills: Path | None, quiet: bool
) -> tuple[bool, list[tuple[str, str]], str]:
    """Plan random tasks with skills and RRT-Connect.

    Returns:
        Have all of them a plan? A finding for each that has none, and a sentence.
    """
    from dataclasses import replace  # noqa: PLC0415

    import jax  # noqa: PLC0415

    from hybrid_jax.planner.lfd import optimal_chooser  # noqa: PLC0415
    from hybrid_jax.planner.loading import optimal_switcher, read_library  # noqa: PLC0415
    from hybrid_jax.planner.pipeline import plan_batch  # noqa: PLC0415
    from hybrid_jax.planner.records import Planner  # noqa: PLC0415
    from hybrid_jax.presets import DEFAULT  # noqa: PLC0415
    from hybrid_jax.skills.tasks import random_task  # noqa: PLC0415
    from hybrid_jax.types import Status  # noqa: PLC0415
    from hybrid_jax.workcell.diagnosis import DOUBTFUL  # noqa: PLC0415

    # without a map nobody knows what manipulability is usual here
    labels = replace(DEFAULT.planner.labels, least_manipulability=0.0)
    config = replace(DEFAULT.planner, labels=labels, quick=None)
    switch = optimal_switcher(DEFAULT.switch)
    planner = Planner(cell, read_library(skills), optimal_chooser, None, switch, 1.0, config)
    some = [random_task(cell, seed) for seed in range(count)]
    with working("check", f"planning {count} tasks (a first time also compiles)", quiet):
        results = plan_batch(planner, some, key=jax.random.key(0))
    failed = [(task, r) for task, r in zip(some, results, strict=True) if r.status != Status.OK]
    doubts = [
        (DOUBTFUL, f"task of {task.object_name!r}: {result.status.name}: {result.detail}")
        for task, result in failed
    ]
    causes = Counter(result.status.name for _, result in failed)
    found = f"{count - len(failed)} of {count} random tasks have a plan"
    sentence = found + "".join(f"; {cause} {times}" for cause, times in causes.most_common())
    return not failed, doubts, sentence


if __name__ == "__main__":
    run_main(main)
