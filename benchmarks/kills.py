# SPDX-License-Identifier: MIT
"""Kill trainings at random moments (SIGKILL) and go on: is what they leave the same?

    python -m benchmarks.kills --json FILE

A run of preset `smoke` is made once without disturbance. Then the same run is made again and again,
killed once in each stage at a random moment and gone on with `--resume`; in the end its files are
compared, array by array and metric by metric. Rates and times are left out. About half an hour on
two cores for 50 kills.
"""

import json as jsonlib
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
import tyro

from benchmarks.report import metric, write

CLOCK = {"rate", "planning_s", "seconds"}
"""Metrics that say how long something took."""
ARRAYS = ("map.npz", "lfd.npz", "drl.npz", "switch.npz", "segments.npz")
TABLES = ("map.jsonl", "lfd.jsonl", "drl.jsonl", "switch.jsonl")
LONGEST = {"map": 12.0, "lfd": 8.0, "drl": 20.0, "switch": 12.0, "showcase": 25.0}
"""A stage is killed so long after it has begun, at most [s]: about as long as it takes. The first
begins with the process, which imports for a few seconds."""


def start(folder: Path, resume: bool) -> subprocess.Popen:
    """Begin or go on with the run."""
    command = [sys.executable, "-m", "hybrid_jax.train", "--preset", "smoke", "--quiet"]
    command += ["--out", str(folder), *["--resume"] * resume]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def without_clock(value):
    """A metric without what a clock says."""
    if isinstance(value, dict):
        return {k: without_clock(v) for k, v in value.items() if k not in CLOCK}
    if isinstance(value, list):
        return [without_clock(v) for v in value]
    return value


def rows_of(path: Path) -> list[dict]:
    """Metrics by step, the later of two lines for one step."""
    rows = map(jsonlib.loads, path.read_text().splitlines())
    return [without_clock(row) for row in {row["step"]: row for row in rows}.values()]


def differences(one: Path, other: Path) -> list[str]:
    """Files of two runs that say different things."""
    found = []
    for name in ARRAYS:
        with np.load(one / name) as a, np.load(other / name) as b:
            same = set(a.files) == set(b.files) and all(
                np.array_equal(a[k], b[k], equal_nan=a[k].dtype.kind == "f") for k in a.files
            )
        found += [] if same else [name]
    found += [name for name in TABLES if rows_of(one / name) != rows_of(other / name)]
    showcases = [
        without_clock(jsonlib.loads((f / "showcase.json").read_text())) for f in (one, other)
    ]
    found += [] if showcases[0] == showcases[1] else ["showcase.json"]
    names = [{path.name for path in folder.iterdir()} for folder in (one, other)]
    return found + sorted(f"left over: {name}" for name in names[0] ^ names[1])


def finished(folder: Path, stage: str) -> bool:
    """Has a stage left its result?"""
    return (folder / ("showcase.json" if stage == "showcase" else f"{stage}.npz")).is_file()


def kill_in(folder: Path, stage: str, rng: random.Random) -> bool:
    """Run until a stage has begun, and kill it at a random moment; False if it ended before."""
    process = start(folder, resume=(folder / "config.json").is_file())
    before = list(LONGEST)[: list(LONGEST).index(stage)]
    while process.poll() is None and not all(finished(folder, one) for one in before):
        time.sleep(0.02)
    try:
        process.communicate(timeout=rng.uniform(0.0, LONGEST[stage]))
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
        return True
    return False


def complete(folder: Path) -> None:
    """Go on until the run ends by itself."""
    process = start(folder, resume=(folder / "config.json").is_file())
    out, err = process.communicate()
    if process.returncode:
        raise SystemExit(f"{folder} ended with {process.returncode}: {err or out}")


def main(kills: int = 50, seed: int = 0, json: Path | None = None, tiny: bool = False) -> None:
    """Kill until there were enough.

    Args:
        kills: how many.
        seed: of the moments.
        json: file for the figures.
        tiny: as little of everything as shows that it runs.
    """
    kills = 1 if tiny else kills
    rng, count, survived, runs, where = random.Random(seed), 0, 0, 0, Counter()
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as parent:
        whole = Path(parent) / "whole"
        complete(whole)
        while count < kills:
            folder = Path(parent) / f"run{runs}"
            killed = [stage for stage in LONGEST if kill_in(folder, stage, rng)]
            complete(folder)
            wrong = differences(whole, folder)
            for name in wrong:
                print(f"run {runs}: {name} differs", file=sys.stderr)
            count, runs = count + len(killed), runs + 1
            survived += 0 if wrong else len(killed)
            where.update(killed)
            print(f"{count} kills in {runs} runs, {survived} survived", flush=True)
            shutil.rmtree(folder)
    note = f"of {count} kills in {runs} runs: " + ", ".join(f"{s} {n}" for s, n in where.items())
    note += f"; {time.perf_counter() - began:.0f} s"
    write([metric("kills.survived", survived, "1", "higher", note)], json)


if __name__ == "__main__":
    tyro.cli(main)
