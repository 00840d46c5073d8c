# SPDX-License-Identifier: MIT
"""What a planner consists of, and what it answers."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from hybrid_jax.agents.joint import Bridger
from hybrid_jax.agents.switching import Combined
from hybrid_jax.planner.checking import CheckConfig
from hybrid_jax.planner.labelling import LabelConfig
from hybrid_jax.planner.lfd import SkillChooser
from hybrid_jax.planner.smoothing import SmoothingConfig
from hybrid_jax.planner.timing import TimingConfig
from hybrid_jax.rrt import RrtConfig
from hybrid_jax.skills.library import SkillConfig, SkillLibrary
from hybrid_jax.types import Source, Status, Trajectory, Workcell

Switcher = Callable[[Combined], np.ndarray]
"""Both motions of a phase to the choice at each grid point: 0 skill, 1 joint agent."""


@dataclass(frozen=True)
class PlannerConfig:
    """Settings of the planner."""

    skills: SkillConfig = SkillConfig()
    """Which skills are admissible and how they are mapped."""
    direct: bool = False
    """From key pose to key pose, without skills."""
    labels: LabelConfig = LabelConfig()
    """How configurations of key poses and way points are found and judged."""
    quick: LabelConfig | None = replace(
        LabelConfig(), candidates=2, search=replace(LabelConfig().search, seeds=12, iterations=30)
    )
    """How tasks are labelled at first; `labels` follows where that leaves no plan. None leaves this
    look out."""
    smoothing: SmoothingConfig = SmoothingConfig()
    """Of the combined path."""
    timing: TimingConfig = TimingConfig()
    """Speeds and sampling of the trajectories."""
    check: CheckConfig = CheckConfig()
    """What the trajectories must keep."""
    plans: int = 1
    """Skill plans of a task that are labelled; that with the fewest infeasible way points is used.
    Three leave 4 % fewer in the handling cell, and are three times as many to label."""
    attempts: int = 8
    """Routes of a task that are tried, best first."""
    fallback: RrtConfig | None = RrtConfig(margin=0.001)
    """What bridges where the joint agent finds no way; None gives up there. Beside key poses there
    is no room for a larger margin."""

    @property
    def first_look(self) -> LabelConfig:
        """How tasks are labelled at first: what most plans rest on, and the agents' data."""
        return self.quick or self.labels


@dataclass(frozen=True)
class Planner:
    """A cell with everything that was learned for it. The agents are functions."""

    cell: Workcell
    """Robot, fixtures and objects."""
    library: SkillLibrary
    """Skills to choose from."""
    choose: SkillChooser
    """Task planner of RL-LfD."""
    bridge: Bridger | None
    """DRL-Feasibility agent; None plans with skills alone."""
    switch: Switcher
    """Switching agent."""
    scale: float
    """Manipulability that counts as 1 (from the feasibility map)."""
    config: PlannerConfig = PlannerConfig()
    """Settings."""


@dataclass(frozen=True)
class PlanResult:
    """A plan, or the reason why there is none."""

    status: Status
    """How planning ended."""
    detail: str
    """A sentence for people: what failed and where."""
    phases: list[Trajectory] = field(default_factory=list)
    """One timed trajectory for each phase between gripper events; empty unless status is OK."""
    skills: list[str] = field(default_factory=list)
    """Skill of each segment."""

    @property
    def shares(self) -> dict[Source, float]:
        """Share of the trajectory's points from each source."""
        sources = np.concatenate([t.sources for t in self.phases]) if self.phases else np.zeros(0)
        return {s: float(np.mean(sources == s)) if sources.size else 0.0 for s in Source}

    @property
    def drl_share(self) -> float:
        """Share of the trajectory's points that came from the joint agent."""
        return self.shares[Source.DRL]
