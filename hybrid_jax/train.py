# SPDX-License-Identifier: MIT
"""Train a cell: `python -m hybrid_jax.train [STAGE ...] [--workcell NAME] [--resume]`."""

import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import tyro

from hybrid_jax.errors import UnknownNameError
from hybrid_jax.terminal import STOPPED, answer, remark, run_main


def main(
    stages: Annotated[tuple[str, ...], tyro.conf.Positional] = (),
    /,
    workcell: str = "",
    preset: str = "default",
    seed: int = 0,
    out: Path | None = None,
    skills: Path | None = None,
    tool: str = "",
    package_path: tuple[Path, ...] = (),
    resume: bool = False,
    tensorboard: bool = False,
    quiet: bool = False,
    json: bool = False,
) -> int:
    """Feasibility map, three agents, and a planned and executed demonstration.

    Args:
        stages: map lfd drl switch demo; all of them if none is named.
        workcell: name of a shipped cell, or an MJCF or URDF file; the handling cell if not given.
        preset: default, paper or smoke.
        seed: of everything random.
        out: folder of the run; runs/CELL-NNN if not given.
        skills: folder of demonstrations to plan with; the shipped ones if not given.
        tool: site or link that is the tool, where the model does not tell.
        package_path: folders that hold the ROS packages of a URDF's meshes.
        resume: go on with the run in --out, or with the newest run of the cell.
        tensorboard: write the metrics for TensorBoard as well, into RUN/tensorboard.
        quiet: print the summary only.
        json: print the summary as JSON.
    """
    # JAX is imported only now: --help and a mistyped name answer at once
    from hybrid_jax import runfolder  # noqa: PLC0415
    from hybrid_jax.devices import use_all_cores  # noqa: PLC0415
    from hybrid_jax.workcell.assets import default_workcell  # noqa: PLC0415

    use_all_cores()
    workcell = workcell or default_workcell()
    for stage in stages:
        if stage not in runfolder.STAGES:
            raise UnknownNameError("stage", stage, runfolder.STAGES)
    run = (
        runfolder.open_run(out, workcell)
        if resume
        else runfolder.create_run(workcell, preset, seed, out, skills, tool, package_path)
    )
    if not quiet:
        remark(f"run folder: {run.folder}")
    if tensorboard:
        from hybrid_jax.tensorboard import board  # noqa: PLC0415

        run = replace(run, listener=board(run.path("tensorboard")))
    wanted = stages or [s for s in runfolder.STAGES if not (resume and run.finished(s))]
    rows = run_stages(run, [s for s in runfolder.STAGES if s in wanted], quiet)
    answer(summary(rows), {"run": str(run.folder), "stages": rows}, json)
    return STOPPED if rows and rows[-1].get("stopped") else 0


def run_stages(run, stages: list[str], quiet: bool) -> list[dict]:
    """Run stages in order; one row for each. Ctrl-C ends them with a row that says so."""
    rows = []
    for stage in stages:
        began = time.perf_counter()
        try:  # the run exists, and Ctrl-C may fall into this import: it takes half a second
            from hybrid_jax.stages import STAGE_FUNCTIONS  # noqa: PLC0415

            result = STAGE_FUNCTIONS[stage](run, quiet)
        except KeyboardInterrupt:
            remark(
                f"\nstopped in stage {stage!r}; go on with: python -m hybrid_jax.train --resume "
                f"--out {run.folder}"
            )
            result = {"stopped": True}
        rows.append({"stage": stage, "seconds": round(time.perf_counter() - began, 1), **result})
        if "stopped" in result:
            break
    return rows


def summary(rows: list[dict]) -> str:
    """One line a stage."""
    lines = ["stage    time [s]  result"]
    for row in rows:
        named = (f"{k.replace('_', ' ')} {v}" for k, v in row.items() if k not in _FIRST)
        lines.append(f"{row['stage']:7s} {row['seconds']:9.1f}  {', '.join(named)}")
    return "\n".join(lines)


_FIRST = ("stage", "seconds")

if __name__ == "__main__":
    run_main(main)
