# SPDX-License-Identifier: MIT
"""The paper's comparison: DRL-Feasibility, pure PPO and pure SAC under preset `paper`.

All three train on the same segments for the same steps; they differ in reward and algorithm, as
the paper says. SAC's table is not in the paper: it has the networks of the others, and as many
samples pass through its gradient steps as through PPO's (ten to a step).
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks import drl_trainings
from benchmarks.drl_problems import Problems
from benchmarks.report import interval, metric
from hybrid_jax.agents import joint, networks, worlds
from hybrid_jax.agents.joint import JointAgentConfig
from hybrid_jax.agents.sac import SacConfig
from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels.collision import edge_clearance
from hybrid_jax.kernels.kinematics import tool_pose
from hybrid_jax.planner.harvest import Segments
from hybrid_jax.presets import PAPER
from hybrid_jax.simulation.paperreach import PaperReachConfig
from hybrid_jax.types import Workcell

PURE = PaperReachConfig(reward="distance", drop_infeasible=False)
AGENTS = {
    "DRL-Feasibility": PAPER.joint,
    "pure PPO": replace(PAPER.joint, reach=PURE),
    "pure SAC": JointAgentConfig(training=SacConfig(), reach=PURE),
}
KEYS = {"DRL-Feasibility": "feasibility", "pure PPO": "pure_ppo", "pure SAC": "pure_sac"}
EDGE_SAMPLES = 40
"""Configurations at which the straight way between two actions is checked."""


@dataclass(frozen=True)
class Outcome:
    """What one policy does on the held-out segments, following its mode."""

    arrived: float
    """Share within 25 cm before the time is up."""
    clean: float
    """Share that arrives, every configuration on the way free."""
    swept: float
    """Share that arrives, every straight way between two configurations free as well."""
    collisions: float
    """Share of the visited configurations that collide."""
    turned: float
    """Median rotation error where it arrives [rad]."""


def ways_are_free(cell: Workcell, segments: Segments, index, starts, ends) -> np.ndarray:
    """Whether the straight way of each pair, in the scene of a segment, is free at all samples."""
    check = jax.jit(jax.vmap(lambda scene, a, b: edge_clearance(
        cell.replace(scene=scene), a, b, EDGE_SAMPLES)))  # fmt: skip
    free, size = np.ones(len(index), bool), 512
    for low in range(0, len(index), size):
        part = np.minimum(np.arange(low, low + size), len(index) - 1)  # one shape, one program
        scene = jax.tree.map(lambda a, i=index[part]: a[i], segments.scene)
        free[part] = np.asarray(check(scene, starts[part], ends[part])) >= 0
    return free


def judge(
    cell: Workcell, net: networks.ActorCritic, config: JointAgentConfig, segments: Segments
) -> Callable[[networks.Policy], Outcome]:
    """A function of a policy; it compiles once."""
    count = segments.start.shape[0]
    world = joint.make_world(cell, segments, config)

    @jax.jit
    def run(policy):
        def step(carry, _):
            state, over = carry
            action = networks.act(net, policy, jax.vmap(world.observe)(state), None)
            move = jax.vmap(world.step)(state, action)
            state = worlds.choose_states(over, state, move.state)
            return (state, over | move.terminated), (state.q, over, move.facts["collision"])

        start = jax.vmap(world.start)(jnp.arange(count), segments.start), jnp.zeros(count, bool)
        (state, arrived), rows = jax.lax.scan(step, start, length=config.reach.horizon)
        tool = jax.vmap(tool_pose, (None, 0))(cell, state.q)
        sine = jnp.linalg.norm(dq.mul(dq.conj(tool), world.goal_pose)[:, 1:4], axis=1)
        return arrived, 2 * jnp.arcsin(jnp.clip(sine, 0, 1)), rows

    def outcome(policy):
        arrived, turned, (q, over, hit) = jax.device_get(run(policy))
        clean = arrived & (np.where(over, 0, hit).sum(axis=0) == 0)
        before = np.concatenate([np.asarray(segments.start)[None], q[:-1]])
        moved = ~over & clean  # the ways of those that hit something need no look
        step, index = np.nonzero(moved)
        free = ways_are_free(cell, segments, index, before[step, index], q[step, index])
        swept = clean.copy()
        swept[index[~free]] = False
        return Outcome(
            arrived=float(arrived.mean()),
            clean=float(clean.mean()),
            swept=float(swept.mean()),
            collisions=float(hit[~over].mean()),
            turned=float(np.median(turned[arrived])) if arrived.any() else float("nan"),
        )

    return outcome


def train_all(
    cell: Workcell, problems: Problems, seeds: tuple[int, ...], steps: int
) -> dict[str, drl_trainings.Trained]:
    """Every agent: those of one turn side by side, each on a device of its own."""
    devices = jax.local_devices()

    def one(job):
        place, (name, config) = job
        config = replace(config, training=replace(config.training, steps=steps))
        world, net = joint.make_world(cell, problems.training, config), joint.make_net(cell, config)
        device = devices[place % len(devices)]
        with jax.default_device(device):
            trained = drl_trainings.run(world, net, config.training, seeds, [device])
        print(f"{name}: {len(seeds)} x {steps:,} steps in {trained.seconds:.0f} s", flush=True)
        return name, trained

    with ThreadPoolExecutor(len(devices)) as pool:
        # the slowest first, beside one of the others
        return dict(pool.map(one, enumerate(list(AGENTS.items())[::-1])))


def figures(
    cell: Workcell, problems: Problems, seeds: tuple[int, ...], steps: int
) -> tuple[list[dict], dict[str, drl_trainings.Curve]]:
    """Rows of all agents, and their curves."""
    trained, rows = train_all(cell, problems, seeds, steps), []
    for name, config in AGENTS.items():
        outcome = judge(cell, joint.make_net(cell, config), config, problems.held_out)
        found = [outcome(policy) for policy in trained[name].policies]
        spread = f"preset paper, {len(seeds)} seeds, {steps:,} steps"
        for what, unit, better, text in (
            ("arrived", "1", "higher", "within 25 cm of the goal"),
            ("clean", "1", "higher", "the same, every configuration free"),
            ("swept", "1", "higher", "the same, and the straight ways between them"),
            ("collisions", "1", "lower", "share of visited configurations"),
            ("turned", "rad", "lower", "median rotation error on arrival"),
        ):
            values = [getattr(o, what) for o in found]
            mean, half = interval([v for v in values if np.isfinite(v)] or [np.nan])
            rows.append(metric(f"drl.{KEYS[name]}_{what}", mean, unit, better,
                               f"+- {half:.3f}; {text}; {spread}"))  # fmt: skip
    return rows, {name: trained[name].curve for name in AGENTS}
