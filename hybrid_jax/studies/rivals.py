# SPDX-License-Identifier: MIT
"""What the study needs beyond a run: the agents of its rivals, trained where they are missing."""

from dataclasses import replace

from hybrid_jax.agents import joint
from hybrid_jax.agents.segments import free_pairs
from hybrid_jax.checkpoints import discard, train_agent
from hybrid_jax.planner.loading import load_bridger
from hybrid_jax.planner.records import Planner
from hybrid_jax.runfolder import Run, create_run, open_run
from hybrid_jax.stages import learn, training_segments


def whole_space_agent(run: Run, planner: Planner) -> Planner:
    """The planner with a joint agent of the whole work space, trained with the same budget.

    It is kept in the run's folder as `alone.npz`.
    """
    if not run.finished("alone"):
        config, cell = run.preset.joint, run.cell
        world = joint.make_world(cell, free_pairs(cell, training_segments(run, False)), config)
        net = joint.make_net(cell, config)
        state = train_agent(run, "alone", world, net, config.training, False)
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
