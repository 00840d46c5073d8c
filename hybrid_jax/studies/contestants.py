# SPDX-License-Identifier: MIT
"""The methods that studies compare."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import jax

from hybrid_jax.errors import RunFolderError, UnknownNameError
from hybrid_jax.planner.ablations import (
    ABLATIONS,
    ablated,
    joint_agent_only,
    lfd_only,
    plan_directly,
)
from hybrid_jax.planner.loading import load_learned_chooser, load_planner
from hybrid_jax.planner.pipeline import plan_batch
from hybrid_jax.planner.records import Planner, PlanResult
from hybrid_jax.planner.unchecked import follow_skills
from hybrid_jax.progress import Progress
from hybrid_jax.runfolder import Run
from hybrid_jax.simulation.disturbances import CALM, DISTURBED, Disturbance
from hybrid_jax.simulation.execution import ExecutionConfig
from hybrid_jax.simulation.runs import planning
from hybrid_jax.skills.task import Task
from hybrid_jax.studies.rivals import paper_run, whole_space_agent
from hybrid_jax.terminal import remark

METHODS = {
    "hybrid": "skills and joint agent, as the planner is used",
    "paper": "the same with the paper's agents (preset `paper`)",
    "lfd": "skills alone; what the final check refuses is not executed",
    "lfd_executed": "skills alone, executed as they are, as in the paper",
    "drl": "a joint agent of the whole work space alone, from key pose to key pose",
    "ompl": "OMPL's RRT-Connect between the same key poses",
    "disturbed": "hybrid, with what `simulation.disturbances.DISTURBED` changes",
    **{f"ablation_{name}": f"hybrid, with {what}" for name, what in ABLATIONS.items()},
}
"""What can be compared."""

ABLATION = "ablation_"
"""What the names of ablations begin with."""
PlanMany = Callable[..., list[PlanResult]]


@dataclass(frozen=True)
class Contestant:
    """A method with what it plans with."""

    name: str
    planner: Planner
    plan: PlanMany
    disturbance: Disturbance = CALM
    execution: ExecutionConfig = ExecutionConfig()
    """How what is planned is carried out."""


def one_by_one(plan: Callable[..., PlanResult]) -> PlanMany:
    """A planner of one task for many."""

    def plan_many(planner: Planner, tasks: Sequence[Task], *, key) -> list[PlanResult]:
        keys = jax.random.split(key, len(tasks))
        return [plan(planner, task, key=k) for task, k in zip(tasks, keys, strict=True)]

    return plan_many


def carry_out(
    one: Contestant, unit: str, count: int, seed: int, run: Callable, quiet: bool = False
) -> tuple[list, float]:
    """Let a method plan what a simulation asks for.

    Args:
        one: the method.
        unit, count: what is counted on the terminal, and how many there are.
        seed: of its plans.
        run: from (planning, progress) to reports.
        quiet: print nothing.

    Returns:
        The reports and the time that they took, compilation included [s].
    """
    began, progress = time.perf_counter(), Progress(one.name, unit, quiet)

    def report(ended: int, simulated: float) -> None:
        progress(ended, count, f"{simulated:,.0f} s simulated")

    found = run(planning(one.planner, one.plan, seed), report)
    return found, time.perf_counter() - began


def contestant(name: str, run: Run, paper: Run | None) -> Contestant | None:
    """A method of the study; None (and a sentence) where something for it is missing.

    Raises:
        UnknownNameError: no such method.
        RunFolderError: the paper's run is of another cell, or a run lacks a stage.
    """
    if name not in METHODS:
        raise UnknownNameError("method", name, METHODS)
    if name == "paper":
        return _paper(run, paper)
    planner = load_planner(run)
    if name == "ompl":
        return _ompl(planner)
    if name == "drl":
        return Contestant(name, joint_agent_only(whole_space_agent(run, planner)), plan_directly)
    if name == "lfd":
        return Contestant(name, lfd_only(planner), plan_batch)
    if name == "lfd_executed":  # once, as nothing else would come of it again
        return Contestant(name, planner, follow_skills, execution=ExecutionConfig(tries=1))
    if name.startswith(ABLATION):
        part = name.removeprefix(ABLATION)
        other = ablated(part, planner, run.preset, lambda: load_learned_chooser(run))
        return Contestant(name, other, plan_batch)
    return Contestant(name, planner, plan_batch, DISTURBED if name == "disturbed" else CALM)


def _paper(run: Run, paper: Run | None) -> Contestant:
    paper = paper or paper_run(run)
    if paper.cell.source.digest != run.cell.source.digest:
        raise RunFolderError(
            f"{paper.folder} was trained for cell {paper.cell.source.name!r}, not for "
            f"{run.cell.source.name!r} of {run.folder}; give a run of the same cell"
        )
    return Contestant("paper", load_planner(paper), plan_batch)


def _ompl(planner: Planner) -> Contestant | None:
    try:
        from hybrid_jax.planner.ompl_tasks import OmplTasks  # noqa: PLC0415
    except ImportError as error:
        remark(f"ompl: left out, {error.name} is not installed (pip install 'hybrid_jax[ompl]')")
        return None
    config = planner.config
    tasks = OmplTasks(planner.cell, config, config.smoothing.margin)  # as our own paths keep
    return Contestant("ompl", planner, one_by_one(lambda _, task, key: tasks.plan(task, key)))
