# SPDX-License-Identifier: MIT
"""The switching agent over 10,000 episodes, and preset `default`'s, against optimum and rule.

    python -m benchmarks.switching --json FILE --picture PNG

Five seeds each, on the same phases of training tasks, which are those of a trained joint agent; the
optimum is the exact one of the same reward (Viterbi). About ten minutes on two cores.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np
import tyro
from scipy import stats

import hybrid_jax as hj
from benchmarks import drl_trainings
from benchmarks.planning_methods import (
    SWITCH_TEST,
    optimal_returns,
    phases_of,
    problems,
    trained_run,
)
from benchmarks.report import interval, metric, write
from hybrid_jax.agents import switching
from hybrid_jax.agents.switching import SwitchConfig
from hybrid_jax.contracts import STEPS, Combined
from hybrid_jax.runs.load_planner import load_planner
from hybrid_jax.runs.presets import PRESETS
from hybrid_jax.runs.seeds import BENCHMARK_TRAINING, SWITCHING_TEST

SEEDS = tuple(range(5))
SWITCH_TASKS = 24
"""Training tasks whose phases the agents see."""


@dataclass(frozen=True)
class Study:
    """One preset's agent."""

    episodes: np.ndarray
    """`[point]` episodes of 200 steps so far; an epoch of the paper has 200 of them."""
    returns: np.ndarray
    """`[point, seed]` mean of the episodes that ended since the point before."""
    best: float
    """Mean return of the optimal choices on the training phases."""
    optimality: np.ndarray
    """`[seed]` mean return on unseen phases, over that of their optimum."""
    rule: float
    """The same of the rule: the joint agent wherever it has a motion."""
    infeasible: np.ndarray
    """`[seed]` share of the unseen phases' points that are chosen where they are infeasible, ..."""
    least: float
    """... and the share that the optimum leaves."""
    switches: np.ndarray
    """`[seed]` changes of the source in a phase."""
    seconds: float


def chosen(problems: Combined, choice: np.ndarray) -> tuple[float, float]:
    """Share of infeasible points, and changes of the source, of choices `[problem, STEPS]`."""
    bad = np.take_along_axis(np.asarray(problems.collision), choice[:, None], axis=1)
    return float(bad.mean()), float(np.abs(np.diff(choice, axis=1)).sum(axis=1).mean())


def settings(name: str, tiny: bool) -> SwitchConfig:
    """Of a preset; with a short training to see that it runs."""
    config = PRESETS[name].switch
    return replace(config, training=PRESETS["smoke"].switch.training) if tiny else config


def rule_return(test: Combined, config: SwitchConfig) -> float:
    """Mean return of the joint agent wherever it has a motion."""
    each = jax.vmap(lambda one: switching.episode_return(one, one.available, config))
    return float(each(test).mean())


def study(
    config: SwitchConfig, training: Combined, test: Combined, seeds: tuple[int, ...] = SEEDS
) -> Study:
    """Train all seeds of one preset and try them on unseen phases."""
    net = switching.make_net(training.q.shape[-1], config)
    env = switching.SwitchEnv(training, config)
    trained = drl_trainings.run(env, net, config.training, seeds)
    run = jax.jit(lambda policy: switching.choose(net, policy, test, config))
    answers = [jax.device_get(run(policy)) for policy in trained.policies]
    picks = [chosen(test, choice) for choice, _ in answers]
    exact = np.stack([switching.optimal_switching(one, config)[0] for one in problems(test)])
    return Study(
        episodes=np.array(trained.curve.steps) / STEPS,
        returns=np.array(trained.curve.total_reward) / config.scale,
        best=float(optimal_returns(training, config).mean()),
        optimality=np.array([r.mean() for _, r in answers]) / optimal_returns(test, config).mean(),
        rule=rule_return(test, config) / float(optimal_returns(test, config).mean()),
        infeasible=np.array([share for share, _ in picks]),
        least=chosen(test, exact)[0],
        switches=np.array([count for _, count in picks]),
        seconds=trained.seconds,
    )


def rows(name: str, found: Study, count: int) -> list[dict]:
    """Figures of one preset."""
    mean, half = interval(found.optimality)
    bad, bad_half = interval(found.infeasible)
    return [
        metric(
            f"switching.{name}_optimality",
            mean,
            "1",
            "higher",
            f"+- {half:.4f}, {len(found.optimality)} seeds, lowest "
            f"{found.optimality.min():.4f}; {count} unseen phases",
        ),
        metric(
            f"switching.{name}_rule_optimality",
            found.rule,
            "1",
            "higher",
            "the rule: the joint agent wherever it has a motion",
        ),
        metric(
            f"switching.{name}_infeasible",
            bad,
            "1",
            "lower",
            f"+- {bad_half:.4f}; share of points; the optimum leaves {found.least:.4f}",
        ),
        metric(
            f"switching.{name}_switches",
            float(found.switches.mean()),
            "1",
            "lower",
            "changes of the source in a phase",
        ),
        metric(
            f"switching.{name}_seconds",
            found.seconds,
            "s",
            "lower",
            f"all seeds, {found.episodes[-1]:.0f} episodes",
        ),
    ]


def draw(path: Path, studies: dict[str, Study]) -> None:
    """Return over episodes, mean of the seeds and its 95 % interval, and the optimum."""
    fig, axes = plt.subplots(
        1, len(studies), figsize=(5.5 * len(studies), 3.6), layout="constrained"
    )
    for axis, (name, found) in zip(np.atleast_1d(axes), studies.items(), strict=True):
        mean, spread = found.returns.mean(axis=1), found.returns.std(axis=1, ddof=1)
        half = stats.t.ppf(0.975, len(SEEDS) - 1) * spread / np.sqrt(len(SEEDS))
        axis.fill_between(found.episodes, mean - half, mean + half, alpha=0.25, lw=0)
        axis.plot(found.episodes, mean, lw=1.4, label=f"PPO, mean of {len(SEEDS)} seeds")
        axis.axhline(found.best, color="black", ls="--", lw=1, label="optimum (Viterbi)")
        axis.set(
            xlabel="episodes of 200 steps", ylabel="return of an episode", title=f"preset {name}"
        )
        axis.grid(alpha=0.3)
        axis.legend(loc="lower right")
    fig.savefig(path, dpi=110)
    plt.close(fig)


def main(
    json: Path | None = None,
    picture: Path | None = None,
    run: Path | None = None,
    tiny: bool = False,
) -> None:
    """Print all figures.

    Args:
        json: file to write them to.
        picture: PNG to draw the training curves in.
        run: folder of a trained run of the handling cell; one is trained if not given.
        tiny: as little of everything as shows that it runs.
    """
    hj.use_all_cores()
    tasks, unseen, seeds = (2, 2, SEEDS[:2]) if tiny else (SWITCH_TASKS, SWITCH_TEST, SEEDS)
    with trained_run(run, tiny) as opened:
        planner = load_planner(opened, switch="optimal")
        training = phases_of(planner, BENCHMARK_TRAINING[:tasks])
        test = phases_of(planner, SWITCHING_TEST[:unseen])
    studies = {
        name: study(settings(name, tiny), training, test, seeds) for name in ("paper", "default")
    }
    count = len(test.available)
    drawn = {"BENCHMARK_TRAINING": BENCHMARK_TRAINING, "SWITCHING_TEST": SWITCHING_TEST}
    found = [row for name, one in studies.items() for row in rows(name, one, count)]
    write(found, json, drawn)
    if picture:
        draw(picture, studies)


if __name__ == "__main__":
    tyro.cli(main)
