# SPDX-License-Identifier: MIT
"""One benchmark in two checkouts, in turns on one machine: what a change costs or gains.

    python -m benchmarks.compare ../before . --module benchmarks.kernels --arguments=--no-mjx

Both checkouts run in this environment. Each figure is the best of its rounds; a ratio above 1 means
that the second checkout is better.
"""

import json as jsonlib
import math
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Annotated

import tyro

from benchmarks.report import metric, write


def run_once(checkout: Path, module: str, arguments: tuple[str, ...]) -> dict[str, dict]:
    """Figures of one run of a checkout's benchmark, by their keys."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "figures.json"
        subprocess.run(
            [sys.executable, "-m", module, *arguments, "--json", str(path)],
            cwd=checkout,
            env={**os.environ, "PYTHONPATH": str(checkout.resolve())},
            check=True,
            stdout=subprocess.DEVNULL,
        )
        return {row["key"]: row for row in jsonlib.loads(path.read_text())["metrics"]}


def best(runs: list[dict[str, dict]], key: str) -> float:
    """The best value of a figure over several runs."""
    pick = max if runs[0][key]["better"] == "higher" else min
    return pick(run[key]["value"] for run in runs)


def ratios(before: list[dict[str, dict]], after: list[dict[str, dict]]) -> list[dict]:
    """Ratio of each figure that says which direction is better; above 1 where `after` is better."""
    rows = []
    for key, row in after[0].items():
        if key not in before[0] or row["better"] not in ("higher", "lower"):
            continue
        old, new = best(before, key), best(after, key)
        if not (math.isfinite(old) and math.isfinite(new) and old > 0 and new > 0):
            continue
        ratio = new / old if row["better"] == "higher" else old / new
        note = f"{old:.4g} before, {new:.4g} after {row['unit']}".rstrip()
        rows.append(metric(f"change.{key}", ratio, "1", "higher", note))
    return rows


def main(
    before: Annotated[Path, tyro.conf.Positional] = Path("."),
    after: Annotated[Path, tyro.conf.Positional] = Path("."),
    /,
    module: str = "benchmarks.kernels",
    arguments: str = "",
    rounds: int = 2,
    json: Path | None = None,
    tiny: bool = False,
) -> None:
    """Measure.

    Args:
        before: folder of the first checkout.
        after: folder of the second checkout.
        module: the benchmark.
        arguments: its arguments, in one string: --arguments="--no-mjx --tiny".
        rounds: turns of each checkout.
        json: file to write the ratios to.
        tiny: one turn each of a benchmark of as little as there is.
    """
    options = tuple(arguments.split())
    if tiny:
        module, options, rounds = "benchmarks.readability", ("--tiny",), 1
    old: list[dict[str, dict]] = []
    new: list[dict[str, dict]] = []
    for _ in range(rounds):
        for checkout, figures in ((before, old), (after, new)):
            figures.append(run_once(checkout, module, options))
    write(ratios(old, new), json, {})


if __name__ == "__main__":
    tyro.cli(main)
