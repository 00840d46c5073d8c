# SPDX-License-Identifier: MIT
"""Train a cell: `python -m hybrid_jax.train [STAGE ...] [--workcell NAME] [--resume]`."""

import sys
import time
from pathlib import Path
from typing import Annotated

import tyro

from hybrid_jax.compilecache import enable_compile_cache
from hybrid_jax.errors import HybridJaxError, UnknownNameError


def main(
    stages: Annotated[tuple[str, ...], tyro.conf.Positional] = (),
    /,
    workcell: str = "",
    preset: str = "default",
    seed: int = 0,
    out: Path | None = None,
    skills: Path | None = None,
    resume: bool = False,
    quiet: bool = False,
) -> int:
    """Feasibility map, three agents, and a planned and executed demonstration.

    Args:
        stages: map lfd drl switch demo; all of them if none is named.
        workcell: name of a shipped cell, or an MJCF file; the handling cell if not given.
        preset: default, paper or smoke.
        seed: of everything random.
        out: folder of the run; runs/CELL-NNN if not given.
        skills: folder of demonstrations to plan with; the shipped ones if not given.
        resume: go on with the run in --out, or with the newest run of the cell.
        quiet: print the summary only.
    """
    enable_compile_cache()
    # JAX is imported only now: --help and a mistyped name answer at once
    from hybrid_jax import runfolder  # noqa: PLC0415
    from hybrid_jax.devices import use_all_cores  # noqa: PLC0415
    from hybrid_jax.stages import STAGE_FUNCTIONS  # noqa: PLC0415
    from hybrid_jax.workcell.assets import default_workcell  # noqa: PLC0415

    use_all_cores()
    workcell = workcell or default_workcell()
    for stage in stages:
        if stage not in runfolder.STAGES:
            raise UnknownNameError("stage", stage, runfolder.STAGES)
    run = (
        runfolder.open_run(out, workcell)
        if resume
        else runfolder.create_run(workcell, preset, seed, out, skills)
    )
    print(f"run folder: {run.folder}", flush=True)
    rows = []
    for stage in runfolder.STAGES:
        wanted = stage in stages if stages else not (resume and run.finished(stage))
        if not wanted:
            continue
        began = time.perf_counter()
        try:
            result = STAGE_FUNCTIONS[stage](run, quiet)
        except KeyboardInterrupt:
            print(
                f"\nstopped in stage {stage!r}; go on with: python -m hybrid_jax.train --resume "
                f"--out {run.folder}",
                flush=True,
            )
            return 130
        rows.append((stage, time.perf_counter() - began, result))
    print_summary(rows)
    return 0


def print_summary(rows: list[tuple[str, float, dict]]) -> None:
    """One line a stage."""
    print("\nstage    time [s]  result")
    for stage, seconds, result in rows:
        text = ", ".join(f"{k.replace('_', ' ')} {v}" for k, v in result.items())
        print(f"{stage:7s} {seconds:9.1f}  {text}")


def run_cli(function) -> None:
    """Call a command with the terminal's arguments; our errors are one sentence, exit code 2."""
    try:
        sys.exit(tyro.cli(function))
    except HybridJaxError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    run_cli(main)
