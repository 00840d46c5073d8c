# SPDX-License-Identifier: MIT
"""Compile ahead of need: `python -m hybrid_jax.warm`, so that no first plan waits for it."""

import time
from pathlib import Path

from hybrid_jax.errors import InputError
from hybrid_jax.runtime.terminal import answer, run_main


def main(
    workcell: str = "",
    run: Path | None = None,
    preset: str = "default",
    all: bool = False,
    quiet: bool = False,
    json: bool = False,
) -> int:
    """Make the programs that planning in a cell takes, and keep them for later processes.

    A cell of the same class finds them there too, see docs/tuning.md.

    Args:
        workcell: name of a shipped cell, or an MJCF or URDF file; the handling cell if not given.
        run: folder of a run, instead of a cell: its cell and its settings.
        preset: settings of the agents, where no run is given.
        all: all shipped cells.
        quiet: print the answer only.
        json: print the answer as JSON.
    """
    if bool(workcell) + bool(run) + all > 1:
        raise InputError("name a cell, --run DIR, or --all: one of them")
    from hybrid_jax.runtime.devices import use_all_cores

    use_all_cores()
    from hybrid_jax.runs.load_planner import load_planner
    from hybrid_jax.runs.presets import find_preset
    from hybrid_jax.runs.run_folder import open_run
    from hybrid_jax.runs.warm_up import blank_planner
    from hybrid_jax.workcell.assets import default_workcell, workcell_names
    from hybrid_jax.workcell.load import load_workcell

    if run:
        planners = [load_planner(open_run(run))]
    else:
        names = workcell_names() if all else [workcell or default_workcell()]
        planners = [blank_planner(load_workcell(name), find_preset(preset)) for name in names]
    rows = [warm(planner, quiet) for planner in planners]
    lines = [f"{r['cell']}: {r['traced']} programs made, {r['seconds']} s" for r in rows]
    answer("\n".join(lines), rows, json)
    return 0


def warm(planner, quiet: bool) -> dict:
    """Make or load the programs of a planner; returns a row of the answer."""
    from hybrid_jax.runs.warm_up import parts
    from hybrid_jax.runtime.kept_programs import traced
    from hybrid_jax.runtime.program_durations import being_made
    from hybrid_jax.runtime.progress import working

    began, before = time.perf_counter(), len(traced)
    named = parts(planner)
    for number, (name, make) in enumerate(named.items()):
        with working("warm", f"{number + 1}/{len(named)} {name}", quiet, being_made):
            make()
    seconds = round(time.perf_counter() - began, 1)
    return {"cell": planner.cell.source.name, "traced": len(traced) - before, "seconds": seconds}


if __name__ == "__main__":
    run_main(main)
