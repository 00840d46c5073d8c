# SPDX-License-Identifier: MIT
"""Train a cell: `python -m hybrid_jax.train [STAGE ...] [--workcell NAME] [--resume]`."""

import functools
import inspect
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import tyro

from hybrid_jax.errors import UnknownNameError
from hybrid_jax.runtime.terminal import STOPPED, answer, called_as, remark, run_cli


def main(
    stages: Annotated[tuple[str, ...], tyro.conf.Positional] = (),
    /,
    workcell: str = "",
    preset: str = "",
    config: Path | None = None,
    seed: int | None = None,
    out: Path | None = None,
    skills: Path | None = None,
    tool: str = "",
    package_path: tuple[Path, ...] = (),
    backend: Literal["", "fused", "mjx"] = "",
    physics: Literal["", "kinematic", "mjx"] = "",
    resume: bool = False,
    show_settings: bool = False,
    tensorboard: bool = False,
    quiet: bool = False,
    json: bool = False,
    settings: tyro.conf.Suppress[tuple[str, ...]] = (),
) -> int:
    """Feasibility map, three agents, and a showcase: a few tasks, carried out in physics.

    Every setting of the preset is an option too: `--joint.training.steps 500000`.

    Args:
        stages: map lfd drl switch showcase; all of them if none is named.
        workcell: name of a shipped cell, or an MJCF or URDF file; the handling cell if not given.
        preset: default, mjx, paper or smoke; default if not given.
        config: JSON file with settings that differ from the preset's, or a run's config.json.
        seed: of everything random; 0 if not given.
        out: folder of the run; runs/CELL-NNN if not given.
        skills: folder of demonstrations to plan with; the shipped ones if not given.
        tool: site or link that is the tool, where the model does not tell.
        package_path: folders that hold the ROS packages of a URDF's meshes.
        backend: what tells collisions, of the map, the agents and the final check: this package's
            kernels (fused) or MJX's functions; the preset's if not given.
        physics: where the joint agent's arm gets to and what the switching agent judges: what is
            planned (kinematic), or what the servos make of it (mjx); the preset's if not given.
        resume: go on with the run in --out, or with the newest run of the cell.
        show_settings: print all settings as a file for --config, and do nothing else.
        tensorboard: write the metrics for TensorBoard as well, into RUN/tensorboard.
        quiet: print the summary only.
        json: print the summary as JSON.
        settings: options of the command line that are settings of the preset.
    """
    # JAX is imported only now: --help and a mistyped name answer at once
    from hybrid_jax.runs import run_folder
    from hybrid_jax.runs.own_settings import Changes
    from hybrid_jax.runtime.devices import use_all_cores

    for stage in stages:
        if stage not in run_folder.STAGES:
            raise UnknownNameError("stage", stage, run_folder.STAGES)
    changes = Changes(config, backend or None, physics or None, settings)
    if show_settings:
        return print_settings(preset, changes, json)
    use_all_cores()
    request = RunRequest(workcell, preset, seed, out, skills, tool, package_path)
    run = (resumed_run if resume else new_run)(request, changes)
    if not quiet:
        remark(f"run folder: {run.folder}")
    if tensorboard:
        run = with_board(run)
    possible = run_folder.STAGES if run.cell.source.task else run_folder.STAGES[:1]
    if not stages and possible != run_folder.STAGES:
        remark(
            f"the cell {run.cell.source.name!r} has no task data: its map is made, and nothing can "
            f"be learned without tasks; write {run.cell.source.name}.toml beside its MJCF"
        )
    selected = stages or [s for s in possible if not (resume and run.finished(s))]
    rows = run_stages(run, [s for s in run_folder.STAGES if s in selected], quiet)
    answer(summary(rows), {"run": str(run.folder), "stages": rows}, json)
    return STOPPED if rows and rows[-1].get("stopped") else 0


def print_settings(preset: str, changes, json: bool) -> int:
    """Print all settings that a run would have; returns the exit code."""
    from hybrid_jax.runs import own_settings
    from hybrid_jax.runs.presets import find_preset

    effective = own_settings.changed(find_preset(preset or "default"), changes)
    answer(own_settings.as_file(effective), own_settings.as_values(effective), json)
    return 0


def with_board(run):
    """The run with a listener that writes its metrics for TensorBoard."""
    from hybrid_jax.reports.tensorboard import board

    return replace(run, listener=board(run.path("tensorboard")))


class RunRequest(NamedTuple):
    """What the command line says about a run; see `main`."""

    workcell: str
    preset: str
    seed: int | None
    out: Path | None
    skills: Path | None
    tool: str
    package_path: tuple[Path, ...]


def new_run(request: RunRequest, changes):
    """Create the run that is asked for, with the preset's settings as far as none are given."""
    from hybrid_jax.runs import own_settings, run_folder
    from hybrid_jax.runs.presets import find_preset
    from hybrid_jax.workcell.assets import default_workcell

    name = request.preset or "default"
    return run_folder.create_run(
        request.workcell or default_workcell(),
        name,
        request.seed or 0,
        request.out,
        request.skills,
        request.tool,
        request.package_path,
        own_settings.changed(find_preset(name), changes),
    )


def resumed_run(request: RunRequest, changes):
    """Open the run that is to go on; one with other settings than those asked for is refused."""
    from hybrid_jax.runs import own_settings, run_folder
    from hybrid_jax.runs.presets import find_preset
    from hybrid_jax.workcell.assets import default_workcell

    find_preset(request.preset or "default")
    run = run_folder.open_run(request.out, request.workcell or default_workcell())
    requested = {
        "preset_name": request.preset or None,
        "seed": request.seed,
        "skills": request.skills and request.skills.resolve(),
        "tool": request.tool or None,
        "package_paths": tuple(path.resolve() for path in request.package_path) or None,
    }
    own_settings.refuse_other_settings(run, requested, changes)
    return run


def split_settings(arguments: list[str]) -> tuple[list[str], tuple[str, ...]]:
    """Split a command line into arguments of `main` and settings of the preset.

    Values stand after their option, so they go where it went.
    """
    options = {name.replace("_", "-") for name in inspect.signature(main).parameters} | {"help"}
    own_arguments, settings, destination = [], [], None
    for argument in arguments:
        if argument.startswith("--"):
            name = argument[2:].partition("=")[0].replace("_", "-")
            destination = own_arguments if name in options or not _is_setting(name) else settings
        elif argument == "-h":
            destination = own_arguments
        (own_arguments if destination is None else destination).append(argument)
    return own_arguments, tuple(settings)


def _is_setting(name: str) -> bool:
    """Does an option name a setting? One with a dot is meant to, right or wrong."""
    if "." in name:
        return True
    from hybrid_jax.runs.presets import Preset

    return name.replace("-", "_") in Preset.__dataclass_fields__


def command(arguments: list[str] | None = None) -> int:
    """Call `main` with arguments of a terminal, those of this process if None."""
    own_arguments, settings = split_settings(sys.argv[1:] if arguments is None else arguments)
    return tyro.cli(
        functools.partial(main, settings=settings),
        args=own_arguments,
        prog=called_as(),
        config=(tyro.conf.FlagCreatePairsOff,),
    )


def run_stages(run, stages: list[str], quiet: bool) -> list[dict]:
    """Run stages in order, and return one summary row for each.

    Ctrl-C ends them; the last row then has the entry `stopped`.
    """
    rows = []
    for stage in stages:
        start = time.perf_counter()
        try:  # the run exists, and Ctrl-C may fall into this import: it takes half a second
            from hybrid_jax.runs.stages import STAGE_FUNCTIONS

            result = STAGE_FUNCTIONS[stage](run, quiet)
        except KeyboardInterrupt:
            remark(
                f"\nstopped in stage {stage!r}; go on with: python -m hybrid_jax.train --resume "
                f"--out {run.folder}"
            )
            result = {"stopped": True}
        rows.append({"stage": stage, "seconds": round(time.perf_counter() - start, 1), **result})
        if "stopped" in result:
            break
    return rows


def summary(rows: list[dict]) -> str:
    """Summary rows as text, one line a stage."""
    lines = ["stage     time [s]  result"]
    for row in rows:
        named = (f"{k.replace('_', ' ')} {v}" for k, v in row.items() if k not in _FIRST)
        lines.append(f"{row['stage']:8s} {row['seconds']:9.1f}  {', '.join(named)}")
    return "\n".join(lines)


_FIRST = ("stage", "seconds")

if __name__ == "__main__":
    run_cli(command)
