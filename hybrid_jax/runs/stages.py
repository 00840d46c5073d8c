# SPDX-License-Identifier: MIT
"""The stages of a training run: map, three agents, showcase. Each leaves files in the run.

The file that marks a stage as finished is written last, so a run can be stopped at any moment.
"""

import functools
import json
import time
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from hybrid_jax.agents import dqn, hdqn_networks, joint, switching
from hybrid_jax.contracts import Combined, Segments
from hybrid_jax.envs.segments import refuse_infeasible, with_room
from hybrid_jax.errors import RunFolderError
from hybrid_jax.execution.scheduler import planning
from hybrid_jax.execution.single_tasks import execution_of
from hybrid_jax.feasibility import building
from hybrid_jax.feasibility.evaluation import Reason
from hybrid_jax.feasibility.map_files import save_map
from hybrid_jax.planner import infeasible_segments, target_area_data
from hybrid_jax.planner.lfd import optimal_chooser
from hybrid_jax.planner.pipeline import plan_batch
from hybrid_jax.reports import film
from hybrid_jax.reports.learning_curves import draw_curves
from hybrid_jax.reports.map_picture import draw_map
from hybrid_jax.runs import seeds
from hybrid_jax.runs.checkpoints import discard, train_agent
from hybrid_jax.runs.load_planner import (
    load_planner,
    planner_without_agents,
    read_library,
    read_scale,
)
from hybrid_jax.runs.run_folder import Run
from hybrid_jax.runs.switch_problems import switch_problems
from hybrid_jax.runtime import artifacts, output_files
from hybrid_jax.runtime.progress import Progress
from hybrid_jax.runtime.terminal import remark
from hybrid_jax.skills.costs import SegmentCosts, pad_task, segment_costs
from hybrid_jax.skills.task_segmentation import optimal_costs
from hybrid_jax.tasks.registry import random_task
from hybrid_jax.types import Source

TRAINING_TASKS = seeds.TRAINING.start
"""Seed of the first training task."""
HELD_OUT_TASKS = seeds.VALIDATION.start
"""Seed of the first held-out task."""

Stage = Callable[[Run, bool], dict]
"""Runs a stage on a run (quietly or not) and returns the row of the summary."""


def run_map(run: Run, quiet: bool) -> dict:
    """Build the feasibility map (Algorithm 1, line 3)."""
    progress = Progress("map", "poses", quiet)
    fmap = building.build_feasibility_map(
        run.cell, run.preset.map, seed=run.seed, progress=progress, partial=run.path("map_blocks")
    )
    draw_map(run.path("map.png"), run.cell, fmap)
    counts = np.bincount(np.asarray(fmap.reason).ravel(), minlength=len(Reason))
    shares = {r.name.lower(): round(float(counts[r] / counts.sum()), 4) for r in Reason}
    run.log("map", {"step": int(counts.sum()), **shares})
    save_map(run.path("map.npz"), run.cell, fmap)
    return {"poses": int(counts.sum()), "feasible": shares["feasible"]}


def task_batch(run: Run, numbers: range) -> SegmentCosts:
    """Segment costs `[task, ...]` of random tasks with the given seeds."""
    library, config = read_library(run.skills), run.preset.planner.skills
    rows = [pad_task(random_task(run.cell, number)) for number in numbers]
    columns = (jnp.asarray(np.stack(column)) for column in zip(*rows, strict=True))
    return jax.jit(jax.vmap(lambda p, c, n: segment_costs(library, p, c, n, config)))(*columns)


def run_lfd(run: Run, quiet: bool) -> dict:
    """Train the hierarchical DQN on random tasks (Algorithm 2, offline)."""
    config = run.preset.dqn
    tasks = task_batch(run, range(TRAINING_TASKS, TRAINING_TASKS + run.preset.tasks))
    test = task_batch(run, range(HELD_OUT_TASKS, HELD_OUT_TASKS + run.preset.held_out))
    best, nets = optimal_costs(test), dqn.make_controllers(config)
    chunk = max(1, config.rounds // 24)
    trainer = dqn.make_trainer(tasks, config, chunk)
    evaluate = jax.jit(lambda params: hdqn_networks.greedy_plans(nets, params, test)[1])
    state, progress = dqn.initialize(tasks, config), Progress("lfd", "rounds", quiet)
    row, began = {}, time.perf_counter()
    for rounds_done in range(chunk, config.rounds + 1, chunk):
        state, metrics = trainer(state)
        total = np.asarray(evaluate(state.params))
        solved = np.isfinite(total) & np.isfinite(best)
        ratio = float(total[solved].sum() / best[solved].sum()) if solved.any() else float("nan")
        row = {
            "step": int(state.episodes),
            "seconds": round(time.perf_counter() - began, 3),
            "reward": float(metrics["reward"].mean()),
            "solved": float(solved.sum() / max(np.isfinite(best).sum(), 1)),
            "cost_over_optimum": round(ratio, 4),
        }
        run.log("lfd", row)
        progress(rounds_done, chunk * (config.rounds // chunk), f"solved {row['solved']:.2f}")
    draw_curves(
        run.path("lfd.png"),
        run.metrics("lfd"),
        "Hierarchical DQN (RL-LfD)",
        "episodes",
        ("reward", "cost_over_optimum"),
    )
    run.save("lfd.npz", "hierarchical DQN", state.params)
    return {"held_out_solved": row["solved"], "cost_over_optimum": row["cost_over_optimum"]}


def collect_segments(run: Run, name: str, first: int, count: int, quiet: bool) -> Segments:
    """Infeasible segments of random tasks.

    Args:
        run: cell, skills and settings.
        name: of the progress line.
        first: seed of the first task.
        count: number of tasks.
        quiet: show no progress.

    Returns:
        Segments with ends `[segment, joint]` [rad].
    """
    if run.preset.planner.handover:
        tasks = [random_task(run.cell, number) for number in range(first, first + count)]
        return target_area_data.harvest(planner_without_agents(run), tasks)
    progress = Progress(name, "tasks", quiet)
    return infeasible_segments.harvest(
        run.cell,
        read_library(run.skills),
        optimal_chooser,
        run.preset.planner.skills,
        run.preset.planner.first_look,
        read_scale(run),
        tasks=range(first, first + count),
        seed=run.seed,
        progress=progress,
    )


def training_segments(run: Run, quiet: bool) -> Segments:
    """Segments to train on, from the run's file or made anew; ends `[segment, joint]` [rad].

    Raises:
        RunFolderError: the file is damaged.
        SegmentError: an end is outside the limits or not free.
    """
    path = run.path("segments.npz")
    if not path.is_file():
        harvested = collect_segments(run, "collect", TRAINING_TASKS, run.preset.tasks, quiet)
        run.save(path.name, "segments", harvested)
    _, state = run.load(path.name, "segments")
    try:
        parts = state["scene"], state["start"], state["goal"]
    except KeyError as error:
        raise RunFolderError(f"{path} lacks the array {error}") from None
    scene = artifacts.restore(run.cell.scene, parts[0], str(path), batched=True)
    segments = Segments(scene, *parts[1:])
    margin = run.preset.joint.reach.margin
    # beside a key pose a skill may come closer than the agent does
    segments = with_room(run.cell, jax.tree.map(jnp.asarray, segments), margin)
    refuse_infeasible(run.cell, segments, margin)
    return segments


def run_drl(run: Run, quiet: bool) -> dict:
    """Train the joint agent on the infeasible segments (Algorithm 1, lines 4-8; Algorithm 3)."""
    config = run.preset.joint
    segments = training_segments(run, quiet)
    net = joint.make_net(run.cell, config)
    state = train_agent(
        run, "drl", joint.make_env(run.cell, segments, config), net, config.training, quiet
    )
    policy = state.policy()
    test = collect_segments(run, "collect", HELD_OUT_TASKS, run.preset.held_out, quiet)
    single, best = joint.success_rates(
        run.cell, net, policy, config, test, jax.random.key(run.seed)
    )
    # metrics keep one line a step: a step of its own keeps this from replacing the last update's
    run.log(
        "drl",
        {"step": config.training.steps + 1, "held_out_single": single, "held_out_best_of_16": best},
    )
    draw_curves(
        run.path("drl.png"),
        run.metrics("drl"),
        "DRL-Feasibility",
        "environment steps",
        ("success", "reward"),
    )
    run.save("drl.npz", "joint agent", policy)
    discard(run, "drl")
    return {
        "segments": int(segments.start.shape[0]),
        "held_out_single": round(single, 3),
        "held_out_best_of_16": round(best, 3),
    }


def combined_problems(run: Run) -> Combined:
    """Combined trajectories (traj_comb) of the training tasks' phases that have gaps.

    Returns:
        `[problem, ...]`: configurations `[problem, 2, STEPS, joint]` [rad].
    """
    planner = load_planner(run, switch="optimal")
    numbers = range(TRAINING_TASKS, TRAINING_TASKS + run.preset.switch_tasks)
    tasks, key = [random_task(run.cell, number) for number in numbers], jax.random.key(run.seed)
    if run.preset.planner.handover:
        return target_area_data.switch_problems(planner, tasks, key)
    return switch_problems(planner, tasks, key)


def run_switch(run: Run, quiet: bool) -> dict:
    """Train discrete PPO on combined trajectories (Algorithm 1, "Train Switching Agent")."""
    config = run.preset.switch
    problems = combined_problems(run)
    net = switching.make_net(run.cell.home.size, config)
    state = train_agent(
        run, "switch", switching.SwitchEnv(problems, config), net, config.training, quiet
    )
    policy = state.policy()
    _, reward = jax.jit(functools.partial(switching.choose, net, config=config))(policy, problems)
    count = problems.available.shape[0]
    best = np.array(
        [
            switching.optimal_switching(jax.tree.map(lambda a, i=i: a[i], problems), config)[1]
            for i in range(count)
        ]
    )
    draw_curves(
        run.path("switch.png"),
        run.metrics("switch"),
        "Switching agent (PPO)",
        "environment steps",
        ("reward",),
    )
    run.save("switch.npz", "switching agent", policy)
    discard(run, "switch")
    return {
        "problems": count,
        "reward": round(float(np.mean(reward)), 2),
        "optimum": round(float(best.mean()), 2),
    }


def run_showcase(run: Run, quiet: bool) -> dict:
    """Plan a few of the cell's tasks and carry them out in physics."""
    plan = planning(functools.partial(plan_batch, load_planner(run)), run.seed)
    count = run.preset.showcase_tasks
    showcase = execution_of(run.cell).show(run.cell, plan, run.seed, count)
    rows = [{"step": i} | row for i, row in enumerate(showcase.rows)]
    for row in rows:
        run.log("showcase", row)
        if not quiet:
            remark(f"showcase {row['name']}: {row['cause'] or 'done'} {row['detail']}".rstrip())
    film.save(run.path("showcase"), film.render(run.cell.model, showcase.frames))
    by_both = [r["success"] and 0 < r["shares"].get(Source.DRL.name, 0) < 1 for r in rows]
    summary = {
        "objects": len(rows),
        "done": sum(row["success"] for row in rows),
        "done_by_both_agents": sum(by_both),
        "touched": showcase.touched,
    }
    text = json.dumps({"summary": summary, "objects": rows}, indent=1)
    output_files.write_text(run.path("showcase.json"), text)
    return summary


STAGE_FUNCTIONS: dict[str, Stage] = {
    "map": run_map,
    "lfd": run_lfd,
    "drl": run_drl,
    "switch": run_switch,
    "showcase": run_showcase,
}
"""The function of each stage, in order."""


def learn(run: Run, quiet: bool = False) -> None:
    """Run the stages that the run lacks and a planner needs: all but the showcase."""
    for stage, function in STAGE_FUNCTIONS.items():
        if stage != "showcase" and not run.finished(stage):
            function(run, quiet)
