# SPDX-License-Identifier: MIT
"""Trainings of a run that stop and go on."""

import dataclasses

import jax
import numpy as np
import pytest
from test_agents import SMALL, Track

from hybrid_jax import stages
from hybrid_jax.agents import networks, programs, training
from hybrid_jax.errors import RunFolderError
from hybrid_jax.runfolder import Run

CONFIG = dataclasses.replace(SMALL, steps=6 * 512)


def make_run(cell, folder):
    folder.mkdir()
    return Run(folder, cell, "smoke", 0)


def train(run, config=CONFIG):
    net = networks.make_networks(1, 1, config.hidden, discrete=False)
    return stages._train_agent(run, "drl", Track(), net, config, quiet=True, every=2)


@pytest.fixture
def interrupted(cell, tmp_path, monkeypatch):
    """A run whose training was stopped after its third update."""
    run, seen = make_run(cell, tmp_path / "stopped"), []
    log = Run.log

    def stop(self, stage, values):
        log(self, stage, values)
        seen.append(values["step"])
        if len(seen) == 3:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Run, "log", stop)
        with pytest.raises(KeyboardInterrupt):
            train(run)
    return run


def test_a_resumed_run_equals_an_uninterrupted_one(cell, tmp_path, interrupted):
    """To the last bit: parameters, optimiser, normaliser, key, step and copies."""
    assert interrupted.path("drl_checkpoint.npz").is_file()
    resumed, whole = train(interrupted), train(make_run(cell, tmp_path / "whole"))
    for a, b in zip(jax.tree.leaves(resumed), jax.tree.leaves(whole), strict=True):
        np.testing.assert_array_equal(a, b)
    assert int(resumed.learner.iteration[0]) == 6
    steps = [row["step"] for row in interrupted.metrics("drl")]
    assert steps == [512 * i for i in range(1, 7)]
    assert not interrupted.path("drl_checkpoint.npz").is_file()


def test_a_checkpoint_cut_short_is_refused_by_name(interrupted):
    path = interrupted.path("drl_checkpoint.npz")
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(RunFolderError, match=r"drl_checkpoint\.npz is damaged"):
        train(interrupted)
    assert path.is_file()


def test_a_checkpoint_of_other_settings_is_refused(interrupted):
    with pytest.raises(RunFolderError, match="learning_rate 0.001, now 0.01"):
        train(interrupted, dataclasses.replace(CONFIG, learning_rate=0.01))


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
    params = programs.make_programs(Track(), net, CONFIG).start((0,)).learner.params
    assert bool(training._finite(params))
    broken = jax.tree.map(lambda a: a.at[..., -1].set(np.nan), params)
    assert not bool(training._finite(broken))
