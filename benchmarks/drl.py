# SPDX-License-Identifier: MIT
"""DRL-Feasibility: speed against the paper's own stack, success on unseen segments, the comparison.

    python -m benchmarks.drl --json FILE --picture FILE.png

PyBullet and Stable-Baselines3 come with the extra `bench`; without them the ratios are left out,
and it is said. About half an hour on two cores.
"""

from pathlib import Path
from typing import Literal

import matplotlib
import numpy as np
import tyro

import hybrid_jax as hj
from benchmarks import drl_ablation, drl_default, drl_problems, drl_study
from benchmarks.drl_trainings import Curve
from benchmarks.report import interval, metric, race, write
from hybrid_jax.agents import joint
from hybrid_jax.agents.trainers import make_programs
from hybrid_jax.contracts import Segments, take
from hybrid_jax.runs.presets import DEFAULT, PAPER
from hybrid_jax.types import Workcell
from hybrid_jax.workcell.load import load_workcell

matplotlib.use("Agg")


def rival(cell: Workcell, segments: Segments):
    """The paper's stack, or None where it is not installed."""
    try:
        from benchmarks.drl_rival import Rival
    except ImportError as error:
        print(f"{error.name} is not installed: ratios left out (pip install 'hybrid_jax[bench]')")
        return None
    return Rival(cell, segments, PAPER.joint.training)


def speed(cell: Workcell, segments: Segments, rounds: int) -> list[dict]:
    """Training steps per second of both presets and of the rival, in so many turns."""
    runs, rows = {}, []
    for name, preset in (("paper", PAPER), ("default", DEFAULT)):
        config = preset.joint
        env, net = joint.make_env(cell, segments, config), joint.make_net(cell, config)
        programs = make_programs(env, net, config.training)
        state = [programs.start((0,))]

        def advance(programs=programs, state=state):
            state[0], metrics = programs.advance(state[0])
            return metrics

        advance()
        runs[name] = (advance, config.training.steps_per_iteration)
    other = rival(cell, segments)
    if other:
        runs["sb3"] = (other.train, other.rollout)
    best = race(runs, rounds)
    for name in ("paper", "default"):
        rows.append(
            metric(
                f"drl.train_{name}_steps_per_second",
                best[name],
                "1/s",
                "higher",
                "environment steps with learning, one seed",
            )
        )
    if other:
        note = "Stable-Baselines3 + PyBullet, the paper's sizes"
        rows.append(metric("drl.sb3_steps_per_second", best["sb3"], "1/s", "higher", note))
        rows.append(
            metric(
                "drl.sb3_env_steps_per_second",
                other.world_steps_per_second(),
                "1/s",
                "higher",
                "PyBullet's environment alone",
            )
        )
        for name, note in (
            ("paper", "the same environment and sizes"),
            ("default", "the rival as before, ours in its own environment and sizes"),
        ):
            rows.append(
                metric(
                    f"drl.train_{name}_vs_sb3",
                    best[name] / best["sb3"],
                    "1",
                    "higher",
                    f"environment steps/s with learning, in turns; {note}",
                )
            )
    return rows


def draw(path: Path, paper: dict[str, Curve], default: Curve) -> None:
    """Total reward and success against steps: means over seeds and their 95 % intervals."""
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.2), layout="constrained")
    limit = next(iter(paper.values())).steps[-1]
    for axes, rows in ((left, "total_reward"), (right, "success")):
        named = [(f"{name}, preset paper", curve) for name, curve in paper.items()]
        if rows == "success":
            named.append(("DRL-Feasibility, preset default", default))
        for name, curve in named:
            found = [
                interval(v[np.isfinite(v)]) if np.isfinite(v).any() else (np.nan, np.nan)
                for v in getattr(curve, rows)
            ]
            mean, half = np.array(found).T
            steps = np.array(curve.steps)
            inside = steps <= limit
            line = axes.plot(steps[inside], mean[inside], label=name)
            low, high = (mean - half)[inside], (mean + half)[inside]
            axes.fill_between(steps[inside], low, high, alpha=0.25, color=line[0].get_color())
        axes.set(xlabel="environment steps")
        axes.grid(alpha=0.3)
    left.set(ylabel="total reward of an episode", title="What the paper shows: rewards differ")
    left.set_yscale("symlog", linthresh=10)
    right.set(ylabel="share of episodes", ylim=(-0.02, 1.02), title="Ended in the target, free")
    right.legend(loc="lower right", fontsize=8)
    figure.savefig(path, dpi=110)
    plt.close(figure)


PARTS = ("speed", "default", "paper", "ablation")
"""What the benchmark consists of, in order."""


def main(
    json: Path | None = None,
    picture: Path | None = None,
    problems: Path | None = None,
    parts: tuple[Literal["speed", "default", "paper", "ablation"], ...] = PARTS,
    steps: int = 1_000_000,
    seeds: int = 5,
    ablation_seeds: int = 3,
    test: int = drl_problems.HELD_OUT,
    tiny: bool = False,
) -> None:
    """Print all figures.

    Args:
        json: file to write them to, after each part.
        picture: learning curves to draw; they need the parts default and paper.
        problems: file to keep the segments in, or to take them from.
        parts: which to run.
        steps: of each training of preset paper, and of half of preset default's.
        seeds: trainings of each agent.
        ablation_seeds: trainings of each variant of the environment.
        test: held-out segments, 500 at most.
        tiny: as little of everything as shows that it runs.
    """
    hj.use_all_cores()
    cell, sizes = load_workcell("gen3_handling"), drl_problems.Sizes()
    if tiny:
        sizes, steps, seeds, ablation_seeds, test = drl_problems.TINY, 16_384, 1, 1, 8
    found = drl_problems.problems(cell, problems, sizes)
    found = found.replace(held_out=take(found.held_out, slice(test)))
    numbers, curves = tuple(range(seeds)), {}

    def default():
        rows, curves["default"] = drl_default.figures(cell, found, numbers, steps)
        return rows

    def paper():
        rows, curves["paper"] = drl_study.figures(cell, found, numbers, steps)
        return rows

    runs = {
        "speed": lambda: speed(cell, found.training, 1 if tiny else 8),
        "default": default,
        "paper": paper,
        "ablation": lambda: drl_ablation.figures(
            cell, found, numbers[:ablation_seeds], steps, few=tiny
        ),
    }
    rows = []
    for part in PARTS:
        if part in parts:
            rows += runs[part]()
            write(rows, json, drl_problems.SEEDS)
    if picture and len(curves) == 2:
        draw(picture, curves["paper"], curves["default"])


if __name__ == "__main__":
    tyro.cli(main)
