# SPDX-License-Identifier: MIT
"""Make or load the programs that planning takes in a cell, before anybody waits for them."""

from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from hybrid_jax.agents import joint, networks, switching
from hybrid_jax.agents.joint_bridger import make_bridger
from hybrid_jax.agents.joint_rollouts import make_explorer
from hybrid_jax.contracts import Segments
from hybrid_jax.kernels.argument_checks import single_precision
from hybrid_jax.planner.pipeline import plan_batch
from hybrid_jax.planner.point_to_point import plan_joint_motion
from hybrid_jax.planner.records import Planner
from hybrid_jax.runs.load_planner import untrained_planner
from hybrid_jax.runs.presets import Preset
from hybrid_jax.tasks.registry import random_task
from hybrid_jax.types import Workcell

BATCH = 16
"""Tasks of a batch: larger ones take the same programs."""
ANY_MANIPULABILITY = 1e-3
"""A scale in which every configuration is far from singular: the tasks are planned to their end."""
NEAR = 0.05
"""Distance over which a motion is planned [rad or m]."""


@single_precision
def blank_planner(cell: Workcell, preset: Preset) -> Planner:
    """A planner with agents that were never trained: its programs are those of every run.

    Args:
        cell: robot, fixtures and objects.
        preset: settings of the run.
    """
    net, joints = joint.make_net(cell, preset.joint), cell.home.size
    blank = _blank_policy(net, joint.observation_length(cell, preset.joint))
    if preset.planner.handover:
        agent = {"explore": make_explorer(cell, blank, preset.joint)}
    else:
        agent = {"bridge": make_bridger(cell, blank, preset.joint)}
    switch_net = switching.make_net(joints, preset.switch)
    observed = switching.SwitchEnv.observation_length(joints)
    switch = switching.make_switcher(_blank_policy(switch_net, observed), preset.switch)
    planner = untrained_planner(cell, ANY_MANIPULABILITY, preset.planner)
    return replace(planner, **agent, switch=switch)


def _blank_policy(net: networks.ActorCritic, observations: int) -> networks.Policy:
    """A policy as one that was read from a file: arrays only."""
    return jax.tree.map(jnp.asarray, networks.blank_policy(net, observations))


def parts(planner: Planner) -> dict[str, Callable[[], object]]:
    """What makes or loads the programs of a planner, by names for a line of progress.

    Args:
        planner: of a run, or a `blank_planner`.

    Returns:
        Functions to be called in this order.
    """
    cell, key = planner.cell, jax.random.key(0)
    home = np.asarray(cell.home)
    near = np.clip(home + NEAR, *np.asarray(cell.joint_limits).T)
    motion = {"a motion": lambda: plan_joint_motion(cell, home, near, key=key)}
    if cell.source.task is None:  # nothing is known of tasks here
        return motion
    tasks = [random_task(cell, seed) for seed in range(BATCH)]
    scenes = jax.tree.map(lambda a: jnp.repeat(jnp.asarray(a)[None], BATCH, axis=0), cell.scene)
    ends = jnp.broadcast_to(cell.home, (BATCH, home.size))
    segments = Segments(scenes, ends, ends)
    named = {
        "one task": lambda: plan_batch(planner, tasks[:1], key=key),
        "a batch of tasks": lambda: plan_batch(planner, tasks, key=key),
    }
    methods = {"joint agent": planner.bridge, "fallback": planner.fallback}
    for name, method in methods.items():
        for count in (1, BATCH):
            if method:
                some = jax.tree.map(lambda a, count=count: a[:count], segments)
                title = f"{name}, {count} gap{'s' * (count > 1)}"
                named[title] = lambda method=method, some=some: method(some, key)
    return named | motion
