# SPDX-License-Identifier: MIT
"""Train the hierarchical DQN on random tasks of both cells; compare with the exact optimum.

An episode is one task from its first key pose to its last, counted over all copies. The policy is
steady from the first episode on after which its greedy return on the held-out tasks stays within
1 % of the optimum's size of where the training ends.
"""

import time
from dataclasses import dataclass, replace
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib
import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from benchmarks.report import metric
from hybrid_jax.agents import dqn, hdqn_networks
from hybrid_jax.demonstrations.scripted_hand import HOVER, on_part, shifted
from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.runs.load_planner import read_library
from hybrid_jax.runs.presets import DEFAULT, PAPER
from hybrid_jax.runs.seeds import LFD_TEST, LFD_TRAINING
from hybrid_jax.skills.costs import MAX_KEY_POSES, SegmentCosts, pad_task, segment_costs
from hybrid_jax.skills.library import SkillConfig, SkillLibrary
from hybrid_jax.skills.task_segmentation import optimal_costs
from hybrid_jax.tasks.registry import random_task
from hybrid_jax.tasks.task import home_pose
from hybrid_jax.types import Workcell
from hybrid_jax.workcell.load import load_workcell

matplotlib.use("Agg")

DRAWN = {"LFD_TRAINING": LFD_TRAINING, "LFD_TEST": LFD_TEST}
"""Ranges that the tasks are drawn from."""


@dataclass(frozen=True)
class Sizes:
    """How much is learned."""

    seeds: int = 5
    tasks: int = 100
    """To train on, and again for the test: handling, inspection and chains of random skills."""
    rounds: int | None = None
    """Of a training; the preset's if None."""


TINY = Sizes(seeds=2, tasks=3, rounds=2)
NEAR = 0.01
"""A policy is steady while its return stays this near, as a share of the optimum."""


def inspection_poses(home: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Home, hover over the tray, start and end of a stroke on a part (paper, FPI); `[4, 8]`."""
    hover = shifted(HOVER, *rng.uniform(-0.02, 0.02, 3))
    x, y = rng.uniform(-0.10, 0.10), rng.uniform(-0.13, 0.13)
    start = on_part(x, y, tilt=rng.uniform(-0.2, 0.2), roll=rng.uniform(-0.25, 0.25))
    along = RigidTransform.from_components(
        [rng.uniform(0.08, 0.16), rng.uniform(-0.03, 0.03), rng.uniform(-0.02, 0.02)],
        Rotation.from_euler("zy", [rng.uniform(-0.9, 0.9), rng.uniform(-0.3, 0.3)]),
    )
    rows = [p.as_dual_quat(scalar_first=True) for p in (hover, start, start * along)]
    return np.stack([home, *rows]).astype(np.float32)


def inspection_row(home: np.ndarray, rng: np.random.Generator):
    """An inspection task as `segment_costs` takes it."""
    poses = inspection_poses(home, rng)
    fill = poses[-1:].repeat(MAX_KEY_POSES - len(poses), 0)
    return np.concatenate([poses, fill]), np.zeros(MAX_KEY_POSES, bool), len(poses)


def chain_row(library: SkillLibrary, home: np.ndarray, rng: np.random.Generator):
    """Three to seven random skills in a row, each with its goal moved at random."""
    count = int(rng.integers(4, MAX_KEY_POSES + 1))
    skills = rng.integers(0, len(library.names), count - 1)
    poses = [jnp.asarray(home)]
    for demo in library.poses[skills]:
        noise = jnp.asarray(rng.normal(size=6) * ([0.06] * 3 + [0.2] * 3), jnp.float32)
        motion = dq.mul(dq.mul(dq.conj(demo[0]), demo[-1]), dq.exp(noise))
        poses.append(dq.normalize(dq.mul(poses[-1], motion)))
    poses += [poses[-1]] * (MAX_KEY_POSES - count)
    carrying = np.zeros(MAX_KEY_POSES, bool)
    carrying[: count - 1] = np.asarray(library.closed)[skills]
    return np.stack(poses), carrying, count


def draw_tasks(cell: Workcell, first: int, config: SkillConfig, count: int) -> SegmentCosts:
    """Tasks of every kind in turn, those that the library covers."""
    library, home = read_library(), home_pose(cell)
    judge = jax.jit(lambda p, c, n: segment_costs(library, p, c, n, config))
    kinds = (
        lambda seed: pad_task(random_task(cell, seed)),
        lambda seed: inspection_row(home, np.random.default_rng(seed)),
        lambda seed: chain_row(library, home, np.random.default_rng(seed)),
    )
    found, seed = [], first
    while len(found) < count:
        costs = judge(*(jnp.asarray(v) for v in kinds[seed % len(kinds)](seed)))
        if np.isfinite(optimal_costs(jax.tree.map(lambda a: a[None], costs))[0]):
            found.append(costs)
        seed += 1
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *found)


def make_training(train: SegmentCosts, test: SegmentCosts, config: dqn.DqnConfig):
    """One whole training as a compiled function of its key.

    It returns the final state and, for each round, the episodes so far, the greedy return on the
    test tasks and the mean reward of the acting copies.
    """
    nets = dqn.make_controllers(config)

    def body(state, _):
        state, metrics = dqn.training_round(nets, config, train, state, None)
        cost = hdqn_networks.greedy_plans(nets, state.params, test)[1]
        cost = jnp.where(jnp.isfinite(cost), cost, dqn.FAILURE)
        return state, (state.episodes, -jnp.mean(cost), metrics["reward"])

    return jax.jit(
        lambda key: jax.lax.scan(body, dqn.initialize(train, config, key), length=config.rounds)
    )


def steady_episode(episodes: np.ndarray, returns: np.ndarray, optimum: float) -> float:
    """First episode after which the return stays near where it ends; see the module's text."""
    away = np.flatnonzero(np.abs(returns - returns[-1]) > NEAR * abs(optimum))
    return float(episodes[away[-1] + 1]) if away.size else float(episodes[0])


def study(name: str, train, test, config: dqn.DqnConfig, seeds: int) -> tuple[list[dict], list]:
    """Figures of one preset over several seeds, and its curves (episodes, returns)."""
    optimum = -float(optimal_costs(test).mean())
    run = make_training(train, test, config)
    began, curves, seconds = time.perf_counter(), [], []
    for key in jax.random.split(jax.random.PRNGKey(config.seed), seeds):
        _, curve = jax.block_until_ready(run(key))
        episodes, returns, _ = (np.asarray(c) for c in curve)
        curves.append((episodes, returns))
        seconds.append(time.perf_counter() - began)
        print(f"DQN{name}: {len(curves)} of {seeds} seeds, {seconds[-1]:.0f} s", flush=True)
    shares = [optimum / returns[-1] for _, returns in curves]
    steady = [steady_episode(*curve, optimum) for curve in curves]
    ends = f"{min(steady):.0f} to {max(steady):.0f}"
    seen = f"{seeds} seeds, lowest {min(shares):.4f}"
    updates = config.rounds * config.updates
    return [
        metric(f"lfd.dqn_optimality{name}", float(np.median(shares)), "1", "higher", seen),
        metric(f"lfd.dqn_steady_episodes{name}", float(np.median(steady)), "1", "lower", ends),
        metric(
            f"lfd.dqn_train_seconds{name}",
            seconds[0],
            "s",
            "lower",
            f"with compiling; {updates} updates, evaluation each round",
        ),
    ], curves


def random_share(tasks: SegmentCosts, rollouts: int = 50) -> float:
    """The optimum's return over that of uniformly random admissible choices; dead ends are redrawn.

    What any choice among admissible skills is worth: the scale for the DQN's figure.
    """
    rng, costs = np.random.default_rng(0), np.asarray(tasks.cost)
    totals = []
    for cost, count in zip(costs, np.asarray(tasks.count), strict=True):
        finished = []
        while len(finished) < rollouts:
            at, total = 0, 0.0
            while at < count - 1 and np.isfinite(cost[at]).any():
                to = rng.choice(np.flatnonzero(np.isfinite(cost[at]).any(axis=-1)))
                total += rng.choice(cost[at, to][np.isfinite(cost[at, to])])
                at = to
            if at == count - 1:
                finished.append(total)
        totals.append(np.mean(finished))
    return float(optimal_costs(tasks).sum() / np.sum(totals))


def draw(path: Path, curves: dict[str, list], optimum: float) -> None:
    """Return against episode, mean and spread over the seeds, for each preset."""
    import matplotlib.pyplot as plt

    fig, ax = plt.subplots(figsize=(6.4, 3.8), layout="constrained")
    for name, runs in curves.items():
        last = min(episodes[-1] for episodes, _ in runs)
        at = np.arange(runs[0][0][0], last + 1)
        values = np.stack([np.interp(at, *run) for run in runs])
        line = ax.plot(at, values.mean(axis=0), label=f"preset {name}, mean of {len(runs)} seeds")
        ax.fill_between(
            at, values.min(axis=0), values.max(axis=0), alpha=0.25, color=line[0].get_color()
        )
    ax.axhline(optimum, color="black", ls="--", lw=1, label="exact optimum")
    ax.set(xlabel="episodes (all copies)", ylabel="greedy return, unseen tasks [m]")
    ax.set_title("Hierarchical DQN of RL-LfD: band from lowest to highest seed")
    ax.grid(alpha=0.3)
    ax.legend(loc="lower right")
    fig.savefig(path, dpi=110)
    plt.close(fig)


def figures(picture: Path | None, sizes: Sizes) -> list[dict]:
    """Figures of the presets `default` and `paper` on the same tasks."""
    cell, config = load_workcell("gen3_handling"), SkillConfig()
    train, test = (
        draw_tasks(cell, some.start, config, sizes.tasks) for some in (LFD_TRAINING, LFD_TEST)
    )
    note = "uniformly random admissible choices: the scale of the rows below"
    out = [metric("lfd.random_optimality", random_share(test), "1", "higher", note)]
    curves = {}
    for name, preset in (("default", DEFAULT), ("paper", PAPER)):
        agent = replace(preset.dqn, rounds=sizes.rounds or preset.dqn.rounds)
        suffix = "" if name == "default" else "_paper"
        found, curves[name] = study(suffix, train, test, agent, sizes.seeds)
        out += found
    if picture:
        draw(picture, curves, -float(optimal_costs(test).mean()))
    return out
