# SPDX-License-Identifier: MIT
"""Broken files for every reader: how many are refused by a named error, how many crash.

    python -m benchmarks.fuzz --json FILE

Each reader has a process of its own, so that a crash of the interpreter is counted too. Some
minutes on two cores. Every file follows from the reader's name and its number.
"""

import json as jsonlib
import math
import random
import subprocess
import sys
import tempfile
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import tyro

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

from fuzzing import attempt, make_targets, mutate  # noqa: E402

from benchmarks.report import metric, write  # noqa: E402
from hybrid_jax.workcell.load import load_workcell  # noqa: E402

SHARES = {"mjcf": 0.05, "urdf": 0.05}
"""Of all files, for readers that take long; the others share the rest evenly."""


def readers(folder: Path) -> dict:
    """What is tried, by name."""
    return make_targets(folder, load_workcell("gen3_handling"))


def work(name: str, count: int) -> None:
    """Try one reader; prints the outcomes, and before each file its number on stderr."""
    with tempfile.TemporaryDirectory() as sound, tempfile.TemporaryDirectory() as broken:
        target, outcomes, crashes = readers(Path(sound))[name], Counter(), []
        for number in range(count):
            if number % 100 == 0:
                print(number, file=sys.stderr, flush=True)
            data = mutate(random.Random(f"{name} {number}"), target)
            outcome, what = attempt(target, data, Path(broken))
            outcomes[outcome] += 1
            if outcome == "crashed":
                crashes.append(f"{number}: {what}"[:200])
    print(jsonlib.dumps({"outcomes": outcomes, "crashes": crashes[:20]}))


def try_reader(name: str, count: int) -> tuple[Counter, list[str]]:
    """Try one reader in its own process."""
    command = [sys.executable, "-m", "benchmarks.fuzz", "--only", name, "--count", str(count)]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        last = done.stderr.strip().splitlines()[-1:]
        return Counter(crashed=1), [f"the process ended with {done.returncode} after {last}"]
    found = jsonlib.loads(done.stdout.strip().splitlines()[-1])
    return Counter(found["outcomes"]), found["crashes"]


def main(
    count: int = 100_000, only: str = "", json: Path | None = None, tiny: bool = False
) -> None:
    """Try all readers.

    Args:
        count: files in all.
        only: the one reader to try, in this process.
        json: file for the figures.
        tiny: as little of everything as shows that it runs.
    """
    count = 200 if tiny else count
    if only:
        work(only, count)
        return
    with tempfile.TemporaryDirectory() as folder:
        names = list(readers(Path(folder)))
    even = (1 - sum(SHARES.values())) / (len(names) - len(SHARES))
    counts = [math.ceil(count * SHARES.get(name, even)) for name in names]
    with ThreadPoolExecutor(2) as pool:
        found = list(pool.map(try_reader, names, counts))
    rows, every = [], Counter()
    for name, (outcomes, crashes) in zip(names, found, strict=True):
        every += outcomes
        for crash in crashes:
            print(f"{name}: {crash}", file=sys.stderr)
        note = f"{outcomes['read']} read, {outcomes['refused']} refused by name"
        rows.append(metric(f"fuzz.{name}", outcomes["crashed"], "1", "lower", note))
    note = f"{every['read']} read, {every['refused']} refused by name"
    rows.append(metric("fuzz.crashes", every["crashed"], "1", "lower", note))
    rows.append(metric("fuzz.inputs", sum(every.values()), "1", "higher", "files tried"))
    write(rows, json)


if __name__ == "__main__":
    tyro.cli(main)
