# SPDX-License-Identifier: MIT
"""The methods that studies compare."""

import functools
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import jax

from hybrid_jax.baselines.ablations import (
    ABLATIONS,
    ablated,
    joint_agent_only,
    lfd_only,
    plan_directly,
)
from hybrid_jax.baselines.trained import paper_run, pure_agent, whole_space_agent
from hybrid_jax.baselines.unchecked import follow_skills
from hybrid_jax.contracts import PlanResult
from hybrid_jax.errors import InputError, RunFolderError, UnknownNameError
from hybrid_jax.execution.disturbances import CALM, DISTURBED, Disturbance
from hybrid_jax.execution.plan_execution import ExecutionConfig
from hybrid_jax.execution.scheduler import planning
from hybrid_jax.planner.pipeline import plan_batch
from hybrid_jax.planner.records import Planner
from hybrid_jax.planner.target_area import plan_unchecked
from hybrid_jax.runs.load_planner import (
    load_learned_chooser,
    load_planner,
    optimal_switcher,
)
from hybrid_jax.runs.run_folder import Run
from hybrid_jax.runtime.progress import Progress
from hybrid_jax.runtime.terminal import remark
from hybrid_jax.tasks.task import Task

METHODS = {
    "hybrid": "skills and joint agent, as the planner is used",
    "paper": "the paper's method (preset `paper`), executed as it is",
    "paper_literal": "the same, switching for man' - COL alone, without costs of jumps",
    "paper_lfd": "its skills alone, executed as they are",
    "paper_drl": "the paper's pure DRL of the whole work space alone, executed as it is",
    "lfd": "skills alone; what the final check refuses is not executed",
    "lfd_executed": "skills alone, executed as they are",
    "drl": "a joint agent of the whole work space alone, from key pose to key pose",
    "ompl": "OMPL's RRT-Connect between the same key poses",
    "disturbed": "hybrid, with what `execution.disturbances.DISTURBED` changes",
    **{f"ablation_{name}": f"hybrid, with {what}" for name, what in ABLATIONS.items()},
}
"""Methods that can be compared, with a description each."""

ABLATION = "ablation_"
"""Prefix of the names of ablations."""
PlanMany = Callable[..., list[PlanResult]]
"""Plans many tasks: (planner, tasks, key=...) to one result a task."""


@dataclass(frozen=True)
class Method:
    """A method: its planner, and how its plans are carried out."""

    name: str
    planner: Planner
    plan: PlanMany
    disturbance: Disturbance = CALM
    execution: ExecutionConfig = ExecutionConfig()
    """Times and thresholds of the execution."""
    engine: str = "auto"
    """Physics that carries plans out, see `execution.engines`."""


def one_by_one(plan: Callable[..., PlanResult]) -> PlanMany:
    """Turn a planner of one task into one of many, with a random key for each task."""

    def plan_many(planner: Planner, tasks: Sequence[Task], *, key) -> list[PlanResult]:
        keys = jax.random.split(key, len(tasks))
        return [plan(planner, task, key=k) for task, k in zip(tasks, keys, strict=True)]

    return plan_many


def carry_out(
    method: Method, unit: str, count: int, seed: int, run: Callable, quiet: bool = False
) -> tuple[list, float]:
    """Let a method plan the tasks that a simulation requests.

    Args:
        method: the method.
        unit, count: name and number of the runs, for the progress line.
        seed: of the method's random keys.
        run: from (planning, progress) to reports.
        quiet: show no progress.

    Returns:
        The reports, and their time [s], compilation included.
    """
    start_time, progress = time.perf_counter(), Progress(method.name, unit, quiet)

    def report(ended: int, simulated: float) -> None:
        progress(ended, count, f"{simulated:,.0f} s simulated")

    reports = run(planning(functools.partial(method.plan, method.planner), seed), report)
    return reports, time.perf_counter() - start_time


def make_method(name: str, run: Run, paper: Run | None) -> Method | None:
    """Make a method of the study; None, and a remark on the terminal, if it cannot run here.

    Args:
        name: a key of `METHODS`.
        run: whose planner is compared.
        paper: run of preset `paper`, for its methods; if None, `run` itself where it is one, else
            one that is trained in its folder.

    Raises:
        UnknownNameError: no such method.
        InputError: the method replaces what a planner of preset `paper` does not have.
        RunFolderError: the paper's run is of another cell, or a run lacks a stage.
    """
    if name not in METHODS:
        raise UnknownNameError("method", name, METHODS)
    if name in PAPERS:
        return _paper(name, run, paper)
    if run.preset.planner.handover and name != "hybrid":
        # what they replace is no part of its planner: they would measure the hybrid again
        raise InputError(
            f"method {name!r} is made for other presets than that of {run.folder}; "
            f"name some of: hybrid, {', '.join(PAPERS)}"
        )
    planner = load_planner(run)
    if name == "ompl":
        return _ompl(planner)
    if name == "drl":
        return Method(name, joint_agent_only(whole_space_agent(run, planner)), plan_directly)
    if name == "lfd":
        return Method(name, lfd_only(planner), plan_batch)
    if name == "lfd_executed":  # one try: another would end the same
        return Method(name, planner, follow_skills, execution=ExecutionConfig(tries=1))
    if name.startswith(ABLATION):
        part = name.removeprefix(ABLATION)
        ablated_planner = ablated(part, planner, run.preset, lambda: load_learned_chooser(run))
        return Method(name, ablated_planner, plan_batch)
    return Method(name, planner, plan_batch, DISTURBED if name == "disturbed" else CALM)


PAPERS = ("paper", "paper_literal", "paper_lfd", "paper_drl")
"""Methods of the paper, with its own agents; each plan is executed once."""


def _paper(name: str, run: Run, paper: Run | None) -> Method:
    paper = paper or (run if run.preset.planner.handover else paper_run(run))
    if paper.cell.source.digest != run.cell.source.digest:
        raise RunFolderError(
            f"{paper.folder} was trained for cell {paper.cell.source.name!r}, not for "
            f"{run.cell.source.name!r} of {run.folder}; give a run of the same cell"
        )
    planner, once = load_planner(paper), ExecutionConfig(tries=1)
    if name == "paper_lfd":
        return Method(name, planner, follow_skills, execution=once)
    if name == "paper_drl":
        planner = pure_agent(paper, planner)
    if name == "paper_literal":  # its optimum, point by point: what an agent could learn at best
        literal = replace(paper.preset.switch, jump=0.0, switch=0.0)
        planner = replace(planner, switch=optimal_switcher(literal))
    return Method(name, planner, plan_unchecked, execution=once)


def _ompl(planner: Planner) -> Method | None:
    try:
        from hybrid_jax.baselines.ompl_tasks import OmplTasks
    except ImportError as error:
        remark(f"ompl: left out, {error.name} is not installed (pip install 'hybrid_jax[ompl]')")
        return None
    config = planner.config
    tasks = OmplTasks(planner.cell, config, config.smoothing.margin)  # as the planner's paths keep
    return Method("ompl", planner, one_by_one(lambda _, task, key: tasks.plan(task, key)))
