# SPDX-License-Identifier: MIT
"""Random plans written to each format and followed as their receivers do.

    python -m benchmarks.roundtrip --json FILE

Random arms of hinges and slides, random motions of one to four phases, with and without a gripper.
Readers and interpolation rules share no code with the package (`tests/controllers.py`). Some ten
minutes on two cores.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
import tyro

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

from random_plans import random_cell, random_plan  # noqa: E402
from roundtrips import Departures, depart  # noqa: E402

from benchmarks.report import metric, write  # noqa: E402
from hybrid_jax.runs.seeds import ROUND_TRIPS

PLANS = 20
"""Of each arm."""


def measure(arms: range) -> dict[str, Departures]:
    """The worst of all plans of some arms, by the ending of the file."""
    worst: dict[str, Departures] = {}
    with tempfile.TemporaryDirectory() as folder:
        for seed in arms:
            rng = np.random.default_rng(seed)
            cell = random_cell(rng)
            for _ in range(PLANS):
                task, plan = random_plan(cell, rng)
                for ending, found in depart(cell, task, plan, Path(folder), rng).items():
                    worst.setdefault(ending, Departures()).add(found)
    return worst


def main(plans: int = 1000, json: Path | None = None, tiny: bool = False) -> None:
    """Measure.

    Args:
        plans: how many, twenty of each arm.
        json: file to write the figures to.
        tiny: a few plans only, to see that this runs.
    """
    arms = ROUND_TRIPS[: 1 if tiny else -(-plans // PLANS)]
    by_ending, total = measure(arms), Departures()
    for found in by_ending.values():
        total.add(found)
    tool = ", ".join(f"{ending} {1e3 * d.tool:.3f}" for ending, d in by_ending.items())
    note = f"{len(arms) * PLANS} plans, three formats"
    rows = [
        metric("roundtrip.joint_error", total.joint, "", "lower", f"rad or m; {note}"),
        metric("roundtrip.gripper_errors", total.gripper, "", "lower", note),
        metric("roundtrip.controller_error", 1e3 * total.tool, "mm", "lower", tool),
        metric(
            "roundtrip.controller_violations",
            total.limits + total.refused,
            "",
            "lower",
            "times beyond a limit, and files that ROS 2 refuses",
        ),
    ]
    write(rows, json, {"ROUND_TRIPS": ROUND_TRIPS})


if __name__ == "__main__":
    tyro.cli(main)
