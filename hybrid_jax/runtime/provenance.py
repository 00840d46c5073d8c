# SPDX-License-Identifier: MIT
"""Figures with their provenance: command, commit, machine, versions, seeds."""

import json
import os
import platform
import re
import subprocess
import sys
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path

from hybrid_jax.runtime.devices import usable_cores

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = "jax", "mujoco", "mujoco-mjx", "numpy", "scipy"
"""Packages whose versions are noted."""


def write_figures(path: Path, metrics: list[dict], seeds: Mapping[str, range]) -> None:
    """Write the metrics that the documents are rendered from, with their provenance.

    Args:
        path: JSON file.
        metrics: rows of key, value, unit, better, device, note.
        seeds: ranges of `hybrid_jax.runs.seeds` that were drawn from, by name.
    """
    drawn = {name: [interval.start, interval.stop] for name, interval in seeds.items()}
    values = provenance() | {"seeds": drawn, "metrics": metrics}
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(values, indent=1) + "\n")


def provenance() -> dict:
    """Command, commit, machine and versions that a figure was made with."""
    spec = sys.modules["__main__"].__spec__
    name = f"python -m {spec.name}" if spec else Path(sys.argv[0]).name
    return {
        "command": " ".join([name, *map(_shown, sys.argv[1:])]),
        "commit": commit(),
        "machine": f"{_processor()}, {usable_cores()} cores, {_memory()} GiB",
        "versions": {
            "python": platform.python_version(),
            **{package: version(package) for package in PACKAGES},
        },
    }


def _shown(argument: str) -> str:
    """An argument as it may stand in a document: without the folders of an absolute path."""
    option, equals, value = argument.rpartition("=")
    return option + equals + (Path(value).name if value.startswith("/") else value)


def commit() -> str:
    """Short hash of the checkout's commit, with `-dirty` where tracked files differ from it.

    Changes in `docs` do not count: documents are rendered from figures. `unknown` where the
    package is not part of a checkout of its own.
    """
    try:
        _git("ls-files", "--error-unmatch", str(Path(__file__).resolve()))
        commit = _git("rev-parse", "--short", "HEAD")
        changed = _git("status", "--porcelain", "--untracked-files=no", "--", ".", ":!docs")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return f"{commit}-dirty" if changed else commit


def _git(*arguments: str) -> str:
    process = subprocess.run(
        ["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return process.stdout.strip()


def _processor() -> str:
    cpuinfo = Path("/proc/cpuinfo")
    text = cpuinfo.read_text() if cpuinfo.is_file() else ""
    match = re.search(r"^model name\s*:\s*(.+)$", text, re.MULTILINE)
    return match[1].strip() if match else platform.processor() or platform.machine()


def _memory() -> int:
    return round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30)
