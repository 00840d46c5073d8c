# SPDX-License-Identifier: MIT
"""Put a planner together from the files of a run."""

import functools
from pathlib import Path

import jax
import jax.numpy as jnp

from hybrid_jax import artifacts
from hybrid_jax.agents import dqn, joint, networks, switching
from hybrid_jax.errors import RunFolderError
from hybrid_jax.feasibility.building import load_map
from hybrid_jax.kernels.inputs import single_precision
from hybrid_jax.planner.lfd import SkillChooser, optimal_chooser
from hybrid_jax.planner.records import Planner, Switcher
from hybrid_jax.runfolder import Run
from hybrid_jax.skills.demonstration import load_demonstrations
from hybrid_jax.skills.library import SkillLibrary, build_library
from hybrid_jax.workcell.assets import demonstrations_folder


@functools.lru_cache(maxsize=4)
def read_library(folder: Path | None = None) -> SkillLibrary:
    """Skills of a folder of demonstrations; the shipped ones if none is given."""
    return build_library(load_demonstrations(folder or demonstrations_folder()))


def read_scale(run: Run) -> float:
    """Manipulability that counts as 1, from the run's map."""
    return float(load_map(run.path("map.npz"), run.cell).manipulability_scale)


def load_policy(
    run: Run, name: str, kind: str, net: networks.ActorCritic, observations: int
) -> networks.Policy:
    """A trained policy of the run."""
    _, state = run.load(name, kind)
    template = networks.blank_policy(net, observations)
    return jax.tree.map(jnp.asarray, artifacts.restore(template, state, str(run.path(name))))


def optimal_switcher(config: switching.SwitchConfig) -> Switcher:
    """Exact switching (a `Switcher`)."""
    return lambda combined: switching.optimal_switching(combined, config)[0]


def learned_switcher(run: Run) -> Switcher:
    """The trained switching agent (a `Switcher`)."""
    config, joints = run.preset.switch, run.cell.home.size
    net = switching.make_net(joints, config)
    policy = load_policy(
        run, "switch.npz", "switching agent", net, switching.SwitchWorld.observation_length(joints)
    )
    return switching.make_switcher(net, policy, config)


def load_bridger(run: Run, name: str = "drl.npz") -> joint.Bridger:
    """A trained joint agent."""
    cell, config = run.cell, run.preset.joint
    net = joint.make_net(cell, config)
    policy = load_policy(run, name, "joint agent", net, joint.observation_length(cell, config))
    return joint.make_bridger(cell, net, policy, config)


def load_chooser(run: Run) -> SkillChooser:
    """The task planner that the run's preset asks for: exact, or the trained controllers."""
    if run.preset.task_planner == "exact":
        return optimal_chooser
    return load_learned_chooser(run)


def load_learned_chooser(run: Run) -> SkillChooser:
    """The trained controllers of the hierarchical DQN, whatever the preset plans with."""
    _, state = run.load("lfd.npz", "hierarchical DQN")
    return dqn.make_chooser(run.preset.dqn, jax.tree.map(jnp.asarray, state))


@single_precision
def load_planner(run: Run, *, switch: str = "learned") -> Planner:
    """The planner of a run; needs its map and drl stages, and those of the agents it plans with.

    Args:
        run: from `open_run`.
        switch: `learned` for the run's switching agent, `optimal` for exact switching.

    Returns:
        What `plan_motion` and `plan_batch` take.

    Raises:
        RunFolderError: a stage is missing: the message says which.
    """
    learned = ("lfd",) * (run.preset.task_planner == "learned")
    for stage in ("map", *learned, "drl", *("switch",) * (switch == "learned")):
        if not run.finished(stage):
            raise RunFolderError(
                f"{run.folder} lacks the stage {stage!r} ({stage}.npz is missing); "
                f"finish it with: python -m hybrid_jax.train --resume --out "
                f"{run.folder}"
            )
    preset, cell = run.preset, run.cell
    return Planner(
        cell=cell,
        library=read_library(run.skills),
        choose=load_chooser(run),
        bridge=load_bridger(run),
        switch=learned_switcher(run) if switch == "learned" else optimal_switcher(preset.switch),
        scale=read_scale(run),
        config=preset.planner,
    )
