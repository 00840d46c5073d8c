# SPDX-License-Identifier: MIT
"""The handling study: `python -m hybrid_jax.evaluate --run DIR --out FILE`."""

from pathlib import Path

from hybrid_jax.compilecache import enable_compile_cache
from hybrid_jax.errors import InputError
from hybrid_jax.train import run_cli

METHODS = ("hybrid", "lfd", "drl", "ompl", "disturbed", "paper")
FIRST_SEED = 10_000
"""Of the study's scenes; nothing was tuned on those from here on."""


def main(
    run: Path,
    out: Path | None = None,
    runs: int = 100,
    methods: tuple[str, ...] = METHODS,
    seed: int = FIRST_SEED,
    paper: Path | None = None,
    video: Path | None = None,
) -> int:
    """Let methods sort all objects of the same random scenes, executed in physics.

    Args:
        run: folder of a trained run.
        out: JSON file to write: every run with its seed, and the metrics. A chart and the
            recordings of failed runs are put beside it.
        runs: scenes; their seeds are seed, seed + 1, ...
        methods: hybrid, lfd, drl, ompl, disturbed, paper.
        seed: of the first scene.
        paper: folder of a run of preset paper, for method paper; trained into the run's folder
            if not given.
        video: MP4 to write instead: the scene of --seed, the first two methods side by side.
    """
    if (out is None) == (video is None):
        raise InputError("say where to write to: --out FILE.json for the study, or --video FILE")
    if runs < 1:
        raise InputError(f"--runs must be at least 1, got {runs}")
    enable_compile_cache()
    from hybrid_jax import study  # noqa: PLC0415
    from hybrid_jax.runfolder import open_run  # noqa: PLC0415

    opened, papers = open_run(run), open_run(paper) if paper else None
    found = [study.contestant(name, opened, papers) for name in methods]
    contestants = [one for one in found if one]
    if video:
        return film_runs(opened, contestants[:2], seed, video)
    return run_study(opened, contestants, range(seed, seed + runs), out)


def run_study(opened, contestants, seeds: range, out: Path) -> int:
    """All methods, one after the other; what is done is on disk after each of them."""
    from hybrid_jax import export, study, studypictures  # noqa: PLC0415

    rows, seconds, metrics = [], {}, []
    for one in contestants:
        reports, seconds[one.name] = study.run_contestant(opened.cell, one, seeds)
        rows += [study.row_of(one.name, report) for report in reports]
        keep_failures(out, one.name, reports)
        metrics = study.summarize(rows, seconds)
        export.write_json(out, {"metrics": metrics, "runs": rows})
    studypictures.draw_study(out.with_suffix(".png"), rows)
    print(study.as_table(metrics))
    print(f"written to {out} and {out.with_suffix('.png')}")
    return 0


def keep_failures(out: Path, method: str, reports) -> None:
    """Record the motions of failed runs, `[frame, nq]`, beside the study's file."""
    import numpy as np  # noqa: PLC0415

    for report in reports:
        if not report.success and len(report.frames) > 1:
            folder = out.with_suffix("")
            folder.mkdir(parents=True, exist_ok=True)
            np.savez_compressed(folder / f"{method}-{report.seed}.npz", frames=report.frames)


def film_runs(opened, contestants, seed: int, video: Path) -> int:
    """Two methods on one scene, side by side."""
    from hybrid_jax import film, study  # noqa: PLC0415

    films = {}
    for one in contestants:
        report = study.run_contestant(opened.cell, one, [seed])[0][0]
        placed = sum(r.success for r in report.reports)
        title = f"{one.name}: {placed} of {len(report.reports)} placed"
        films[title] = film.render(opened.cell.model, report.frames)
        for r in report.reports:
            print(f"{one.name:9s} {r.name}: {r.cause or 'placed'} {r.detail}".rstrip())
    if not all(films.values()):
        return 1
    video.parent.mkdir(parents=True, exist_ok=True)
    return 0 if film.save_film(video, film.side_by_side(films)) else 1


if __name__ == "__main__":
    run_cli(main)
