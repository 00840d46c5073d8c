# SPDX-License-Identifier: MIT
"""Train an agent of a run so that it can be interrupted: progress, metrics, checkpoints."""

import dataclasses
import json
from pathlib import Path

import jax
import jax.numpy as jnp

from hybrid_jax.agents import trainers, training
from hybrid_jax.errors import RunFolderError
from hybrid_jax.runs.run_folder import Run
from hybrid_jax.runtime import artifacts
from hybrid_jax.runtime.progress import Progress


def _settings(env, config: trainers.Config) -> dict:
    """Settings by name that a training must share with the checkpoint that it continues from.

    The number of devices is one of them: each draws random numbers of its own.
    """
    rules = {"rules of the environment": repr(getattr(env, "config", None))}
    rules["number of devices"] = jax.local_device_count()
    # through JSON, as a file's header goes: tuples become lists
    return json.loads(json.dumps(dataclasses.asdict(config))) | rules


def _read_checkpoint(run: Run, name: str, env, net, config: trainers.Config) -> training.Training:
    """Read the state of a training; the leading axis of its arrays runs over seeds.

    Raises:
        RunFolderError: damaged, of another cell, or made with other settings.
    """
    header, arrays = run.load(name, "checkpoint")
    for setting, value in _settings(env, config).items():
        saved = header.get("settings", {}).get(setting)
        if saved != value:
            raise RunFolderError(
                f"{run.path(name)} was trained with {setting} {saved}, now {value}: delete it to "
                f"train anew, or go on with the preset that it was made with"
            )
    template = trainers.make_programs(env, net, config).start((config.seed,))
    return jax.tree.map(jnp.asarray, artifacts.restore(template, arrays, str(run.path(name))))


def train_agent(
    run: Run, stage: str, env, net, config: trainers.Config, quiet: bool, every: int = 20
) -> training.Training:
    """Train with progress, metrics and checkpoints, from the last checkpoint if there is one.

    The last checkpoint stays, so that nothing is lost before the stage has saved its result; then
    `discard` removes it.

    Args:
        run: whose folder gets metrics and checkpoints.
        stage: names their files.
        env, net, config: see `training.train`.
        quiet: show no progress.
        every: updates from one checkpoint to the next.

    Returns:
        The state at the end; the leading axis of its arrays runs over seeds.

    Raises:
        RunFolderError: the checkpoint is damaged, of another cell, or of other settings.
        TrainingError: a number is not finite.
    """
    checkpoint = _path(run, stage)
    latest, success = None, 0.0
    if checkpoint.is_file():
        latest = _read_checkpoint(run, checkpoint.name, env, net, config)
    progress = Progress(stage, "steps", quiet)

    def keep_checkpoint():
        if latest is not None:
            run.save(checkpoint.name, "checkpoint", latest, settings=_settings(env, config))

    def report(steps, state, metrics):
        nonlocal latest, success
        metrics = {k: float(v[0]) for k, v in metrics.items()}
        if not metrics["episodes"]:  # nothing ended: there is no success rate to speak of
            del metrics["success"], metrics["return"]
        latest, success = state, metrics.get("success", success)
        run.log(stage, {"step": steps, **{k: round(v, 5) for k, v in metrics.items()}})
        progress(steps, config.iterations * config.steps_per_iteration, f"success {success:.2f}")
        if int(state.learner.iteration[0]) % every == 0:
            keep_checkpoint()

    try:
        return training.train(env, net, config, state=latest, report=report)
    finally:
        keep_checkpoint()


def discard(run: Run, stage: str) -> None:
    """Remove the checkpoint of a training whose result is saved."""
    _path(run, stage).unlink(missing_ok=True)


def _path(run: Run, stage: str) -> Path:
    return run.path(f"{stage}_checkpoint.npz")
