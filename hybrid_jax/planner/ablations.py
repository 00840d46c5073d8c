# SPDX-License-Identifier: MIT
"""The planner with parts left out, or replaced by something that learned nothing.

What a part is worth shows by what is lost without it. Everything else stays: configurations and
routes that are tried, smoothing, timing and the check.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from jax import Array

from hybrid_jax.agents import joint, networks
from hybrid_jax.agents.joint import Bridger
from hybrid_jax.agents.segments import Segments
from hybrid_jax.agents.switching import Combined
from hybrid_jax.errors import InputError, UnknownNameError
from hybrid_jax.kernels.edges import paths_are_free
from hybrid_jax.kernels.inputs import single_precision
from hybrid_jax.keys import split
from hybrid_jax.planner.bridging import rrt_bridger
from hybrid_jax.planner.lfd import SkillChooser
from hybrid_jax.planner.loading import optimal_switcher
from hybrid_jax.planner.pipeline import SEARCHED, plan_batch
from hybrid_jax.planner.records import Planner, PlanResult
from hybrid_jax.presets import Preset
from hybrid_jax.rrt import RrtConfig
from hybrid_jax.skills.task import Task
from hybrid_jax.types import Workcell

ABLATIONS = {
    "rrt": "RRT-Connect in the joint agent's place",
    "untrained": "a joint agent that was never trained",
    "straight": "the straight joint line in the joint agent's place",
    "rule": "the joint agent wherever it has a motion, in the switching agent's place",
    "optimal_switch": "exact switching in the switching agent's place",
    "dqn": "the hierarchical DQN in the exact task planner's place",
}
"""What is replaced, by name; RRT-Connect behind the joint agent stays."""


def rule_switcher(combined: Combined) -> np.ndarray:
    """The joint agent wherever it has a motion (a `Switcher`)."""
    return np.asarray(combined.available).astype(int)


def lfd_only(planner: Planner) -> Planner:
    """Skills alone, without bridges (the paper's "LfD")."""
    return replace(planner, bridge=None, config=replace(planner.config, fallback=None))


def joint_agent_only(planner: Planner) -> Planner:
    """The joint agent alone, from key pose to key pose, without skills (the paper's "DRL").

    Raises:
        InputError: the planner has no joint agent.
    """
    if planner.bridge is None:
        raise InputError("the planner has no joint agent")
    config = replace(planner.config, direct=True, fallback=None)
    return replace(planner, switch=rule_switcher, config=config)


@single_precision
def plan_directly(planner: Planner, tasks: Sequence[Task], *, key: Array) -> list[PlanResult]:
    """`plan_batch` for the joint agent alone.

    Its corners are rounded as widely as the hybrid's. Where nothing comes of that they are rounded
    narrowly: the key poses on the way must be passed, and no skill keeps the path near them.

    Args:
        planner: from `joint_agent_only`.
        tasks: what is to be done.
        key: consumed.
    """
    key_wide, key_narrow = split(key, 2)
    found = plan_batch(planner, tasks, key=key_wide)
    left = [i for i, result in enumerate(found) if result.status in SEARCHED]
    if left:
        kept = planner.config.smoothing.kept
        smoothing = replace(planner.config.smoothing, widths=(kept, 0.0))
        narrow = replace(planner, config=replace(planner.config, smoothing=smoothing))
        again = plan_batch(narrow, [tasks[i] for i in left], key=key_narrow)
        for i, result in zip(left, again, strict=True):
            found[i] = result
    return found


def straight_bridger(cell: Workcell) -> Bridger:
    """The straight joint line, where it is proven free."""

    def bridge(segments: Segments, key: Array) -> list[np.ndarray | None]:
        del key
        ends = zip(np.asarray(segments.start), np.asarray(segments.goal), strict=True)
        lines = [np.stack(pair) for pair in ends]
        free = paths_are_free(cell, segments.scene, lines)
        return [line if good else None for line, good in zip(lines, free, strict=True)]

    return bridge


def untrained_bridger(cell: Workcell, config: joint.JointAgentConfig) -> Bridger:
    """The joint agent with random weights, drawn once."""
    net = joint.make_net(cell, config)
    policy = networks.blank_policy(net, joint.observation_length(cell, config))
    return joint.make_bridger(cell, net, policy, config)


def ablated(
    name: str, planner: Planner, preset: Preset, chooser: Callable[[], SkillChooser]
) -> Planner:
    """A planner with one part replaced.

    Args:
        name: of `ABLATIONS`.
        planner: complete.
        preset: that its agents were made by.
        chooser: makes the hierarchical DQN's, where it is asked for.

    Raises:
        UnknownNameError: no such ablation.
    """
    cell = planner.cell
    if name == "rrt":
        return replace(planner, bridge=rrt_bridger(cell, planner.config.fallback or RrtConfig()))
    if name == "untrained":
        return replace(planner, bridge=untrained_bridger(cell, preset.joint))
    if name == "straight":
        return replace(planner, bridge=straight_bridger(cell))
    if name == "rule":
        return replace(planner, switch=rule_switcher)
    if name == "optimal_switch":
        return replace(planner, switch=optimal_switcher(preset.switch))
    if name == "dqn":
        return replace(planner, choose=chooser())
    raise UnknownNameError("ablation", name, ABLATIONS)
