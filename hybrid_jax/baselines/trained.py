# SPDX-License-Identifier: MIT
"""Trained agents of the baselines, which are trained where they are missing."""

from dataclasses import replace

from hybrid_jax.agents import joint
from hybrid_jax.agents.joint import JointAgentConfig
from hybrid_jax.agents.joint_rollouts import make_explorer
from hybrid_jax.envs.paper_reach import PURE
from hybrid_jax.envs.segments import free_pairs
from hybrid_jax.planner.handover import HandoverConfig
from hybrid_jax.planner.records import Planner
from hybrid_jax.runs.checkpoints import discard, train_agent
from hybrid_jax.runs.load_planner import load_bridger, load_joint_policy
from hybrid_jax.runs.run_folder import Run, create_run, open_run
from hybrid_jax.runs.stages import learn, training_segments


def whole_space_agent(run: Run, planner: Planner) -> Planner:
    """The planner with a joint agent that is trained on the whole work space.

    Its training has the same budget as the hybrid's. The agent is kept in the run's folder as
    `alone.npz`.
    """
    _train_alone(run, "alone", run.preset.joint)
    return replace(planner, bridge=load_bridger(run, "alone.npz"))


def pure_agent(run: Run, planner: Planner) -> Planner:
    """The planner of a run of preset `paper` with the paper's pure DRL in place of all its agents.

    It learns in the whole work space for as many steps, by the joint distance and a reward at the
    goal, with the target area of 25 cm, and leads from key pose to key pose. The agent is kept in
    the run's folder as `pure.npz`.
    """
    joint_config = replace(run.preset.joint, reach=PURE)
    _train_alone(run, "pure", joint_config)
    explore = make_explorer(run.cell, load_joint_policy(run, "pure.npz"), joint_config)
    handover = replace(planner.config.handover or HandoverConfig(), radius=PURE.radius)
    config = replace(planner.config, direct=True, handover=handover)
    return replace(planner, explore=explore, config=config)


def _train_alone(run: Run, name: str, config: JointAgentConfig) -> None:
    """Train a joint agent in the whole work space, where the run has none of that name yet."""
    if run.finished(name):
        return
    cell = run.cell
    env = joint.make_env(cell, free_pairs(cell, training_segments(run, False)), config)
    net = joint.make_net(cell, config)
    state = train_agent(run, name, env, net, config.training, False)
    run.save(f"{name}.npz", "joint agent", state.policy())
    discard(run, name)


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
