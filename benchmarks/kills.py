# SPDX-License-Identifier: MIT
"""Kill trainings at random moments (SIGKILL) and go on: is what they leave the same?

    python -m benchmarks.kills --json FILE

A run of preset `smoke` is made once without disturbance. Then the same run is begun again and
again, killed after a random time, gone on with `--resume`, killed again, until it ends by itself;
then its files are compared, array by array and metric by metric. Rates and times are left out.
About an hour on two cores for 50 kills.
"""

import json as jsonlib
import random
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import tyro

from benchmarks.report import metric, write

CLOCK = {"rate", "planning_s", "seconds"}
"""Metrics that say how long something took."""
ARRAYS = ("map.npz", "lfd.npz", "drl.npz", "switch.npz", "segments.npz")
TABLES = ("map.jsonl", "lfd.jsonl", "drl.jsonl", "switch.jsonl")
FIRST, LAST = 3.0, 45.0
"""A process is killed so long after its start [s]; importing takes 3, a whole run some 40."""


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
    demos = [without_clock(jsonlib.loads((f / "demo.json").read_text())) for f in (one, other)]
    found += [] if demos[0] == demos[1] else ["demo.json"]
    names = [{path.name for path in folder.iterdir()} for folder in (one, other)]
    return found + sorted(f"left over: {name}" for name in names[0] ^ names[1])


def disturbed(folder: Path, rng: random.Random, most: int) -> tuple[int, list[str]]:
    """One run with as many kills as come, at most so many; how many, and in which stages."""
    kills, where = 0, []
    while True:
        begun = (folder / "config.json").is_file()
        process = start(folder, resume=begun)
        try:
            out, err = process.communicate(
                timeout=rng.uniform(FIRST, LAST) if kills < most else None
            )
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            kills += 1
            done = [stage for stage in ("map", "lfd", "drl", "switch")
                    if (folder / f"{stage}.npz").is_file()]  # fmt: skip
            where.append(f"after {done[-1] if done else 'nothing'}")
            continue
        if process.returncode:
            raise SystemExit(f"{folder} ended with {process.returncode}: {err or out}")
        return kills, where


def main(kills: int = 50, seed: int = 0, json: Path | None = None) -> None:
    """Kill until there were enough.

    Args:
        kills: how many.
        seed: of the moments.
        json: file for the figures.
    """
    rng, count, survived, runs, where = random.Random(seed), 0, 0, 0, []
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as parent:
        whole = Path(parent) / "whole"
        disturbed(whole, rng, 0)
        while count < kills:
            folder = Path(parent) / f"run{runs}"
            some, places = disturbed(folder, rng, kills - count)
            wrong = differences(whole, folder)
            for name in wrong:
                print(f"run {runs}: {name} differs", file=sys.stderr)
            count, runs, where = count + some, runs + 1, where + places
            survived += 0 if wrong else some
            print(f"{count} kills in {runs} runs, {survived} survived", flush=True)
            shutil.rmtree(folder)
    spread = {place: where.count(place) for place in sorted(set(where))}
    note = f"of {count} kills in {runs} runs; {spread}; {time.perf_counter() - began:.0f} s"
    write([metric("kills.survived", survived, "1", "higher", note)], json)


if __name__ == "__main__":
    tyro.cli(main)
