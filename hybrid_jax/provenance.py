# SPDX-License-Identifier: MIT
"""Figures with where they come from: command, commit, machine, versions, seeds."""

import json
import os
import platform
import re
import subprocess
import sys
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path

from hybrid_jax.devices import usable_cores

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = "jax", "mujoco", "mujoco-mjx", "numpy", "scipy"
"""Whose versions are noted."""


def write_figures(path: Path, metrics: list[dict], seeds: Mapping[str, range]) -> None:
    """Write what the documents are rendered from.

    Args:
        path: JSON file.
        metrics: rows of key, value, unit, better, device, note.
        seeds: ranges of `hybrid_jax.seeds` that were drawn from, by name.
    """
    drawn = {name: [some.start, some.stop] for name, some in seeds.items()}
    values = provenance() | {"seeds": drawn, "metrics": metrics}
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(values, indent=1) + "\n")


def provenance() -> dict:
    """What a figure was made by and on: command, commit, machine, versions."""
    spec = sys.modules["__main__"].__spec__
    name = f"python -m {spec.name}" if spec else Path(sys.argv[0]).name
    return {
        "command": " ".join([name, *map(_shown, sys.argv[1:])]),
        "commit": commit(),
        "machine": f"{_processor()}, {usable_cores()} cores, {_memory()} GiB",
        "versions": {"python": platform.python_version(), **{
            package: version(package) for package in PACKAGES
        }},
    }  # fmt: skip


def _shown(argument: str) -> str:
    """An argument as it may stand in a document: no path of a machine."""
    option, equals, value = argument.rpartition("=")
    return option + equals + (Path(value).name if value.startswith("/") else value)


def commit() -> str:
    """Of the checkout; marked where its files differ, but for the documents that are rendered.

    `unknown` where the package is not part of a checkout of its own.
    """
    try:
        _git("ls-files", "--error-unmatch", str(Path(__file__).resolve()))
        commit = _git("rev-parse", "--short", "HEAD")
        changed = _git("status", "--porcelain", "--untracked-files=no", "--", ".", ":!docs")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return f"{commit}-dirty" if changed else commit


def _git(*arguments: str) -> str:
    done = subprocess.run(
        ["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return done.stdout.strip()


def _processor() -> str:
    about = Path("/proc/cpuinfo")
    text = about.read_text() if about.is_file() else ""
    found = re.search(r"^model name\s*:\s*(.+)$", text, re.MULTILINE)
    return found[1].strip() if found else platform.processor() or platform.machine()


def _memory() -> int:
    return round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30)
