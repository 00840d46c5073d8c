# SPDX-License-Identifier: MIT
"""Joint starts to joint goals: public problems of MotionBenchMaker, against OMPL.

    python -m benchmarks.motion_bench_maker --json FILE
    python -m benchmarks.motion_bench_maker --robot fetch --every 10 --first 7 --json FILE

Both take turns on each problem, in the same process: our RRT-Connect with its proof, compiled, and
OMPL's RRT-Connect with C MuJoCo as its checker. Every path of both is checked again by C MuJoCo,
far denser. The problems are not part of the project; without them the benchmark says so.
"""

import functools
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import jax
import numpy as np
import tyro

import hybrid_jax as hj
from benchmarks.contact_check import ContactCheck
from benchmarks.mbm_cells import Problem, file_of, read_problems
from benchmarks.report import metric, write
from hybrid_jax.baselines.ompl_paths import OmplPlanner
from hybrid_jax.planner.point_to_point import JointMotionConfig, find_path, plan_joint_motion
from hybrid_jax.planner.smoothing import densify
from hybrid_jax.types import Status

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
FOLDERS = {"panda": DATA / "mbm", "fetch": DATA / "mbm_fetch"}
PREFIXES = {"panda": "mbm.", "fetch": "mbm.fetch_"}
"""Of the figures' names."""
SECONDS = 10.0
"""Time that OMPL may take for a problem."""
FINE = 0.005
"""Distance of the configurations of a path that are checked again [rad]."""


@dataclass(frozen=True)
class Row:
    """One problem by one method."""

    scene: str
    seconds: float
    found: bool
    touches: bool
    """Does the path that was found touch something, checked densely?"""
    length: float
    """Of that path [rad]."""

    @property
    def solved(self) -> bool:
        return self.found and not self.touches


def judge(problem: Problem, path: np.ndarray | None, seconds: float) -> Row:
    """A row of a path `[point, joint]`, or of none."""
    if path is None:
        return Row(problem.scene, seconds, False, False, np.nan)
    free = ContactCheck(problem.cell)
    touches = not all(map(free, densify(np.asarray(path, float), FINE)))
    length = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
    return Row(problem.scene, seconds, True, touches, length)


def ours(problem: Problem, config: JointMotionConfig, key: jax.Array) -> Row:
    """The search of `plan_joint_motion`, its proof and its repetitions included."""
    began = time.perf_counter()
    path = find_path(problem.cell, problem.start, problem.goal, config, key)
    return judge(problem, path, time.perf_counter() - began)


def ompl(problem: Problem) -> Row:
    """The first path that OMPL finds."""
    planner = OmplPlanner(*np.asarray(problem.cell.joint_limits, float).T)
    ends = problem.start.astype(float), problem.goal.astype(float)
    return judge(problem, *planner.solve(ContactCheck(problem.cell), *ends, SECONDS))


def whole(problem: Problem, config: JointMotionConfig, key: jax.Array) -> tuple[bool, float]:
    """Does the whole layer answer with a trajectory, and how long does it take [s]?"""
    began = time.perf_counter()
    result = plan_joint_motion(problem.cell, problem.start, problem.goal, config, key=key)
    return result.status is Status.OK, time.perf_counter() - began


def compare(problems: list[Problem]) -> tuple[dict[str, list[Row]], list[tuple[bool, float]]]:
    """All methods on all problems; each scene's programs are compiled on its first three first."""
    table, trajectories, config = {"ours": [], "ompl": []}, [], JointMotionConfig()
    methods = {"ours": functools.partial(ours, config=config), "ompl": lambda p, key: ompl(p)}
    for scene in dict.fromkeys(p.scene for p in problems):
        here = [p for p in problems if p.scene == scene]
        for problem in here[:3]:
            for search in dict.fromkeys(config.searches):
                ours(problem, replace(config, searches=(search,)), jax.random.key(0))
            whole(problem, config, jax.random.key(0))
        for problem in here:
            key = jax.random.key(problem.number)
            for name, method in methods.items():
                table[name].append(method(problem, key=key))
            trajectories.append(whole(problem, config, key))
        print(f"{scene}: {len(here)} problems", flush=True)
    return table, trajectories


def free_ends(problems: list[Problem]) -> list[Problem]:
    """The problems whose start and goal are free as C MuJoCo sees it; says how many are not."""
    free = []
    for problem in problems:
        is_free = ContactCheck(problem.cell)
        if is_free(problem.start) and is_free(problem.goal):
            free.append(problem)
    if len(free) < len(problems):
        print(f"{len(problems) - len(free)} of {len(problems)} problems left out: an end touches")
    return free


def scene_rows(table: dict[str, list[Row]], prefix: str) -> list[dict]:
    """Median times of each scene."""
    found = []
    for scene in dict.fromkeys(r.scene for r in table["ours"]):
        for name, rows in table.items():
            here = [r for r in rows if r.scene == scene]
            times, solved = [r.seconds for r in here], sum(r.solved for r in here)
            found.append(
                metric(
                    f"{prefix}{scene}_{name}",
                    float(np.median(times)),
                    "s",
                    "lower",
                    f"median; mean {np.mean(times):.3f}; {solved} of {len(here)} solved",
                )
            )
    return found


def figures(
    table: dict[str, list[Row]], trajectories: list[tuple[bool, float]], prefix: str
) -> list[dict]:
    """All figures: shares, times, lengths, and the ratios that count."""
    found, medians = scene_rows(table, prefix), {}
    for name, rows in table.items():
        times = np.array([r.seconds for r in rows])
        medians[name] = float(np.median(times))
        touching = sum(r.touches for r in rows)
        found += [
            metric(
                f"{prefix}{name}_solved",
                float(np.mean([r.solved for r in rows])),
                "1",
                "higher",
                f"{len(rows)} problems; {sum(r.found for r in rows)} paths found, {touching} "
                f"of them touch between the points that were checked",
            ),
            metric(
                f"{prefix}{name}_seconds",
                medians[name],
                "s",
                "lower",
                f"median; mean {times.mean():.3f}, p95 {np.quantile(times, 0.95):.3f}, "
                f"worst {times.max():.3f}",
            ),
            metric(
                f"{prefix}{name}_length",
                float(np.nanmedian([r.length for r in rows])),
                "rad",
                "lower",
                "median, not shortened",
            ),
        ]
    theirs = [a.solved for a, b in zip(*table.values(), strict=True) if b.solved]
    pairs = np.array([[a.seconds, b.seconds] for a, b in zip(*table.values(), strict=True)])
    means = pairs.mean(axis=0)
    seconds = [t for _, t in trajectories]
    return found + [
        metric(
            f"{prefix}trajectories",
            float(np.mean([ok for ok, _ in trajectories])),
            "1",
            "higher",
            "smooth, timed, checked; share of the problems",
        ),
        metric(
            f"{prefix}trajectory_seconds",
            float(np.median(seconds)),
            "s",
            "lower",
            f"median of the whole layer; p95 {np.quantile(seconds, 0.95):.3f}",
        ),
        metric(
            f"{prefix}solved",
            float(np.mean(theirs)) if theirs else 0.0,
            "1",
            "higher",
            f"of {len(theirs)} that OMPL solves in {SECONDS:g} s, of {len(pairs)} problems",
        ),
        metric(
            f"{prefix}time_vs_ompl",
            medians["ours"] / medians["ompl"],
            "1",
            "lower",
            f"ratio of the medians; of the means {means[0] / means[1]:.2f}; median of the "
            f"ratios {np.median(pairs[:, 0] / pairs[:, 1]):.2f}",
        ),
    ]


def main(
    json: Path | None = None,
    robot: Literal["panda", "fetch"] = "panda",
    folder: Path | None = None,
    every: int = 1,
    first: int = 0,
    tiny: bool = False,
) -> None:
    """Print all figures.

    Args:
        json: file to write them to.
        robot: whose problems are planned.
        folder: with the problems; where they usually are if None.
        every: take each n-th problem of a scene only.
        first: number of the first of them, from 0 to `every` - 1.
        tiny: as little of everything as shows that it runs.
    """
    every, folder = 50 if tiny else every, folder or FOLDERS[robot]
    hj.use_all_cores()
    found = file_of(folder)
    if found is None or found[0] != robot:
        print(
            f"{folder} has no {robot}_problems.npz: nothing to run. The problems are not part of "
            "the project; give their folder by --folder."
        )
        return
    problems = free_ends(read_problems(folder, every, first))
    write(figures(*compare(problems), PREFIXES[robot]), json)


if __name__ == "__main__":
    tyro.cli(main)
