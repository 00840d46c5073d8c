# SPDX-License-Identifier: MIT
"""Trained agents of the baselines, which are trained where they are missing."""

from dataclasses import replace

from hybrid_jax.agents import joint
from hybrid_jax.envs.segments import free_pairs
from hybrid_jax.planner.records import Planner
from hybrid_jax.runs.checkpoints import discard, train_agent
from hybrid_jax.runs.load_planner import load_bridger
from hybrid_jax.runs.run_folder import Run, create_run, open_run
from hybrid_jax.runs.stages import learn, training_segments


def whole_space_agent(run: Run, planner: Planner) -> Planner:
    """The planner with a joint agent that is trained on the whole work space.

    Its training has the same budget as the hybrid's. The agent is kept in the run's folder as
    `alone.npz`.
    """
    if not run.finished("alone"):
        config, cell = run.preset.joint, run.cell
        env = joint.make_env(cell, free_pairs(cell, training_segments(run, False)), config)
        net = joint.make_net(cell, config)
        state = train_agent(run, "alone", env, net, config.training, False)
        run.save("alone.npz", "joint agent", state.policy())
        discard(run, "alone")
    return replace(planner, bridge=load_bridger(run, "alone.npz"))


def paper_run(run: Run) -> Run:
    """A run of preset `paper` on the same cell, kept in the run's folder as `paper`."""
    folder = run.path("paper")
    if (folder / "config.json").is_file():
        paper = open_run(folder)
    else:
        paper = create_run(
            run.workcell, "paper", run.seed, folder, run.skills, run.tool, run.package_paths
        )
    learn(paper)
    return paper
