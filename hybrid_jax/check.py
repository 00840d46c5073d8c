# SPDX-License-Identifier: MIT
"""Say what is wrong with a cell: `python -m hybrid_jax.check CELL [--tasks 10]`."""

from collections import Counter
from pathlib import Path

import tyro

from hybrid_jax.runtime.progress import working
from hybrid_jax.runtime.terminal import answer, run_main


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
    from hybrid_jax.runtime.devices import use_all_cores
    from hybrid_jax.workcell.assets import find_workcell
    from hybrid_jax.workcell.diagnosis import diagnose
    from hybrid_jax.workcell.findings import WRONG
    from hybrid_jax.workcell.load import load_workcell

    use_all_cores()
    path = find_workcell(cell)
    with working("check", "looking the model over", quiet):
        diagnosis = diagnose(path, tool=tool, package_paths=package_path)
        sentences = []
        if all(finding.level != WRONG for finding in diagnosis):
            loaded = load_workcell(path, tool=tool, package_paths=package_path)
            home_findings, sentences = look_at_home(loaded)
            diagnosis = [*home_findings, *diagnosis]
        fit = all(finding.level != WRONG for finding in diagnosis)
    rows = [(finding.level, finding.text) for finding in diagnosis]
    if fit and tasks:
        fit, doubts, sentence = plan_tasks(loaded, tasks, skills, quiet)
        rows, sentences = rows + doubts, [*sentences, sentence]
    if not fit and any(finding.mended for finding in diagnosis):
        sentences = [*sentences, f"to mend it: python -m hybrid_jax.adopt {cell} --out FOLDER"]
    text = "\n".join([*(f"{level:9s} {line}" for level, line in rows), *sentences])
    findings = [{"level": level, "text": line} for level, line in rows]
    answer(text, {"fit": fit, "findings": findings, "summary": sentences}, json)
    return 0 if fit else 1


def look_at_home(cell) -> tuple[list, list[str]]:
    """Check a cell at home with the kernels.

    Returns:
        Findings, and a sentence about the contents of the cell; no sentence if it collides.
    """
    from hybrid_jax.kernels.collision.clearance import clearance
    from hybrid_jax.kernels.collision.distance import FAR
    from hybrid_jax.workcell.findings import DOUBTFUL, WRONG, Finding

    gap, findings = float(clearance(cell, cell.home)), []
    if gap < 0:
        text = (
            f"the home configuration collides: the kernels' primitives overlap by "
            f"{-1e3 * gap:.1f} mm, where C MuJoCo sees no contact; change the keyframe 'home', or "
            "make a geom smaller"
        )
        return [Finding(WRONG, text)], []
    if gap >= FAR / 2:
        findings = [Finding(DOUBTFUL, "there is nothing in the cell that the arm could touch")]
        note = "nothing to touch"
    else:
        note = f"clearance at home {1e3 * gap:.0f} mm"
    line = (
        f"fit to plan in: {len(cell.joint_names)} joints, tool {_tool(cell)}, "
        f"{cell.robot.shapes.used} primitives of the robot, {cell.fixtures.used} of fixtures, "
        f"{cell.objects.used} of its {len(cell.source.layout.object_names)} objects; {note}"
    )
    return findings, [line]


def _tool(cell) -> str:
    """Name of the tool's site, and of the body that it is on."""
    site = cell.model.site(cell.source.layout.tool_site)
    return f"{site.name!r} on {cell.model.body(int(site.bodyid[0])).name!r}"


def plan_tasks(
    cell, count: int, skills: Path | None, quiet: bool
) -> tuple[bool, list[tuple[str, str]], str]:
    """Plan random tasks with skills and RRT-Connect.

    Returns:
        Whether all of them have a plan, a finding for each that has none, and a sentence.
    """
    from dataclasses import replace

    import jax

    from hybrid_jax.planner.pipeline import plan_batch
    from hybrid_jax.runs.load_planner import untrained_planner
    from hybrid_jax.runs.presets import DEFAULT
    from hybrid_jax.runtime.program_durations import being_made
    from hybrid_jax.tasks.registry import random_task
    from hybrid_jax.types import Status
    from hybrid_jax.workcell.findings import DOUBTFUL

    # without a map nobody knows what manipulability is usual here
    path_ik = replace(DEFAULT.planner.path_ik, least_manipulability=0.0)
    config = replace(DEFAULT.planner, path_ik=path_ik, quick_path_ik=None)
    planner = untrained_planner(cell, 1.0, config, skills)
    problems = [random_task(cell, seed) for seed in range(count)]
    with working("check", f"planning {count} tasks", quiet, being_made):
        results = plan_batch(planner, problems, key=jax.random.key(0))
    failed = [(task, r) for task, r in zip(problems, results, strict=True) if r.status != Status.OK]
    doubts = [
        (DOUBTFUL, f"task of {task.object_name!r}: {result.status.name}: {result.detail}")
        for task, result in failed
    ]
    causes = Counter(result.status.name for _, result in failed)
    text = f"{count - len(failed)} of {count} random tasks have a plan"
    sentence = text + "".join(f"; {cause} {times}" for cause, times in causes.most_common())
    return not failed, doubts, sentence


if __name__ == "__main__":
    run_main(main)
