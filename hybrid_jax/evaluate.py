# SPDX-License-Identifier: MIT
"""The study of a run's cell: `python -m hybrid_jax.evaluate --run DIR --out FILE`."""

from dataclasses import replace
from pathlib import Path
from typing import Literal

from hybrid_jax.errors import InputError
from hybrid_jax.runtime.terminal import answer, remark, run_main

BLOCK = 50
"""Runs carried out side by side; a study that is killed loses at most one such block."""


def main(
    run: Path,
    out: Path | None = None,
    runs: int = 100,
    methods: tuple[str, ...] = (),
    seed: int | None = None,
    engine: Literal["auto", "mujoco", "mjx"] = "auto",
    paper: Path | None = None,
    figures: Path | None = None,
    video: Path | None = None,
    quiet: bool = False,
    json: bool = False,
) -> int:
    """Let methods do the tasks of the run's cell in the same random scenes, carried out in physics.

    A study that was stopped goes on when it is started again with the same arguments.

    Args:
        run: folder of a trained run.
        out: JSON file to write: every run with its seed, and the metrics. A chart and the
            recordings of failed runs are put beside it.
        runs: random scenes; of an inspection, scenes for each part. Their seeds begin with --seed.
        methods: hybrid, lfd, lfd_executed, drl, ompl, disturbed, paper, paper_literal, paper_lfd,
            paper_drl, ablation_...; if none is named, those of the cell's study.
        seed: of the first scene; if not given, the study's own, which nothing was tuned on
            (`hybrid_jax.runs.seeds`).
        engine: physics that carries the plans out: C MuJoCo on all cores (mujoco), or MJX (mjx);
            auto takes the latter on an accelerator.
        paper: folder of a run of preset paper, for the methods of the paper; if not given, --run
            where it is one, else one that is trained into its folder.
        figures: JSON file for the metrics alone, with command, commit, machine and versions.
        video: MP4 or GIF to write instead: the scene of --seed, the first two methods side by side.
        quiet: print the metrics only.
        json: print the metrics as JSON.
    """
    if (out is None) == (video is None):
        raise InputError("say where to write to: --out FILE.json for the study, or --video FILE")
    if runs < 1:
        raise InputError(f"--runs must be at least 1, got {runs}")
    from hybrid_jax.runs.run_folder import open_run
    from hybrid_jax.runtime.devices import use_all_cores
    from hybrid_jax.studies.measures import as_table
    from hybrid_jax.studies.methods import make_method
    from hybrid_jax.studies.registry import study_of

    use_all_cores()
    opened, papers = open_run(run), open_run(paper) if paper else None
    study = study_of(opened.cell)
    first = study.SEEDS.start if seed is None else seed
    candidates = [make_method(name, opened, papers) for name in methods or study.METHODS]
    compared = [replace(method, engine=engine) for method in candidates if method]
    if not compared:
        raise InputError(f"nothing is left to compare: {', '.join(methods)} cannot run here")
    if video:
        return film_runs(study, opened, compared[:2], first, video)
    study.drawn(opened.cell, first, runs)
    seeds = range(first, first + runs)
    metrics = run_study(study, opened, compared, seeds, out, quiet, papers)
    if figures:
        from hybrid_jax.runtime.provenance import write_figures

        write_figures(figures, metrics, {"scenes": study.drawn(opened.cell, first, runs)})
    answer(as_table(metrics), metrics, json)
    return 0


def run_study(
    study, opened, compared, seeds: range, out: Path, quiet: bool, papers=None
) -> list[dict]:
    """Run a study: all methods, one after the other, in blocks of runs.

    Results are kept after each block; a study that was killed goes on with the runs that it lacks.

    Args:
        study: module of the study.
        opened: run whose planner is compared.
        compared: methods.
        seeds: of the scenes.
        out: JSON file to write.
        quiet: show no progress.
        papers: run of preset `paper`, if one was given.

    Returns:
        Rows of metrics.
    """
    from hybrid_jax.export import write_json
    from hybrid_jax.runtime.provenance import commit
    from hybrid_jax.studies.journal import Journal

    about = {
        "run": str(opened.folder.resolve()),
        "cell": opened.cell.source.digest,
        "paper": str(papers.folder.resolve()) if papers else None,
        "engine": compared[0].engine,
        "first": seeds.start,
        "runs": len(seeds),
        "commit": commit(),
    }
    journal = Journal(out.with_suffix(".progress"), about)
    try:
        for method in compared:
            run_blocks(study, opened, method, seeds, out, journal, quiet)
            metrics = study.summarize(journal.rows, journal.seconds) + study.learning(opened)
            write_json(out, {"metrics": metrics, "runs": journal.rows})
        study.draw(out.with_suffix(".png"), journal.rows, opened)
        journal.close(finished=True)
    finally:
        journal.close(finished=False)
    if not quiet:
        remark(f"written to {out} and {out.with_suffix('.png')}")
    return metrics


def run_blocks(study, opened, method, seeds: range, out: Path, journal, quiet: bool) -> None:
    """Carry out the runs of one method that the journal lacks, block by block."""
    for first in range(0, len(seeds), BLOCK):
        block = seeds[first : first + BLOCK]
        if not journal.missing(method.name, block):
            continue
        reports, took = study.run_method(opened.cell, method, block, quiet)
        failed = [report for report in reports if not study.succeeded(report)]
        keep_motions(out.with_suffix(""), method.name, map(study.frames_of, failed))
        journal.add(method.name, block, [study.row_of(method.name, r) for r in reports], took)


def keep_motions(folder: Path, method: str, motions) -> None:
    """Save named motions `[frame, nq]`; those of one frame or none are left out."""
    import numpy as np

    for name, frames in motions:
        if len(frames) > 1:
            folder.mkdir(parents=True, exist_ok=True)
            np.savez_compressed(folder / f"{method}-{name}.npz", frames=frames)


def film_runs(study, opened, compared, seed: int, video: Path) -> int:
    """Film two methods on one scene, side by side; returns the exit code."""
    from hybrid_jax.reports import film

    films = {}
    for method in compared:
        report = study.run_method(opened.cell, method, [seed])[0][0]
        name = f"{method.name}: {study.title(report)}"
        films[name] = film.render(opened.cell.model, study.frames_of(report)[1])
        for line in study.lines(report):
            remark(f"{method.name:9s} {line}")
    if not all(films.values()):
        return 1
    video.parent.mkdir(parents=True, exist_ok=True)
    return 0 if film.save_film(video, film.side_by_side(films)) else 1


if __name__ == "__main__":
    run_main(main)
