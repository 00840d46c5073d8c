# SPDX-License-Identifier: MIT
"""Train an agent of a run so that it can be interrupted: progress, metrics, checkpoints."""

import dataclasses
import json
from pathlib import Path

import jax
import jax.numpy as jnp

from hybrid_jax import artifacts
from hybrid_jax.agents import programs, training
from hybrid_jax.errors import RunFolderError
from hybrid_jax.progress import Progress
from hybrid_jax.runfolder import Run


def _settings(world, config: programs.Config) -> dict:
    """All that a training must have in common with the one that it goes on from.

    The devices belong to them: each draws random numbers of its own.
    """
    rules = {"rules of the world": repr(getattr(world, "config", None))}
    rules["number of devices"] = jax.local_device_count()
    return json.loads(json.dumps(dataclasses.asdict(config))) | rules


def _read_checkpoint(run: Run, name: str, world, net, config: programs.Config) -> training.Training:
    """A training where it stopped.

    Raises:
        RunFolderError: damaged, of another cell, or made with other settings.
    """
    header, saved = run.load(name, "checkpoint")
    for setting, value in _settings(world, config).items():
        was = header.get("settings", {}).get(setting)
        if was != value:
            raise RunFolderError(
                f"{run.path(name)} was trained with {setting} {was}, now {value}: delete it to "
                f"train anew, or go on with the preset that it was made with"
            )
    fresh = programs.make_programs(world, net, config).start((config.seed,))
    return jax.tree.map(jnp.asarray, artifacts.restore(fresh, saved, str(run.path(name))))


def train_agent(
    run: Run, stage: str, world, net, config: programs.Config, quiet: bool, every: int = 20
) -> training.Training:
    """Train with progress, metrics and checkpoints; goes on from a checkpoint if there is one.

    The last checkpoint stays, so that nothing is lost before the stage has saved what it makes of
    the training; then `discard` removes it.
    """
    checkpoint = _path(run, stage)
    latest, success = None, 0.0
    if checkpoint.is_file():
        latest = _read_checkpoint(run, checkpoint.name, world, net, config)
    progress = Progress(stage, "steps", quiet)

    def keep():
        if latest is not None:
            run.save(checkpoint.name, "checkpoint", latest, settings=_settings(world, config))

    def report(steps, state, metrics):
        nonlocal latest, success
        metrics = {k: float(v[0]) for k, v in metrics.items()}
        if not metrics["episodes"]:  # nothing ended: there is no success rate to speak of
            del metrics["success"], metrics["return"]
        latest, success = state, metrics.get("success", success)
        run.log(stage, {"step": steps, **{k: round(v, 5) for k, v in metrics.items()}})
        progress(steps, config.iterations * config.steps_per_iteration, f"success {success:.2f}")
        if int(state.learner.iteration[0]) % every == 0:
            keep()

    try:
        return training.train(world, net, config, state=latest, report=report)
    finally:
        keep()


def discard(run: Run, stage: str) -> None:
    """Remove the checkpoint of a training whose result is saved."""
    _path(run, stage).unlink(missing_ok=True)


def _path(run: Run, stage: str) -> Path:
    return run.path(f"{stage}_checkpoint.npz")
