# SPDX-License-Identifier: MIT
"""Compare methods on random scenes: `python -m hybrid_jax.evaluate --run DIR --out FILE`."""

import time
from pathlib import Path
from typing import Literal

from hybrid_jax.compilecache import enable_compile_cache
from hybrid_jax.train import run_cli

Method = Literal["hybrid", "lfd", "drl"]


def main(
    run: Path,
    out: Path,
    trials: int = 10,
    methods: tuple[Method, ...] = ("hybrid", "lfd"),
    seed: int = 0,
) -> int:
    """Plan and execute the sorting of one random object in each of N random scenes.

    Args:
        run: folder of a trained run.
        out: JSON file to write: every trial with its seed, and the metrics.
        trials: scenes; the seeds are seed, seed + 1, ... and were never trained on.
        methods: hybrid (both agents), lfd (skills alone), drl (joint agent between key poses).
        seed: of the first scene.
    """
    enable_compile_cache()
    from hybrid_jax import export, study  # noqa: PLC0415
    from hybrid_jax.planner.loading import load_planner  # noqa: PLC0415
    from hybrid_jax.progress import Progress  # noqa: PLC0415
    from hybrid_jax.runfolder import open_run  # noqa: PLC0415

    planner = load_planner(open_run(run))
    rows = []
    began = time.perf_counter()
    for method in methods:
        progress = Progress(method, "trials")
        for number in range(trials):
            rows.append(study.run_trial(study.METHODS[method](planner), method, seed + number))
            progress(
                number + 1,
                trials,
                f"placed {sum(r['success'] for r in rows if r['method'] == method)}",
            )
    metrics = [metric for method in methods for metric in study.summarize(rows, method)]
    export.write_json(out, {"trials": rows, "metrics": metrics})
    print(study.as_table(metrics))
    print(f"{len(rows)} trials in {time.perf_counter() - began:.0f} s; written to {out}")
    return 0


if __name__ == "__main__":
    run_cli(main)
