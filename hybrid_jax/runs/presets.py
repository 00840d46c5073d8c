# SPDX-License-Identifier: MIT
"""Named sets of settings."""

from dataclasses import dataclass, replace
from typing import Any, Literal

from hybrid_jax.agents.dqn import DqnConfig
from hybrid_jax.agents.joint import JointAgentConfig
from hybrid_jax.agents.ppo import PpoConfig
from hybrid_jax.agents.switching import SwitchConfig
from hybrid_jax.envs.paper_reach import PaperReachConfig
from hybrid_jax.envs.reach import ReachConfig
from hybrid_jax.errors import InputError, UnknownNameError
from hybrid_jax.feasibility.grid import MapConfig
from hybrid_jax.mjx.collision import Backend
from hybrid_jax.mjx.executed_motion import Physics
from hybrid_jax.planner.handover import HandoverConfig
from hybrid_jax.planner.key_pose_ik import PathIkConfig
from hybrid_jax.planner.records import PlannerConfig
from hybrid_jax.planner.rrt_connect import RrtConfig
from hybrid_jax.planner.smoothing import SmoothingConfig
from hybrid_jax.skills.library import SkillConfig


@dataclass(frozen=True)
class Preset:
    """Settings of all stages of a run."""

    map: MapConfig = MapConfig()
    dqn: DqnConfig = DqnConfig()
    joint: JointAgentConfig = JointAgentConfig()
    switch: SwitchConfig = SwitchConfig()
    planner: PlannerConfig = PlannerConfig()
    fallback: RrtConfig | None = RrtConfig(margin=0.001)
    """RRT-Connect for gaps that the joint agent does not bridge; None for a planner without it.
    Beside key poses there is no room for a larger margin."""
    task_planner: Literal["exact", "learned"] = "exact"
    """Method that segments a task and picks skills: shortest path, or the hierarchical DQN."""
    tasks: int = 100
    """Number of random tasks from which the agents' training data come."""
    held_out: int = 20
    """Number of further tasks, on which nothing is trained."""
    switch_tasks: int = 24
    """Number of training tasks whose combined trajectories the switching agent sees."""
    showcase_tasks: int = 5
    """Number of tasks that are carried out at the end."""


DEFAULT = Preset(
    joint=replace(
        JointAgentConfig(), training=replace(JointAgentConfig().training, steps=2_000_000)
    ),
)
"""The recommended settings; a run ends in a few minutes on two cores."""

PAPER_DQN = DqnConfig(discount=0.92, polyak=0.005, learning_rate=1e-4, anneal=False)
"""The paper's table of the DQN; batch and exploration are the defaults."""

PAPER = Preset(
    dqn=PAPER_DQN,
    task_planner="learned",
    map=MapConfig(tilts=(-0.6, -0.3, 0.0, 0.3, 0.6)),
    joint=JointAgentConfig(
        training=PpoConfig(
            steps=1_000_000,
            envs=128,
            unroll=16,
            epochs=10,
            minibatch=64,
            learning_rate=3e-4,
            discount=0.99,
            entropy=0.0,
            hidden=(64, 64),
        ),
        reach=PaperReachConfig(),
        rollouts=(64,),
        edge_samples=12,  # no path is proven, and walls are thin
    ),
    switch=SwitchConfig(
        # the paper's man' - COL, and in proportion the costs that join neighbouring points
        collision=1.0,
        jump=1.0,
        switch=0.1,
        training=PpoConfig(
            steps=2_000_000,
            envs=16,
            unroll=200,
            epochs=2,  # not in the table; with 10 the policy swings at this learning rate
            minibatch=32,
            learning_rate=1e-3,
            discount=0.96,
            entropy=0.0,
            hidden=(64, 64),
        ),
    ),
    planner=PlannerConfig(
        skills=SkillConfig(map="ugp_blend", distance="euclidean"),
        quick_path_ik=None,
        plans=3,  # of which the one with the fewest infeasible way points is taken
        # nothing is proven or checked again: way points keep clear of what servos may overshoot
        path_ik=PathIkConfig(margin=0.012, key_margin=0.002, near_key=6),
        smoothing=SmoothingConfig(margin=0.004),
        handover=HandoverConfig(),
    ),
    fallback=None,  # the paper has no planner behind its agents
)
"""The paper's tables, maps, distances and algorithms; see docs/differences.md for what differs."""


def judged_by(preset: Preset, backend: Backend | None, physics: Physics | None) -> Preset:
    """A preset whose map, agents and checks use other collision functions or other physics.

    Args:
        preset: to change.
        backend: what tells collisions: of the map, in the joint agent's environment, of the
            switching agent's motions, and in the final check.
        physics: `mjx` for the joint agent's arm and the switching agent's motions under servos.
            None for either leaves it as it is.

    Raises:
        InputError: the preset learns in the paper's environment, which knows no other.
    """
    if not isinstance(preset.joint.reach, ReachConfig):
        raise InputError(
            "backend and physics cannot be chosen in the paper's environment of the joint agent "
            "(preset 'paper'); take another preset"
        )
    chosen: dict[str, Any] = {"backend": backend} if backend else {}
    moved: dict[str, Any] = chosen | ({"physics": physics} if physics else {})
    reach = replace(preset.joint.reach, **moved)
    check = replace(preset.planner.check, **chosen)
    return replace(
        preset,
        map=replace(preset.map, **chosen),
        joint=replace(preset.joint, reach=reach),
        switch=replace(preset.switch, **moved),
        planner=replace(preset.planner, check=check),
    )


MJX = judged_by(
    replace(
        DEFAULT,
        map=replace(DEFAULT.map, spacing=0.1, batch=1024),
        joint=replace(
            DEFAULT.joint,
            training=replace(
                DEFAULT.joint.training,
                steps=131_072,
                envs=128,
                unroll=16,
                minibatch=512,
                epochs=4,
            ),
        ),
    ),
    "mjx",
    "mjx",
)
"""The default with MJX throughout: kinematics, collision functions and the arm's dynamics. A
coarser map and fewer steps: two cores take long for each; on an accelerator take more."""

SMOKE = Preset(
    map=MapConfig(spacing=0.3, tilts=(0.0,), yaws=(0.0,), batch=256),
    dqn=DqnConfig(rounds=24, updates=4),
    joint=replace(
        JointAgentConfig(),
        training=PpoConfig(steps=16_384, envs=64, unroll=32, minibatch=512, hidden=(32, 32)),
        # an agent that has learned next to nothing goes on to the horizon
        reach=ReachConfig(horizon=32),
        rollouts=(2,),
    ),
    switch=replace(
        SwitchConfig(),
        training=PpoConfig(steps=6_400, envs=16, unroll=50, minibatch=200, hidden=(32, 32)),
    ),
    tasks=4,
    held_out=2,
    switch_tasks=4,
    showcase_tasks=1,
)
"""Settings for tests: every stage runs once and learns next to nothing."""

PRESETS = {"default": DEFAULT, "paper": PAPER, "mjx": MJX, "smoke": SMOKE}
"""Presets by name."""


def find_preset(name: str) -> Preset:
    """Find a preset by name.

    Raises:
        UnknownNameError: no such preset.
    """
    if name not in PRESETS:
        raise UnknownNameError("preset", name, PRESETS)
    return PRESETS[name]
