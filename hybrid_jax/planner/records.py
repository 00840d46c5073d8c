# SPDX-License-Identifier: MIT
"""The parts and settings of a hybrid planner."""

from dataclasses import dataclass, replace

from hybrid_jax.contracts import Bridger, Executor, Explorer, SkillChooser, Switcher
from hybrid_jax.planner.handover import HandoverConfig
from hybrid_jax.planner.key_pose_ik import PathIkConfig
from hybrid_jax.planner.smoothing import SmoothingConfig
from hybrid_jax.planner.timing import TimingConfig
from hybrid_jax.planner.trajectory_check import CheckConfig
from hybrid_jax.skills.library import SkillConfig, SkillLibrary
from hybrid_jax.types import Workcell


@dataclass(frozen=True)
class PlannerConfig:
    """Settings of the planner."""

    skills: SkillConfig = SkillConfig()
    """Which skills are admissible and how they are mapped."""
    direct: bool = False
    """Plan from key pose to key pose, without skills?"""
    path_ik: PathIkConfig = PathIkConfig()
    """How configurations of key poses and way points are found and judged."""
    quick_path_ik: PathIkConfig | None = replace(
        PathIkConfig(), candidates=2, search=replace(PathIkConfig().search, seeds=12, iterations=30)
    )
    """The same for a first look at every task: `path_ik` is used only for tasks that have no plan
    then. None leaves the first look out."""
    smoothing: SmoothingConfig = SmoothingConfig()
    """Shortcuts over gaps, and smoothing of the combined path."""
    timing: TimingConfig = TimingConfig()
    """Speeds and sampling of the trajectories."""
    check: CheckConfig = CheckConfig()
    """What the trajectories must keep."""
    plans: int = 1
    """Number of skill plans of a task that are labelled. The one with the fewest infeasible way
    points is used. More leave fewer, for as many times the labelling; motions stay as long."""
    attempts: int = 8
    """Number of routes of a task that are tried, best first."""
    handover: HandoverConfig | None = None
    """The paper's own way over gaps: the joint agent leads into a target area, and RL-LfD goes on
    from where it stops. None: it arrives at a configuration of the skill's path."""

    @property
    def first_look(self) -> PathIkConfig:
        """Settings of the first look: most plans and the agents' training data rest on them."""
        return self.quick_path_ik or self.path_ik


@dataclass(frozen=True)
class Planner:
    """A cell with everything that was learned for it; the agents are functions."""

    cell: Workcell
    """Robot, fixtures and objects."""
    library: SkillLibrary
    """Skills to choose from."""
    choose: SkillChooser
    """Task planner of RL-LfD: it picks skills for the segments of a task."""
    bridge: Bridger | None
    """DRL-Feasibility agent (joint agent); None leaves all gaps to the fallback."""
    switch: Switcher
    """Switching agent: it chooses between skill and joint agent at each grid point."""
    scale: float
    """Manipulability that counts as 1 (from the feasibility map)."""
    config: PlannerConfig = PlannerConfig()
    """Settings."""
    fallback: Bridger | None = None
    """A planner without learning in this cell, for gaps that the joint agent does not bridge; see
    `bridging.rrt_bridger`. None gives up there."""
    explore: Explorer | None = None
    """The joint agent without a proof, where `config.handover` asks for it."""
    execute: Executor | None = None
    """Judges the points of both motions by what becomes of them in simulation, for the switching
    agent; None judges them as they are planned."""
