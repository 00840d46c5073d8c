# SPDX-License-Identifier: MIT
"""How long a person waits: commands, first plans, other cells, each in a fresh process.

    python -m benchmarks.latency --run runs/gen3_handling-001 --json FILE

Compiled programs are kept in a folder of this benchmark, empty at first. Some ten minutes on two
cores, and as long as `make train` takes in a fresh clone more with --train.
"""

import json as json_module
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import tyro

from benchmarks.report import metric, write
from hybrid_jax.runs.seeds import LATENCY

ROOT = Path(__file__).resolve().parents[1]


def _environment(cache: Path) -> dict[str, str]:
    return os.environ | {"JAX_COMPILATION_CACHE_DIR": str(cache)}


def _seconds(command: list[str], cache: Path) -> float:
    """Wall time of a command with a folder of compiled programs."""
    began = time.perf_counter()
    subprocess.run(command, env=_environment(cache), check=True, capture_output=True)
    return time.perf_counter() - began


def _measured(cache: Path, *arguments: str) -> dict:
    """What a process of `latency_process` prints."""
    command = [sys.executable, "-m", "benchmarks.latency_process", *arguments]
    done = subprocess.run(
        command, env=_environment(cache), check=True, text=True, stdout=subprocess.PIPE
    )
    return json_module.loads(done.stdout.splitlines()[-1])


def commands(run: Path, cache: Path, place: Path) -> list[dict]:
    """Rows of `python -m hybrid_jax.plan`: the first one fills the cache."""
    (place / "task.json").write_text('{"object": "block_1", "scene_seed": 3}')
    command = [sys.executable, "-m", "hybrid_jax.plan", "--run", str(run)]
    command += ["--task", str(place / "task.json"), "--out", str(place / "plan.json")]
    cold = _seconds(command, cache)
    warm = [_seconds(command, cache) for _ in range(3)]
    whole = "whole command"
    return [
        metric("latency.plan_command_cold", cold, "s", "lower", f"{whole}, nothing kept"),
        metric(
            "latency.plan_command_warm",
            statistics.median(warm),
            "s",
            "lower",
            f"{whole}, programs kept; median of {len(warm)}, {min(warm):.1f} to {max(warm):.1f}",
        ),
    ]


def plans(run: Path, cache: Path, count: int) -> list[dict]:
    """Rows of one process that plans random tasks; a first such process fills the cache."""
    arguments = ["plans", "--run", str(run), "--count", str(count)]
    _measured(cache, *arguments, "--first", str(count + 1))
    found = _measured(cache, *arguments)
    first, *later = found["seconds"]
    solved = found["statuses"].count("OK")
    note = f"longest of {count} random tasks after the first; {solved} of {count + 1} planned"
    return [
        metric("latency.import", found["imported"], "s", "lower", "of what planning needs"),
        metric("latency.load_warm", found["load"], "s", "lower", "open_run and load_planner"),
        metric("latency.first_plan_warm", first, "s", "lower", "plan_motion after that"),
        metric("latency.worst_plan", max(later), "s", "lower", note),
        metric("latency.median_plan", statistics.median(later), "s", "lower", "of the same"),
    ]


def second_cell(cache: Path) -> list[dict]:
    """Rows of another cell of the handling cell's class, in a process that planned in that."""
    found = _measured(cache, "second-cell")
    names = ", ".join(sorted(set(found["traced"]))) or "none"
    note = f"programs that were traced: {names}"
    took = f"three plans: {', '.join(found['statuses'])}"
    return [
        metric("latency.second_cell_traces", len(found["traced"]), "1", "lower", note),
        metric("latency.second_cell_seconds", found["seconds"], "s", "lower", took),
    ]


def soak(run: Path, cache: Path, count: int) -> list[dict]:
    """Rows of one process that plans batches of changing sizes."""
    found = _measured(cache, "soak", "--run", str(run), "--count", str(count))
    batches = found["batches"]
    half = batches[len(batches) // 2 :]
    late = sum(batch["compiles"] > 0 for batch in half)
    growth = half[-1]["resident_mb"] - half[0]["resident_mb"]
    slow = max(batch["seconds"] for batch in batches[1:])
    text = f"calls of {len(half)} in the second half that load or compile a program"
    return [
        metric("latency.soak_compiles", late, "1", "lower", text),
        metric("latency.soak_maps", found["maps"], "1", "lower", "memory maps held in the end"),
        metric("latency.soak_growth", growth, "MB", "lower", "over the second half"),
        metric("latency.soak_longest", slow, "s", "lower", "longest call after the first"),
    ]


def make_train(place: Path) -> list[dict]:
    """Row of `make train` in a fresh clone, with its installation and empty caches."""
    clone = place / "clone"
    kept = {k: v for k, v in os.environ.items() if k != "JAX_COMPILATION_CACHE_DIR"}
    began = time.perf_counter()
    subprocess.run(["git", "clone", "--quiet", str(ROOT), str(clone)], check=True)
    environment = kept | {"XDG_CACHE_HOME": str(place / "cache")}
    subprocess.run(["make", "train"], cwd=clone, env=environment, check=True)
    seconds = time.perf_counter() - began
    return [metric("latency.make_train", seconds, "s", "lower", "clone and installation included")]


def small_run(folder: Path, cache: Path) -> Path:
    """A run of preset `smoke`, for a quick try."""
    command = [sys.executable, "-m", "hybrid_jax.train", "--preset", "smoke", "--quiet"]
    _seconds([*command, "--out", str(folder)], cache)
    return folder


def main(
    run: Path = Path("runs/gen3_handling-001"),
    json: Path | None = None,
    train: bool = False,
    tiny: bool = False,
) -> None:
    """Print how long a person waits.

    Args:
        run: folder of a trained run of the handling cell.
        json: file to write the figures to.
        train: measure `make train` in a fresh clone too.
        tiny: as little of everything as shows that it runs.
    """
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        cache = place / "programs"
        if tiny:  # others that are tried have compiled the same
            cache = Path(os.environ.get("JAX_COMPILATION_CACHE_DIR", cache))
        run = small_run(place / "run", cache) if tiny else run
        rows = commands(run, cache, place) + plans(run, cache, 2 if tiny else 100)
        rows += soak(run, cache, 6 if tiny else 1000)
        rows += [] if tiny else second_cell(place / "other programs")
        rows += make_train(place) if train else []
    write(rows, json, {"LATENCY": LATENCY})


if __name__ == "__main__":
    tyro.cli(main)
