# SPDX-License-Identifier: MIT
"""A run's folder: configuration, finished stages, checkpoints, metrics and pictures."""

import dataclasses
import json
import os
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from hybrid_jax.errors import InputError, RunFolderError, UnknownNameError
from hybrid_jax.runs.presets import PRESETS, Preset, find_preset
from hybrid_jax.runs.settings import as_values, from_values
from hybrid_jax.runtime import artifacts, output_files
from hybrid_jax.runtime.input_files import read_text
from hybrid_jax.types import Workcell
from hybrid_jax.workcell.load import load_workcell

_CONFIG = {
    "workcell": str,
    "digest": str,
    "preset": str,
    "seed": int,
    "skills": str | None,
    "tool": str,
    "package_paths": list,
    "configuration": dict,
}
"""Types of the fields of `config.json`."""
FORMAT = 5
"""Version of `config.json`. Version 1 had no names of record kinds; in 1 and 2 the last stage was
called `demo`. Up to 3 the fallback had sizes of its own."""
STAGES = ("map", "lfd", "drl", "switch", "showcase")
"""Stages of a run, in order."""


@dataclasses.dataclass(frozen=True)
class Run:
    """A run on one cell with one set of settings."""

    folder: Path
    cell: Workcell
    preset_name: str
    """Preset that its settings were made from."""
    seed: int
    skills: Path | None = None
    """Folder of demonstrations; the shipped ones where None."""
    workcell: str = ""
    """Name or file that the cell was loaded by."""
    tool: str = ""
    """Tool frame that the cell was loaded with; see `load_workcell`."""
    package_paths: tuple[Path, ...] = ()
    """Folders of ROS packages that the cell was loaded with; see `load_workcell`."""
    settings: Preset | None = None
    """Own settings; those of the named preset where None."""
    listener: Callable[[str, dict], None] | None = None
    """Called with the stage and the values of every line of metrics."""

    @property
    def preset(self) -> Preset:
        """The settings of all stages."""
        return self.settings or PRESETS[self.preset_name]

    def path(self, name: str) -> Path:
        """Path of a file of the run."""
        return self.folder / name

    def finished(self, stage: str) -> bool:
        """Has this stage left its result?"""
        return self.path("showcase.json" if stage == "showcase" else f"{stage}.npz").is_file()

    def save(self, name: str, kind: str, tree: Any, **header) -> None:
        """Write a pytree of arrays, marked with this run's cell."""
        artifacts.save(self.path(name), kind, self.cell.source.digest, tree, **header)

    def load(self, name: str, kind: str) -> tuple[dict, dict]:
        """Read a pytree back: its header, and its arrays as nested dictionaries.

        Raises:
            RunFolderError: missing, damaged or of another cell.
        """
        return artifacts.load(self.path(name), kind, self.cell.source.digest)

    def log(self, stage: str, values: dict) -> None:
        """Append one line to the stage's metrics, and tell the listener."""
        with self.path(f"{stage}.jsonl").open("ab+") as file:
            if file.tell():
                file.seek(-1, os.SEEK_END)
            if file.read(1) not in (b"", b"\n"):  # a full disk tore the last line
                file.write(b"\n")
            file.write(json.dumps(values).encode() + b"\n")
        if self.listener:
            self.listener(stage, values)

    def metrics(self, stage: str) -> list[dict]:
        """Metrics logged so far; the later of two lines for the same step counts.

        A line that a full disk or a power cut tore is left out.
        """
        path = self.path(f"{stage}.jsonl")
        if not path.is_file():
            return []
        rows = map(_metrics_of, path.read_text(errors="replace").splitlines())
        return list({row["step"]: row for row in rows if row}.values())


def _metrics_of(line: str) -> dict | None:
    try:
        row = json.loads(line)
    except (ValueError, RecursionError):
        return None
    sound = isinstance(row, dict) and isinstance(row.get("step"), int | float)
    return row if sound else None


def _new_folder(parent: Path, name: str) -> Path:
    """Make the folder of the next run; of two processes at the same moment each gets its own."""
    parent.mkdir(parents=True, exist_ok=True)
    while True:
        folder = _free_folder(parent, name)
        try:
            folder.mkdir()
            return folder
        except FileExistsError:  # another process was quicker
            continue


def _free_folder(parent: Path, name: str) -> Path:
    return parent / f"{name}-{max(_folders(parent, name), default=0) + 1:03d}"


def _folders(parent: Path, name: str) -> dict[int, Path]:
    """Folders of a cell's runs by their numbers; `NAME-2-001` is of another cell."""
    pattern = re.compile(re.escape(name) + r"-(\d+)")
    matches = [(pattern.fullmatch(path.name), path) for path in parent.glob("*")]
    return {int(match[1]): path for match, path in matches if match}


def _latest_folder(parent: Path, name: str) -> Path:
    runs = {n: p for n, p in _folders(parent, name).items() if (p / "config.json").is_file()}
    if not runs:
        raise RunFolderError(f"nothing to resume: no run of {name!r} in {parent.resolve()}")
    return runs[max(runs)]


def create_run(
    workcell: str,
    preset: str,
    seed: int,
    out: Path | None,
    skills: Path | None = None,
    tool: str = "",
    package_paths: Sequence[Path] = (),
    settings: Preset | None = None,
) -> Run:
    """Start a new run.

    Args:
        workcell: name or file of the cell.
        preset: name of the settings.
        seed: of everything random.
        out: folder of the run; a new one in `runs` if None.
        skills: folder of demonstrations; the shipped ones if None.
        tool, package_paths: see `load_workcell`.
        settings: own ones; those of the preset if None.

    Returns:
        The run with its cell.

    Raises:
        UnknownNameError: no such preset or cell.
        RunFolderError: the folder already holds a run.
    """
    named = find_preset(preset)
    settings = settings or named
    cell = load_workcell(workcell, tool=tool, package_paths=package_paths)
    folder = out or _new_folder(Path("runs"), cell.source.name)
    folder.mkdir(parents=True, exist_ok=True)
    values = {
        "format": FORMAT,
        "workcell": str(Path(workcell).resolve()) if Path(workcell).is_file() else workcell,
        "digest": cell.source.digest,
        "preset": preset,
        "seed": seed,
        "skills": str(skills.resolve()) if skills else None,
        "tool": tool,
        "package_paths": [str(Path(folder).resolve()) for folder in package_paths],
        "configuration": as_values(settings),
    }
    try:
        output_files.write_new(folder / "config.json", json.dumps(values, indent=1))
    except FileExistsError:
        raise RunFolderError(
            f"{folder} already holds a run; add --resume to go on with it, or choose another --out"
        ) from None
    return _run_of(folder, cell, values, settings)


def _run_of(folder: Path, cell: Workcell, values: dict, settings: Preset) -> Run:
    """The run whose `config.json` has these values."""
    return Run(
        folder=folder,
        cell=cell,
        preset_name=values["preset"],
        seed=values["seed"],
        skills=Path(values["skills"]) if values["skills"] else None,
        workcell=values["workcell"],
        tool=values["tool"],
        package_paths=tuple(map(Path, values["package_paths"])),
        settings=settings,
    )


def open_run(folder: Path | str | None, workcell: str = "") -> Run:
    """Open an existing run.

    Args:
        folder: of the run; the newest run of `workcell` in `runs` if None.
        workcell: name or file of the cell, where no folder is given.

    Returns:
        The run with its cell.

    Raises:
        RunFolderError: no run there, or its cell has changed since.
    """
    folder = Path(folder) if folder else _latest_folder(Path("runs"), Path(workcell).stem)
    values = read_config(folder)
    cell = load_workcell(
        values["workcell"], tool=values["tool"], package_paths=values["package_paths"]
    )
    if cell.source.digest != values["digest"]:
        raise RunFolderError(
            f"{folder}: the run was made for another version of cell {values['workcell']!r} "
            f"({values['digest'][:12]}, now {cell.source.digest[:12]}); start a new run"
        )
    try:
        settings = from_values(Preset, values["configuration"], "configuration")
    except InputError as error:
        raise RunFolderError(f"{folder / 'config.json'}: {error}") from None
    return _run_of(folder, cell, values, settings)


def read_config(folder: Path) -> dict:
    """Read and check `config.json` of a run.

    Raises:
        RunFolderError: missing, damaged, or a field of another kind than it should be.
    """
    path = folder / "config.json"
    if not path.is_file():
        raise RunFolderError(f"{folder} is no run folder: {path.name} is missing")
    try:
        values = json.loads(read_text(path, RunFolderError))
        if values.get("format") != FORMAT:
            raise RunFolderError(
                f"{path} is of format {values.get('format', 1)}, this version reads {FORMAT}: "
                "train the run anew"
            )
        mistyped = [k for k, kind in _CONFIG.items() if not isinstance(values[k], kind)]
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise RunFolderError(f"{path} is damaged: {error!r}") from None
    if mistyped:
        raise RunFolderError(f"{path} is damaged: {mistyped[0]!r} is {values[mistyped[0]]!r}")
    if values["preset"] not in PRESETS:
        raise UnknownNameError(f"preset in {path}", values["preset"], PRESETS)
    return values
