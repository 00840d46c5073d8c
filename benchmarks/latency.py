# SPDX-License-Identifier: MIT
"""How long a person waits: commands, first plans, other cells, each in a fresh process.

    python -m benchmarks.latency --run runs/gen3_handling-001 --json FILE

Compiled programs are kept in a folder of this benchmark, empty at first. Some ten minutes on two
cores, and as long as `make train` takes in a fresh clone more with --train.
"""

import json as json_module
import os
import shutil
import socket
import statistics
import subprocess
import sys
import tempfile
import time
import urllib.request
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import tyro

from benchmarks.newcomer import page_of, plan_in_browser
from benchmarks.report import metric, write
from hybrid_jax.runs.seeds import LATENCY
from hybrid_jax.runtime.terminal import remark

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT.parent / "shared" / "data" / "mbm"
"""The Panda's problems of MotionBenchMaker; no part of the project."""


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


def page(run: Path, cache: Path) -> list[dict]:
    """Row of the page `view`, opened anew with the programs that earlier ones kept."""
    if not (shutil.which("chromium") and shutil.which("chromedriver")):
        remark("latency.page_plan is left out: it presses buttons in Chromium, which is absent")
        return []
    command = [sys.executable, "-m", "hybrid_jax.view", "--run", str(run)]
    for _ in range(2):  # the first one fills the cache
        with page_of(command, ROOT, _environment(cache)) as address:
            told, seconds = plan_in_browser(address)
    note = f"from Plan until the arm moves; {told}"
    return [metric("latency.page_plan", seconds, "s", "lower", note)]


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


def new_cells(cache: Path) -> list[dict]:
    """Rows of first motions in cells that were never seen; other cells filled the cache."""
    if not FOLDER.is_dir():
        remark(f"new cells: left out, {FOLDER.name} is absent")
        return []
    arguments = ["new-cells", "--folder", str(FOLDER)]
    _measured(cache, *arguments, "--every", "10", "--first", "7")
    found = _measured(cache, *arguments)
    seconds, count = found["seconds"], len(found["seconds"])
    solved = f"{found['statuses'].count('OK')} of {count} planned"
    note = f"first plan_joint_motion in each of {count} cells of the Panda, another process's "
    note += f"cells filled the cache; {solved}; {len(found['traced'])} programs traced"
    return [
        metric("latency.new_cell_warm", statistics.median(seconds), "s", "lower", note),
        metric("latency.new_cell_warm_worst", max(seconds), "s", "lower", "the longest of them"),
    ]


def service(run: Path, cache: Path, count: int, clients: int = 16) -> list[dict]:
    """Rows of a server that several clients ask at once, each as soon as it has an answer."""
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]
    address, numbers = f"http://127.0.0.1:{port}", iter(LATENCY[:count])
    command = [sys.executable, "-m", "hybrid_jax.serve", "--run", str(run), "--port", str(port)]
    server = subprocess.Popen(command, env=_environment(cache), stderr=subprocess.DEVNULL)
    try:
        _wait_until_ready(address)
        began = time.perf_counter()
        with ThreadPoolExecutor(clients) as pool:
            asked = list(pool.map(lambda seed: _ask(address, seed), numbers))
        took = time.perf_counter() - began
    finally:
        server.terminate()
        server.wait()
    seconds = [row for row in asked if row is not None]
    text = f"{count} requests of {clients} clients"
    return [
        metric("latency.server_lost", count - len(seconds), "1", "lower", f"of {text}"),
        metric("latency.server_p99", float(np.quantile(seconds, 0.99)), "s", "lower", text),
        metric("latency.server_median", statistics.median(seconds), "s", "lower", text),
        metric("latency.server_rate", count / took, "1/s", "higher", f"plans a second, {text}"),
    ]


def _wait_until_ready(address: str) -> None:
    """Wait for a server; it compiles first where nothing is kept."""
    for _ in range(600):
        try:
            with urllib.request.urlopen(f"{address}/health") as reply:
                if json_module.load(reply)["status"] == "ready":
                    return
        except OSError:  # it does not listen yet
            pass
        time.sleep(1.0)
    raise TimeoutError(f"the server at {address} was not ready within ten minutes")


def _ask(address: str, seed: int) -> float | None:
    """Seconds until a plan is there; None if none comes."""
    objects = ("block_1", "block_2", "bolt_1", "bolt_2", "hammer")
    task = {"object": objects[seed % len(objects)], "scene_seed": seed}
    began = time.perf_counter()
    try:
        with urllib.request.urlopen(f"{address}/plan", json_module.dumps(task).encode()) as reply:
            json_module.load(reply)
    except (OSError, ValueError):
        return None
    return time.perf_counter() - began


def soak(run: Path, cache: Path, count: int, largest: int) -> list[dict]:
    """Rows of one process that plans batches of changing sizes."""
    found = _measured(
        cache, "soak", "--run", str(run), "--count", str(count), "--largest", str(largest)
    )
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
        rows += page(run, cache)
        rows += soak(run, cache, *((4, 2) if tiny else (1000, 40)))
        rows += service(run, cache, 20 if tiny else 1000)
        rows += [] if tiny else new_cells(cache)
        rows += [] if tiny else second_cell(place / "other programs")
        rows += make_train(place) if train else []
    write(rows, json, {"LATENCY": LATENCY})


if __name__ == "__main__":
    tyro.cli(main)
