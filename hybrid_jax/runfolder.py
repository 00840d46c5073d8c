# SPDX-License-Identifier: MIT
"""A run's folder: configuration, finished stages, checkpoints, metrics and pictures."""

import dataclasses
import json
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from hybrid_jax import artifacts
from hybrid_jax.errors import RunFolderError, UnknownNameError
from hybrid_jax.inputfiles import read_text
from hybrid_jax.presets import PRESETS, Preset
from hybrid_jax.types import Workcell
from hybrid_jax.workcell.load import load_workcell

_CONFIG = {
    "workcell": str, "digest": str, "preset": str, "seed": int, "skills": str | None, "tool": str,
    "package_paths": list,
}  # fmt: skip
"""Fields of `config.json` that are read, and of what type they are."""
STAGES = ("map", "lfd", "drl", "switch", "demo")
"""Stages of a run, in order."""


@dataclasses.dataclass(frozen=True)
class Run:
    """A run on one cell with one preset."""

    folder: Path
    cell: Workcell
    preset_name: str
    seed: int
    skills: Path | None = None
    """Folder of demonstrations; the shipped ones where None."""
    workcell: str = ""
    """Name or file that the cell was loaded by, ..."""
    tool: str = ""
    """... and its tool frame, ..."""
    package_paths: tuple[Path, ...] = ()
    """... and where its packages are; see `load_workcell`."""
    listener: Callable[[str, dict], None] | None = None
    """Told the stage and the values of every line of metrics."""

    @property
    def preset(self) -> Preset:
        """The configuration."""
        return PRESETS[self.preset_name]

    def path(self, name: str) -> Path:
        """A file of the run."""
        return self.folder / name

    def finished(self, stage: str) -> bool:
        """Has this stage left its result?"""
        return self.path("demo.json" if stage == "demo" else f"{stage}.npz").is_file()

    def save(self, name: str, kind: str, tree: Any, **header) -> None:
        """Write a pytree that belongs to this run's cell."""
        artifacts.save(self.path(name), kind, self.cell.source.digest, tree, **header)

    def load(self, name: str, kind: str) -> tuple[dict, dict]:
        """Read one back; RunFolderError if it is missing, damaged or of another cell."""
        return artifacts.load(self.path(name), kind, self.cell.source.digest)

    def log(self, stage: str, values: dict) -> None:
        """Append one line to the stage's metrics, and tell the listener."""
        with self.path(f"{stage}.jsonl").open("ab+") as file:
            if file.tell():
                file.seek(-1, os.SEEK_END)
            torn = file.read(1) not in (b"", b"\n")  # a full disk tore the last line
            file.write(b"\n" * torn + json.dumps(values).encode() + b"\n")
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
    """Make the folder of the next run; two that begin at the same moment get one each."""
    parent.mkdir(parents=True, exist_ok=True)
    while True:
        folder = _free_folder(parent, name)
        try:
            folder.mkdir()
            return folder
        except FileExistsError:  # somebody was quicker
            continue


def _free_folder(parent: Path, name: str) -> Path:
    taken = [
        int(p.name.rpartition("-")[2])
        for p in parent.glob(f"{name}-*")
        if p.name.rpartition("-")[2].isdigit()
    ]
    return parent / f"{name}-{max(taken, default=0) + 1:03d}"


def _latest_folder(parent: Path, name: str) -> Path:
    found = sorted(parent.glob(f"{name}-[0-9]*/config.json"))
    if not found:
        raise RunFolderError(f"nothing to resume: no run of {name!r} in {parent.resolve()}")
    return found[-1].parent


def create_run(
    workcell: str,
    preset: str,
    seed: int,
    out: Path | None,
    skills: Path | None = None,
    tool: str = "",
    package_paths: Sequence[Path] = (),
) -> Run:
    """Start a new run.

    Args:
        workcell: name or file of the cell.
        preset: name of the configuration.
        seed: of everything random.
        out: folder of the run; a new one in `runs` if None.
        skills: folder of demonstrations; the shipped ones if None.
        tool, package_paths: see `load_workcell`.

    Raises:
        UnknownNameError: no such preset or cell.
        RunFolderError: the folder already holds a run.
    """
    if preset not in PRESETS:
        raise UnknownNameError("preset", preset, PRESETS)
    cell = load_workcell(workcell, tool=tool, package_paths=package_paths)
    folder = out or _new_folder(Path("runs"), cell.source.name)
    folder.mkdir(parents=True, exist_ok=True)
    source = str(Path(workcell).resolve()) if Path(workcell).is_file() else workcell
    values = {
        "workcell": source,
        "digest": cell.source.digest,
        "preset": preset,
        "seed": seed,
        "skills": str(skills.resolve()) if skills else None,
        "tool": tool,
        "package_paths": [str(Path(folder).resolve()) for folder in package_paths],
        "configuration": dataclasses.asdict(PRESETS[preset]),
    }
    try:
        artifacts.write_new(folder / "config.json", json.dumps(values, indent=1))
    except FileExistsError:
        raise RunFolderError(
            f"{folder} already holds a run; add --resume to go on with it, or choose another --out"
        ) from None
    folders = tuple(Path(one).resolve() for one in package_paths)
    return Run(folder, cell, preset, seed, skills and skills.resolve(), source, tool, folders)


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
    skills = Path(values["skills"]) if values["skills"] else None
    return Run(
        folder, cell, values["preset"], values["seed"], skills, values["workcell"],
        values["tool"], tuple(map(Path, values["package_paths"])),
    )  # fmt: skip


def read_config(folder: Path) -> dict:
    """The settings of a run, `config.json`.

    Raises:
        RunFolderError: missing, damaged, or a field of another kind than it should be.
    """
    path = folder / "config.json"
    if not path.is_file():
        raise RunFolderError(f"{folder} is no run folder: {path.name} is missing")
    try:
        values = json.loads(read_text(path, RunFolderError))
        values = {"skills": None, "tool": "", "package_paths": []} | values
        wrong = [k for k, kind in _CONFIG.items() if not isinstance(values[k], kind)]
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise RunFolderError(f"{path} is damaged: {error!r}") from None
    if wrong:
        raise RunFolderError(f"{path} is damaged: {wrong[0]!r} is {values[wrong[0]]!r}")
    if values["preset"] not in PRESETS:
        raise UnknownNameError(f"preset in {path}", values["preset"], PRESETS)
    return values
