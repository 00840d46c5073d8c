# SPDX-License-Identifier: MIT
"""Assemble a planner from the files of a run."""

import functools
from pathlib import Path

import jax

from hybrid_jax.agents import dqn, joint, networks, switching
from hybrid_jax.agents.joint_bridger import make_bridger
from hybrid_jax.agents.joint_rollouts import make_explorer
from hybrid_jax.contracts import Bridger, Executor, Explorer, SkillChooser, Switcher
from hybrid_jax.demonstrations.demonstration import load_demonstrations
from hybrid_jax.envs.paper_reach import home_manipulability
from hybrid_jax.errors import RunFolderError
from hybrid_jax.feasibility.map_files import load_map
from hybrid_jax.kernels.argument_checks import single_precision
from hybrid_jax.mjx.executed_motion import make_executor
from hybrid_jax.planner.bridging import rrt_bridger
from hybrid_jax.planner.lfd import optimal_chooser
from hybrid_jax.planner.records import Planner, PlannerConfig
from hybrid_jax.runs.presets import DEFAULT
from hybrid_jax.runs.run_folder import Run
from hybrid_jax.runtime import artifacts
from hybrid_jax.runtime.kept_programs import load_ahead
from hybrid_jax.skills.library import SkillLibrary, build_library
from hybrid_jax.types import Workcell
from hybrid_jax.workcell.assets import demonstrations_folder
from hybrid_jax.workcell.shape_padding import class_of


@functools.lru_cache(maxsize=4)
def read_library(folder: Path | None = None) -> SkillLibrary:
    """Skills of a folder of demonstrations, of the shipped ones if None; poses `[skill, n, 8]`."""
    return build_library(load_demonstrations(folder or demonstrations_folder()))


def read_scale(run: Run) -> float:
    """Manipulability that counts as man' = 1, from the run's map; with a handover, that of home.

    Raises:
        InputError: home is singular, where the paper divides by its manipulability.
    """
    if run.preset.planner.handover:
        return float(home_manipulability(run.cell))
    return float(load_map(run.path("map.npz"), run.cell).manipulability_scale)


def load_policy(
    run: Run, name: str, kind: str, net: networks.ActorCritic, observations: int
) -> networks.Policy:
    """Read a trained policy of the run.

    Args:
        run: whose file is read.
        name: of the file.
        kind: of the record in it.
        net: networks of the policy.
        observations: length of an observation.

    Raises:
        RunFolderError: the file is missing, damaged, of another cell or of other networks.
    """
    _, state = run.load(name, kind)
    template = jax.eval_shape(functools.partial(networks.blank_policy, net, observations))
    return jax.device_put(artifacts.restore(template, state, str(run.path(name))))


def optimal_switcher(config: switching.SwitchConfig) -> Switcher:
    """A `Switcher` that chooses exactly: both motions of a phase to choices `[STEPS]`."""
    return lambda combined: switching.optimal_switching(combined, config)[0]


def learned_switcher(run: Run) -> Switcher:
    """The trained switching agent as a `Switcher`: a phase's two motions to choices `[STEPS]`."""
    config, joints = run.preset.switch, run.cell.home.size
    net = switching.make_net(joints, config)
    policy = load_policy(
        run, "switch.npz", "switching agent", net, switching.SwitchEnv.observation_length(joints)
    )
    return switching.make_switcher(policy, config)


def load_executor(run: Run) -> Executor | None:
    """What judges the motions that the switching agent chooses between, if the preset has one."""
    config = run.preset.switch
    if (config.backend, config.physics) == ("fused", "kinematic"):
        return None
    return make_executor(run.cell, config.backend, config.physics)


def load_joint_policy(run: Run, name: str = "drl.npz") -> networks.Policy:
    """A trained joint agent of the run."""
    cell, config = run.cell, run.preset.joint
    net = joint.make_net(cell, config)
    return load_policy(run, name, "joint agent", net, joint.observation_length(cell, config))


def load_bridger(run: Run, name: str = "drl.npz") -> Bridger:
    """A trained joint agent as a `Bridger`: segments and a key to way points `[point, joint]`."""
    return make_bridger(run.cell, load_joint_policy(run, name), run.preset.joint)


def load_explorer(run: Run, name: str = "drl.npz") -> Explorer:
    """A trained joint agent as an `Explorer`: segments and a key to all its rollouts."""
    return make_explorer(run.cell, load_joint_policy(run, name), run.preset.joint)


def load_chooser(run: Run) -> SkillChooser:
    """The task planner that the run's preset asks for: exact, or the trained controllers."""
    if run.preset.task_planner == "exact":
        return optimal_chooser
    return load_learned_chooser(run)


def load_learned_chooser(run: Run) -> SkillChooser:
    """The trained controllers of the hierarchical DQN, whatever the preset plans with."""
    _, state = run.load("lfd.npz", "hierarchical DQN")
    return dqn.make_chooser(run.preset.dqn, jax.device_put(state))


def untrained_planner(
    cell: Workcell,
    scale: float,
    config: PlannerConfig = PlannerConfig(),
    skills: Path | None = None,
) -> Planner:
    """A planner without anything learned: exact agents, and the fallback over all gaps.

    Args:
        cell: robot, fixtures and objects.
        scale: manipulability that counts as 1; a feasibility map tells what is usual in the cell.
        config: settings.
        skills: folder of demonstrations; the shipped ones if None.
    """
    fallback = rrt_bridger(cell, DEFAULT.fallback)
    switch = optimal_switcher(DEFAULT.switch)
    library = read_library(skills)
    return Planner(cell, library, optimal_chooser, None, switch, scale, config, fallback)


def planner_without_agents(run: Run) -> Planner:
    """The planner of a run before its joint agent and its switching agent are trained."""
    preset, switch = run.preset, optimal_switcher(run.preset.switch)
    return Planner(
        run.cell,
        read_library(run.skills),
        load_chooser(run),
        None,
        switch,
        read_scale(run),
        preset.planner,
    )


@single_precision
def load_planner(run: Run, *, switch: str = "learned") -> Planner:
    """Assemble the planner of a run from its finished stages.

    It needs the stages map and drl, and those of the agents that it plans with.

    Args:
        run: from `open_run`.
        switch: `learned` for the run's switching agent, `optimal` for exact switching.

    Returns:
        A planner for `plan_motion` and `plan_batch`.

    Raises:
        RunFolderError: a stage is missing: the message says which.
    """
    # the stages of agents count only where the planner uses them
    unused = set()
    if run.preset.task_planner != "learned":
        unused.add("lfd")
    if switch != "learned":
        unused.add("switch")
    for stage in ("map", "lfd", "drl", "switch"):
        if stage not in unused and not run.finished(stage):
            raise RunFolderError(
                f"{run.folder} lacks the stage {stage!r} ({stage}.npz is missing); "
                f"finish it with: python -m hybrid_jax.train --resume --out "
                f"{run.folder}"
            )
    preset, cell = run.preset, run.cell
    load_ahead(f"plan in a cell of {class_of(cell)} with {preset.planner}, {preset.joint}")
    return Planner(
        cell=cell,
        library=read_library(run.skills),
        choose=load_chooser(run),
        bridge=None if preset.planner.handover else load_bridger(run),
        switch=learned_switcher(run) if switch == "learned" else optimal_switcher(preset.switch),
        scale=read_scale(run),
        config=preset.planner,
        explore=load_explorer(run) if preset.planner.handover else None,
        execute=load_executor(run),
        fallback=rrt_bridger(cell, preset.fallback),
    )
