# SPDX-License-Identifier: MIT
"""Trainings of a run that stop and go on."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_agents import SMALL, Track

from hybrid_jax.agents import networks, sac, trainers, training
from hybrid_jax.errors import RunFolderError
from hybrid_jax.runs import checkpoints
from hybrid_jax.runs.run_folder import Run

CONFIG = dataclasses.replace(SMALL, steps=6 * 512)
SAC_CONFIG = sac.SacConfig(
    steps=6 * 256, envs=32, unroll=8, batch=64, updates=4, warmup=256, replay=1024, hidden=(16,)
)


def make_run(cell, folder):
    folder.mkdir()
    return Run(folder, cell, "smoke", 0)


def train(run, config=CONFIG, env=None):
    if isinstance(config, sac.SacConfig):
        net = sac.make_networks(1, 1, config.hidden)
    else:
        net = networks.make_networks(1, 1, config.hidden, discrete=False)
    return checkpoints.train_agent(run, "drl", env or Track(), net, config, quiet=True, every=2)


def interrupt(run, monkeypatch, config=CONFIG):
    """Stop a training after its third update."""
    seen, log = [], Run.log

    def stop(self, stage, values):
        log(self, stage, values)
        seen.append(values["step"])
        if len(seen) == 3:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Run, "log", stop)
        with pytest.raises(KeyboardInterrupt):
            train(run, config)
    return run


@pytest.fixture
def interrupted(cell, tmp_path, monkeypatch):
    """A run whose training was stopped after its third update."""
    return interrupt(make_run(cell, tmp_path / "stopped"), monkeypatch)


@pytest.mark.parametrize("config", [CONFIG, SAC_CONFIG], ids=["ppo", "sac"])
def test_a_resumed_run_equals_an_uninterrupted_one(cell, tmp_path, monkeypatch, config):
    """To the last bit: parameters, optimiser, normaliser, replay, key, step and copies."""
    stopped = interrupt(make_run(cell, tmp_path / "stopped"), monkeypatch, config)
    assert stopped.path("drl_checkpoint.npz").is_file()
    resumed = train(stopped, config)
    whole = train(make_run(cell, tmp_path / "whole"), config)
    for a, b in zip(jax.tree.leaves(resumed), jax.tree.leaves(whole), strict=True):
        np.testing.assert_array_equal(a, b)
    assert int(resumed.learner.iteration[0]) == 6
    each = config.steps_per_iteration
    assert [row["step"] for row in stopped.metrics("drl")] == [each * i for i in range(1, 7)]
    checkpoints.discard(stopped, "drl")
    assert not stopped.path("drl_checkpoint.npz").is_file()


def test_a_checkpoint_of_the_real_env_is_taken(cell, tmp_path):
    """Its copies have a field that is None without dynamics."""
    from hybrid_jax.agents import joint
    from hybrid_jax.contracts import Segments
    from hybrid_jax.runs.presets import PRESETS

    run, config = make_run(cell, tmp_path / "run"), PRESETS["smoke"].joint
    scene = jax.tree.map(lambda a: jnp.asarray(a)[None], cell.scene)
    env = joint.make_env(cell, Segments(scene, cell.home[None], cell.home[None] + 0.1), config)
    short = dataclasses.replace(config.training, steps=config.training.steps_per_iteration)
    net = joint.make_net(cell, config)
    first = checkpoints.train_agent(run, "drl", env, net, short, quiet=True)
    again = checkpoints.train_agent(run, "drl", env, net, short, quiet=True)
    for a, b in zip(jax.tree.leaves(first), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_checkpoint_cut_short_is_refused_by_name(interrupted):
    path = interrupted.path("drl_checkpoint.npz")
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(RunFolderError, match=r"drl_checkpoint\.npz is damaged"):
        train(interrupted)
    assert path.is_file()


def test_a_checkpoint_of_other_settings_is_refused(interrupted):
    with pytest.raises(RunFolderError, match="learning_rate 0.001, now 0.01"):
        train(interrupted, dataclasses.replace(CONFIG, learning_rate=0.01))


def test_a_checkpoint_of_other_rules_or_devices_is_refused(interrupted, monkeypatch):
    env = Track()
    env.config = "steeper"
    with pytest.raises(RunFolderError, match="rules of the environment None, now 'steeper'"):
        train(interrupted, env=env)
    count = jax.local_device_count()
    monkeypatch.setattr(jax, "local_device_count", lambda: 7)
    with pytest.raises(RunFolderError, match=f"number of devices {count}, now 7"):
        train(interrupted)


def test_a_checkpoint_of_another_cell_is_refused(interrupted):
    other = dataclasses.replace(interrupted, cell=other_cell(interrupted.cell))
    with pytest.raises(RunFolderError, match="belongs to another work cell"):
        train(other)


def other_cell(cell):
    """The same with another digest, as after a change of its model."""
    source = type(cell.source).__new__(type(cell.source))
    source.__dict__ = {**cell.source.__dict__, "digest": "0" * 64}
    return cell.replace(source=source)


def test_parameters_that_are_not_finite_stop_a_training():
    """Even where every reported number still is: the last gradient step shows only in them."""
    net = networks.make_networks(1, 1, CONFIG.hidden, discrete=False)
    params = trainers.make_programs(Track(), net, CONFIG).start((0,)).learner.params
    assert bool(training._finite(params))
    broken = jax.tree.map(lambda a: a.at[..., -1].set(np.nan), params)
    assert not bool(training._finite(broken))
