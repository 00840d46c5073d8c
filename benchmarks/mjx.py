# SPDX-License-Identifier: MIT
"""MJX: collision checks beside the kernels and C MuJoCo, and a run that trains on it throughout.

    python -m benchmarks.mjx --json FILE [--run DIR]

The run is that of `python -m hybrid_jax.train --preset mjx`. About an hour on two cores.
"""

import json as json_module
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from benchmarks import rivals
from benchmarks.kernels import configurations
from benchmarks.mjx_rival import CELL, mjx_in_its_process
from benchmarks.report import metric, race, write
from hybrid_jax.kernels.collision import clearance as fused
from hybrid_jax.mjx import collision as mjx_collision
from hybrid_jax.runs.load_planner import load_bridger
from hybrid_jax.runs.run_folder import Run, open_run
from hybrid_jax.runs.seeds import JOINT_AGENT_TEST
from hybrid_jax.runs.stages import collect_segments
from hybrid_jax.runtime.devices import Spread, use_all_cores
from hybrid_jax.workcell.load import load_workcell

STAGES = 5
TINY = ("--preset", "smoke", "--backend", "mjx", "--physics", "mjx")


def speeds(count: int, swept: int) -> list[dict]:
    """Collision checks per second: MJX's on the pruned model, the kernels', and C MuJoCo's."""
    cell, spread = load_workcell(CELL), Spread()
    shared, engine = spread.share(cell), rivals.Engine(cell)
    q = configurations(cell, count * len(spread.devices))
    items = spread.split(q)
    checks = {
        "mjx": spread.over(mjx_collision.closest, 1, options=mjx_collision.compiler_options("mjx")),
        "fused": spread.over(fused.closest, 1),
    }
    ours, kernels = (np.asarray(check(shared, items)[0]) for check in checks.values())
    runs = {name: (lambda c=check: c(shared, items), len(q)) for name, check in checks.items()}
    runs["mujoco"] = (lambda: engine.sweep(q[:swept]), min(swept, len(q)))
    speed = race(runs)
    usual = mjx_in_its_process(count, "")
    far = np.abs(kernels) > 1e-4
    differ = int((np.sign(ours) != np.sign(kernels))[far].sum())
    batch = f"batch of {len(q)}, {len(spread.devices)} devices"
    return [
        metric("mjx.checks", speed["mjx"], "1/s", "higher", f"near pairs alone; {batch}"),
        metric("mjx.checks_as_they_come", usual, "1/s", "higher", f"batch of {count}, no flags"),
        metric("mjx.speedup", speed["mjx"] / usual, "1", "higher", "of the two above"),
        metric("mjx.fused", speed["fused"], "1/s", "higher", f"the kernels; {batch}"),
        metric("mjx.vs_fused", speed["mjx"] / speed["fused"], "1", "higher"),
        metric("mjx.vs_mujoco", speed["mjx"] / speed["mujoco"], "1", "higher", "on one thread"),
        metric("mjx.signs_differ", differ, "1", "lower", f"from the kernels', of {far.sum()}"),
    ]


def train(folder: Path, options: tuple[str, ...]) -> tuple[list[dict], float]:
    """Rows of the summary of a training in a process of its own, and its time [s]."""
    command = [sys.executable, "-m", "hybrid_jax.train", *options, "--out", str(folder), "--json"]
    began = time.perf_counter()
    done = subprocess.run([*command, "--quiet"], capture_output=True, text=True, check=True)
    return json_module.loads(done.stdout)["stages"], time.perf_counter() - began


def trained(folder: Path, rows: list[dict], seconds: float) -> list[dict]:
    """Figures of a training, from its summary and its log."""
    took = ", ".join(f"{row['stage']} {row['seconds']:.0f}" for row in rows)
    show = next((row for row in rows if row["stage"] == "showcase"), {"done": 0, "objects": 0})
    rates = [row["rate"] for row in open_run(folder).metrics("drl") if "rate" in row]
    return [
        metric("mjx.stages_finished", len(rows), "1", "higher", f"of {STAGES}"),
        metric("mjx.train_seconds", seconds, "s", "lower", took),
        metric("mjx.steps", float(np.median(rates)), "1/s", "higher", "joint agent, in dynamics"),
        metric(
            "mjx.placed", show["done"] / max(show["objects"], 1), "1", "higher",
            f"of {show['objects']} objects, in C MuJoCo",
        ),
    ]  # fmt: skip


def held_out(run: Run, tasks: int) -> list[dict]:
    """Share of unseen segments that the joint agent bridges, rolled out in dynamics and proven."""
    segments = collect_segments(run, "collect", JOINT_AGENT_TEST.start, tasks, quiet=True)
    paths = load_bridger(run)(jax.tree.map(jnp.asarray, segments), jax.random.key(0))
    solved = [path is not None for path in paths]
    tries = " then ".join(map(str, run.preset.joint.rollouts))
    note = f"of {len(solved)} of {tasks} tasks, {tries} rollouts"
    return [metric("mjx.heldout_success_64", float(np.mean(solved)), "1", "higher", note)]


def main(json: Path | None = None, run: Path | None = None, tiny: bool = False) -> None:
    """Measure and print; write JSON if asked to.

    Args:
        json: file for the figures.
        run: folder for the training, kept; a temporary one if not given.
        tiny: as little of everything as shows that it runs.
    """
    use_all_cores()
    with tempfile.TemporaryDirectory() as temporary:
        folder = run or Path(temporary) / "run"
        rows, seconds = train(folder, TINY if tiny else ("--preset", "mjx"))
        tasks = 1 if tiny else 40
        figures = speeds(16 if tiny else 512, 50 if tiny else 5000)
        figures += trained(folder, rows, seconds) + held_out(open_run(folder), tasks)
    seeds = {"JOINT_AGENT_TEST": range(JOINT_AGENT_TEST.start, JOINT_AGENT_TEST.start + tasks)}
    write(figures, json, seeds)


if __name__ == "__main__":
    tyro.cli(main)
