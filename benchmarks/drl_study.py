# SPDX-License-Identifier: MIT
"""The paper's comparison: DRL-Feasibility, pure PPO and pure SAC under preset `paper`.

All three train on the same segments for the same steps; they differ in reward and algorithm, as
the paper says, and the pure ones learn from infeasible transitions too: only DRL-Feasibility drops
them. The paper gives them "an additional reward when goal is reached to maintain a similar scale",
and no number: here it is what feasibility earns in a whole episode at home. SAC's table is not in
the paper: its layers are as wide as the others', and it makes a gradient step for each step of the
environment, as its authors do. That takes so long that fewer of its seeds are trained.
"""

import queue
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks import drl_trainings
from benchmarks.drl_problems import Problems
from benchmarks.report import interval, metric
from hybrid_jax.agents import joint, networks
from hybrid_jax.agents.joint import JointAgentConfig
from hybrid_jax.agents.sac import SacConfig
from hybrid_jax.contracts import Segments
from hybrid_jax.envs import base
from hybrid_jax.envs.paper_reach import LITERAL
from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels.collision.motion_validation import edge_is_free
from hybrid_jax.kernels.kinematics import tool_pose
from hybrid_jax.runs.presets import PAPER
from hybrid_jax.types import Workcell

SAC_SEEDS = 2
"""Trainings of SAC, at most."""
PURE = replace(LITERAL, reward="distance", drop_infeasible=False, arrival=float(LITERAL.horizon))
AGENTS = {
    "DRL-Feasibility": replace(PAPER.joint, reach=LITERAL),
    "pure PPO": replace(PAPER.joint, reach=PURE),
    "pure SAC": JointAgentConfig(
        training=SacConfig(updates=SacConfig().steps_per_iteration), reach=PURE
    ),
}
KEYS = {"DRL-Feasibility": "feasibility", "pure PPO": "pure_ppo", "pure SAC": "pure_sac"}


@dataclass(frozen=True)
class Outcome:
    """What one policy does on the held-out segments, following its mode."""

    arrived: float
    """Share within 25 cm before the time is up."""
    clean: float
    """Share that arrives, every configuration on the way free."""
    swept: float
    """Share that arrives, every straight way between two configurations proven free as well."""
    collisions: float
    """Share of the visited configurations that collide."""
    turned: float
    """Median rotation error where it arrives [rad]."""


@jax.jit
def _free_ways(cell: Workcell, scenes, starts, ends):
    return jax.vmap(lambda scene, a, b: edge_is_free(cell.replace(scene=scene), a, b)[0])(
        scenes, starts, ends
    )


def ways_are_free(cell: Workcell, segments: Segments, index, starts, ends) -> np.ndarray:
    """Whether the straight way of each pair, in the scene of a segment, is proven free."""
    free, size = np.ones(len(index), bool), 512
    for low in range(0, len(index), size):
        part = np.minimum(np.arange(low, low + size), len(index) - 1)  # one shape, one program
        scene = jax.tree.map(lambda a, i=index[part]: a[i], segments.scene)
        free[part] = np.asarray(_free_ways(cell, scene, starts[part], ends[part]))
    return free


def judge(
    cell: Workcell, net: networks.ActorCritic, config: JointAgentConfig, segments: Segments
) -> Callable[[networks.Policy], Outcome]:
    """A function of a policy; it compiles once."""
    count = segments.start.shape[0]
    env = joint.make_env(cell, segments, config)

    @jax.jit
    def run(policy):
        def step(carry, _):
            state, over = carry
            action = networks.act(net, policy, jax.vmap(env.observe)(state), None)
            move = jax.vmap(env.step)(state, action)
            state = base.choose_states(over, state, move.state)
            return (state, over | move.terminated), (state.q, over, move.info["collision"])

        start = jax.vmap(env.start)(jnp.arange(count), segments.start), jnp.zeros(count, bool)
        (state, arrived), rows = jax.lax.scan(step, start, length=config.reach.horizon)
        tool = jax.vmap(tool_pose, (None, 0))(cell, state.q)
        sine = jnp.linalg.norm(dq.mul(dq.conj(tool), env.goal_pose)[:, 1:4], axis=1)
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
    """Every agent: as many at once as there are devices, each on one of its own."""
    devices = queue.SimpleQueue()
    for device in jax.local_devices():
        devices.put(device)

    def one(job):
        name, config = job
        config = replace(config, training=replace(config.training, steps=steps))
        own = seeds[:SAC_SEEDS] if isinstance(config.training, SacConfig) else seeds
        env, net = joint.make_env(cell, problems.training, config), joint.make_net(cell, config)
        device = devices.get()
        with jax.default_device(device):
            trained = drl_trainings.run(env, net, config.training, own, [device])
        devices.put(device)
        print(f"{name}: {len(own)} x {steps:,} steps in {trained.seconds:.0f} s", flush=True)
        return name, trained

    with ThreadPoolExecutor(jax.local_device_count()) as pool:
        return dict(pool.map(one, list(AGENTS.items())[::-1]))  # the slowest first


def figures(
    cell: Workcell, problems: Problems, seeds: tuple[int, ...], steps: int
) -> tuple[list[dict], dict[str, drl_trainings.Curve]]:
    """Rows of all agents, and their curves."""
    trained, rows = train_all(cell, problems, seeds, steps), []
    for name, config in AGENTS.items():
        outcome = judge(cell, joint.make_net(cell, config), config, problems.held_out)
        found = [outcome(policy) for policy in trained[name].policies]
        spread = f"preset paper, {len(found)} seeds, {steps:,} steps"
        for what, unit, better, text in (
            ("arrived", "1", "higher", "within 25 cm of the goal"),
            ("clean", "1", "higher", "the same, every configuration free"),
            ("swept", "1", "higher", "the same, and the straight ways between them"),
            ("collisions", "1", "lower", "share of visited configurations"),
            ("turned", "rad", "lower", "median rotation error on arrival"),
        ):
            values = [v for v in (getattr(o, what) for o in found) if np.isfinite(v)]
            mean, half = interval(values or [np.nan])
            text += "" if len(values) == len(found) else f" ({len(values)} seeds arrive at all)"
            rows.append(
                metric(
                    f"drl.{KEYS[name]}_{what}",
                    mean,
                    unit,
                    better,
                    f"+- {half:.3f}; {text}; {spread}",
                )
            )
    return rows, {name: trained[name].curve for name in AGENTS}
