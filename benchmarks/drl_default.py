# SPDX-License-Identifier: MIT
"""Preset `default`: how fast it trains, what it solves, and how long a call at planning time takes.

A segment counts as solved only if the function that the planner calls returns a path for it: every
edge of that path is proven free, and it ends at the goal (within 1 cm and 2 degrees to close with
the goal itself).
"""

import time
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec

from benchmarks import drl_trainings
from benchmarks.drl_problems import Problems
from benchmarks.report import interval, metric, rate
from hybrid_jax.agents import joint
from hybrid_jax.agents.joint import JointAgentConfig
from hybrid_jax.agents.joint_bridger import make_bridger
from hybrid_jax.agents.trainers import make_programs
from hybrid_jax.contracts import Segments, take
from hybrid_jax.envs import base
from hybrid_jax.envs.reach import ReachEnv
from hybrid_jax.runs.presets import DEFAULT
from hybrid_jax.runtime.compiler_options import vector_options
from hybrid_jax.types import Workcell

CONFIG = DEFAULT.joint
SINGLE = replace(CONFIG, rollouts=(1,), candidates=1)
"""One rollout, of the policy's mode."""
MANY = replace(CONFIG, rollouts=(64,))
"""One call of the planner's function."""
TIMED = 100
"""Segments of the test whose calls are timed."""


def solved(bridge, segments: Segments) -> tuple[np.ndarray, np.ndarray]:
    """Which segments the agent solves alone, and the time of each call [s].

    Args:
        bridge: from `make_bridger`.
        segments: to be solved one after the other.
    """
    found, seconds = [], []
    for i in range(segments.start.shape[0]):
        one = take(segments, slice(i, i + 1))
        began = time.perf_counter()
        path = bridge(one, jax.random.key(i))[0]
        seconds.append(time.perf_counter() - began)
        found.append(path is not None)
    return np.array(found), np.array(seconds)


def rollout_seconds(cell: Workcell, net, policy, segments: Segments, enough: int | None):
    """Times of 64 rollouts of one segment, compiled [s]."""
    spread, index = joint.spreads(64), jnp.zeros(64, int)

    @jax.jit
    def run(policy, one, key):
        env = joint.planning_env(cell, one, CONFIG)
        return joint.rollouts(env, net, policy, index, spread, key, enough)

    seconds = []
    for i in range(-1, min(TIMED, segments.start.shape[0])):
        one = take(segments, slice(max(i, 0), max(i, 0) + 1))
        began = time.perf_counter()
        jax.block_until_ready(run(policy, one, jax.random.key(i)))
        seconds.append(time.perf_counter() - began)
    return np.array(seconds[1:])  # the first one compiles


def environment_rate(env: ReachEnv) -> float:
    """Steps per second without learning: random actions, every device."""
    devices, config = jax.local_devices(), CONFIG.training
    mesh, split = Mesh(np.array(devices), ("copies",)), PartitionSpec("copies")

    def run(keys):
        def choose(obs, key):
            shape = (obs.shape[0], env.action_size)
            return jax.random.uniform(key, shape, minval=-1, maxval=1), {}

        key_start, key = jax.random.split(keys[0])
        copies = base.start_copies(env, key_start, config.envs // len(devices))
        copies, _ = base.rollout(env, choose, copies, key, env.config.horizon)
        return copies.obs

    spread = jax.shard_map(run, mesh=mesh, in_specs=split, out_specs=split, check_vma=False)
    compiled, keys = (
        jax.jit(spread, compiler_options=vector_options()),
        jax.random.split(jax.random.key(0), len(devices)),
    )
    steps = config.envs // len(devices) * len(devices) * env.config.horizon
    return max(rate(lambda: compiled(keys), steps, 2.0)[0] for _ in range(3))


def train(cell: Workcell, segments: Segments, seeds: tuple[int, ...], config: JointAgentConfig):
    """One seed after the other: final policies, policies after half, curves, seconds of each.

    The first training's time holds its compiling; nothing is cached between runs.
    """
    began = time.perf_counter()
    env, net = joint.make_env(cell, segments, config), joint.make_net(cell, config)
    programs = make_programs(env, net, config.training)
    half, ends, halves, curves, seconds = config.training.iterations // 2, [], [], [], []
    for seed in seeds:
        middle, first = drl_trainings.advance(programs, programs.start((seed,)), half)
        end, second = drl_trainings.advance(programs, middle, config.training.iterations)
        jax.block_until_ready(end)
        seconds.append(time.perf_counter() - began)
        ends.append(end.policy())
        halves.append(middle.policy())
        curves.append((first, second))
        print(f"default: seed {seed} trained in {seconds[-1]:.0f} s", flush=True)
        began = time.perf_counter()
    return net, ends, halves, curves, seconds


def share(name: str, values, note: str) -> dict:
    """A share over seeds as a row."""
    mean, half = interval(values)
    lowest = f"+- {half:.3f}, lowest {min(values):.3f} of {len(values)} seeds; {note}"
    return metric(f"drl.{name}", mean, "1", "higher", lowest)


def merged(curves) -> drl_trainings.Curve:
    """One curve with a column for each seed."""
    whole = [
        (
            first.steps + second.steps,
            first.total_reward + second.total_reward,
            first.success + second.success,
        )
        for first, second in curves
    ]
    steps, rewards, success = zip(*whole, strict=True)
    join = lambda rows: [np.concatenate(row) for row in zip(*rows, strict=True)]  # noqa: E731
    return drl_trainings.Curve(steps[0], join(rewards), join(success))


def figures(
    cell: Workcell, problems: Problems, seeds: tuple[int, ...], steps: int
) -> tuple[list[dict], drl_trainings.Curve]:
    """Rows of the preset, and its curve; `steps` is half of what it trains for."""
    config = replace(CONFIG, training=replace(CONFIG.training, steps=2 * steps))
    net, ends, halves, curves, seconds = train(cell, problems.training, seeds, config)
    test, tests = problems.held_out, f"{problems.held_out.start.shape[0]} segments"
    alone = lambda policy: make_bridger(cell, policy, SINGLE)  # noqa: E731
    best = lambda policy: make_bridger(cell, policy, MANY)  # noqa: E731
    one = [solved(alone(p), test)[0].mean() for p in ends]
    early = [solved(alone(p), test)[0].mean() for p in halves]
    many, calls = zip(*(solved(best(p), test) for p in ends), strict=True)
    calls = np.concatenate([c[1:] for c in calls])
    enough = int(64 * CONFIG.enough)
    strict = rollout_seconds(cell, net, ends[0], test, None)
    quick = rollout_seconds(cell, net, ends[0], test, enough)
    env = joint.make_env(cell, problems.training, config)
    rows = [
        metric(
            "drl.train_default_seconds",
            seconds[0],
            "s",
            "lower",
            f"{2 * steps:,} steps with compiling; each further seed "
            f"{np.median(seconds[1:] or [np.nan]):.0f} s",
        ),
        metric(
            "drl.env_steps_per_second",
            environment_rate(env),
            "1/s",
            "higher",
            "no learning, random actions",
        ),
        share("heldout_success_64", [m.mean() for m in many], f"best of 64 rollouts, {tests}"),
        share("heldout_success_1", one, f"one deterministic rollout, {tests}"),
        share(f"heldout_success_1_at_{steps}", early, "after as many steps as preset paper"),
        metric(
            "drl.rollouts_64_seconds",
            float(np.median(strict)),
            "s",
            "lower",
            f"every rollout to its end; p95 {np.quantile(strict, 0.95):.4f}",
        ),
        metric(
            "drl.rollouts_64_seconds_enough",
            float(np.median(quick)),
            "s",
            "lower",
            f"until {enough} have arrived, as the planner calls it; "
            f"p95 {np.quantile(quick, 0.95):.4f}",
        ),
        metric(
            "drl.bridge_seconds",
            float(np.median(calls)),
            "s",
            "lower",
            f"the whole call: 64 rollouts, ranking, exact check; "
            f"p95 {np.quantile(calls, 0.95):.4f}",
        ),
    ]
    return rows, merged(curves)
