# SPDX-License-Identifier: MIT
"""Ablations: the planner with a part left out, or replaced.

They show what each part is worth. Everything else stays the same: the configurations and routes
that are tried, smoothing, timing and the check.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from jax import Array

from hybrid_jax.agents import joint, networks
from hybrid_jax.agents.joint_bridger import make_bridger
from hybrid_jax.contracts import Bridger, Combined, PlanResult, Segments, SkillChooser
from hybrid_jax.errors import InputError, UnknownNameError
from hybrid_jax.kernels.argument_checks import single_precision
from hybrid_jax.kernels.collision.motion_validation import paths_are_free
from hybrid_jax.planner.bridging import rrt_bridger
from hybrid_jax.planner.pipeline import SEARCHED, plan_batch
from hybrid_jax.planner.records import Planner
from hybrid_jax.planner.rrt_connect import RrtConfig
from hybrid_jax.runs.load_planner import optimal_switcher
from hybrid_jax.runs.presets import Preset
from hybrid_jax.runtime.keys import split
from hybrid_jax.tasks.task import Task
from hybrid_jax.types import Workcell

ABLATIONS = {
    "rrt": "RRT-Connect in the joint agent's place",
    "untrained": "a joint agent that was never trained",
    "straight": "the straight joint line in the joint agent's place",
    "rule": "the joint agent wherever it has a motion, in the switching agent's place",
    "optimal_switch": "exact switching in the switching agent's place",
    "dqn": "the hierarchical DQN in the exact task planner's place",
}
"""Replaced parts, by name; RRT-Connect stays as fallback behind the joint agent."""


def rule_switcher(combined: Combined) -> np.ndarray:
    """Choose the joint agent wherever it has a motion (a `Switcher`).

    Args:
        combined: both motions of a phase, `available` `[STEPS]`.

    Returns:
        `[STEPS]` 0 for the skill, 1 for the joint agent.
    """
    return np.asarray(combined.available).astype(int)


def lfd_only(planner: Planner) -> Planner:
    """A planner with skills alone, without bridges over gaps (the paper's "LfD")."""
    # without the fallback too: RRT-Connect would bridge the gaps
    return replace(planner, bridge=None, fallback=None)


def joint_agent_only(planner: Planner) -> Planner:
    """A planner with the joint agent alone, from key pose to key pose (the paper's "DRL").

    Raises:
        InputError: the planner has no joint agent.
    """
    if planner.bridge is None:
        raise InputError("the planner has no joint agent")
    config = replace(planner.config, direct=True)
    return replace(planner, switch=rule_switcher, config=config, fallback=None)


@single_precision
def plan_directly(planner: Planner, tasks: Sequence[Task], *, key: Array) -> list[PlanResult]:
    """Plan tasks with the joint agent alone, see `plan_batch`.

    Corners are first rounded as widely as in the hybrid. Tasks that have no plan then are planned
    again with narrow rounding: the key poses on the way must be passed, and no skill keeps the path
    near them.

    Args:
        planner: from `joint_agent_only`.
        tasks: what is to be done.
        key: consumed.

    Returns:
        One result for each task; trajectories have positions `[point, joint]` [rad or m].
    """
    key_wide, key_narrow = split(key, 2)
    results = plan_batch(planner, tasks, key=key_wide)
    unsolved = [i for i, result in enumerate(results) if result.status in SEARCHED]
    if unsolved:
        narrow_width = planner.config.smoothing.kept
        smoothing = replace(planner.config.smoothing, widths=(narrow_width, 0.0))
        narrow = replace(planner, config=replace(planner.config, smoothing=smoothing))
        retried = plan_batch(narrow, [tasks[i] for i in unsolved], key=key_narrow)
        for i, result in zip(unsolved, retried, strict=True):
            results[i] = result
    return results


def straight_bridger(cell: Workcell) -> Bridger:
    """A `Bridger` by the straight joint line, where it is proven free.

    Returns:
        A function of segments (`start` and `goal` `[segment, joint]`) and a key. It returns the two
        ends `[2, joint]` [rad or m] of each segment, or None.
    """

    def bridge(segments: Segments, key: Array) -> list[np.ndarray | None]:
        del key
        ends = zip(np.asarray(segments.start), np.asarray(segments.goal), strict=True)
        lines = [np.stack(pair) for pair in ends]
        free = paths_are_free(cell, segments.scene, lines)
        return [line if is_free else None for line, is_free in zip(lines, free, strict=True)]

    return bridge


def untrained_bridger(cell: Workcell, config: joint.JointAgentConfig) -> Bridger:
    """A `Bridger` by a joint agent that was never trained: its weights are drawn once."""
    net = joint.make_net(cell, config)
    policy = networks.blank_policy(net, joint.observation_length(cell, config))
    return make_bridger(cell, policy, config)


def ablated(
    name: str, planner: Planner, preset: Preset, chooser: Callable[[], SkillChooser]
) -> Planner:
    """A planner with one part replaced.

    Args:
        name: one of `ABLATIONS`.
        planner: the complete planner.
        preset: settings of the planner's agents.
        chooser: makes the chooser of the hierarchical DQN; called for "dqn" only.

    Returns:
        The planner; all other parts are shared with the complete one.

    Raises:
        UnknownNameError: no such ablation.
    """
    cell = planner.cell
    if name == "rrt":
        return replace(planner, bridge=planner.fallback or rrt_bridger(cell, RrtConfig()))
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
