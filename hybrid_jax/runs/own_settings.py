# SPDX-License-Identifier: MIT
"""Settings that a user asks for: a preset, changed by a file and by options."""

import dataclasses
import json
from pathlib import Path
from typing import NamedTuple

import tyro

from hybrid_jax.errors import InputError, RunFolderError
from hybrid_jax.mjx.collision import Backend
from hybrid_jax.mjx.executed_motion import Physics
from hybrid_jax.runs.presets import Preset, judged_by
from hybrid_jax.runs.run_folder import Run
from hybrid_jax.runs.settings import as_values, differences, from_values, merged
from hybrid_jax.runtime.input_files import read_text


class Changes(NamedTuple):
    """What a user wants otherwise than in the preset; later fields overrule earlier ones."""

    file: Path | None = None
    """JSON with some or all settings, or a run's `config.json`."""
    backend: Backend | None = None
    """What tells collisions, see `presets.judged_by`."""
    physics: Physics | None = None
    """Where an arm gets to, see `presets.judged_by`."""
    options: tuple[str, ...] = ()
    """Of the command line, as `--joint.training.steps 500000`."""


def changed(preset: Preset, changes: Changes) -> Preset:
    """A preset with changes.

    Raises:
        InputError: a setting that does not exist or does not fit; the message names it.
    """
    file, backend, physics, options = changes
    if file:
        values = merged(as_values(preset), _read(file), str(file))
        preset = from_values(Preset, values, str(file))
    if backend or physics:
        preset = judged_by(preset, backend, physics)
    if not options:
        return preset
    style = tyro.conf.AvoidSubcommands, tyro.conf.FlagCreatePairsOff
    return tyro.cli(Preset, default=preset, args=options, prog="settings:", config=style)


def as_file(preset: Preset) -> str:
    """All settings as text that `changed` reads back."""
    return json.dumps(as_values(preset), indent=1)


def _read(file: Path) -> dict:
    try:
        values = json.loads(read_text(file, InputError))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{file}: {error}") from None
    is_run_config = isinstance(values, dict) and "configuration" in values
    return values["configuration"] if is_run_config else values


def refuse_other_settings(run: Run, asked: dict, changes: Changes) -> None:
    """Raise if a run is to be continued with other settings than its own.

    Args:
        run: that is continued.
        asked: requested values of the run's fields by name, None where there was no request.
        changes: of its preset.

    Raises:
        RunFolderError: something else was asked for; the message names it.
    """
    current = {field.name: getattr(run, field.name) for field in dataclasses.fields(run)}
    others = [(k, current[k], v) for k, v in asked.items() if v not in (None, current[k])]
    others += differences(run.preset, changed(run.preset, changes))
    for name, old, new in others[:1]:
        raise RunFolderError(
            f"{run.folder} was begun with {name} {old!r}, not {new!r}, and keeps its settings: "
            "leave that out to go on with it, or start a new run"
        )
