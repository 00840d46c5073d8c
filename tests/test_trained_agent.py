# SPDX-License-Identifier: MIT
"""The joint agent of the shipped handling cell, trained for half as long as by default, solves what
it was not trained on, and by what it has learned."""

from dataclasses import replace

import jax
import pytest

from hybrid_jax.agents import joint, networks, training
from hybrid_jax.contracts import take
from hybrid_jax.envs.segments import with_room
from hybrid_jax.planner.infeasible_segments import harvest
from hybrid_jax.planner.lfd import optimal_chooser
from hybrid_jax.runs.load_planner import read_library
from hybrid_jax.runs.presets import DEFAULT
from hybrid_jax.runs.seeds import TRAINING, VALIDATION

CONFIG = replace(DEFAULT.joint, training=replace(DEFAULT.joint.training, steps=1_000_000))
TESTED = 100
"""Segments."""


def gaps(cell, tasks):
    """Infeasible segments of tasks, as a training collects them."""
    config = DEFAULT.planner
    found = harvest(
        cell,
        read_library(),
        optimal_chooser,
        config.skills,
        config.first_look,
        0.1,
        tasks=tasks,
        seed=0,
    )
    return with_room(cell, found, CONFIG.reach.margin)


@pytest.fixture(scope="module")
def segments(cell):
    """Segments to train on, and others."""
    return gaps(cell, TRAINING[:100]), take(gaps(cell, VALIDATION[:48]), slice(TESTED))


@pytest.mark.slow
def test_it_solves_unseen_segments_by_what_it_learned(cell, segments):
    some, unseen = segments
    net = joint.make_net(cell, CONFIG)
    env = joint.make_env(cell, some, CONFIG)
    untrained = networks.blank_policy(net, joint.observation_length(cell, CONFIG))
    trained = training.train(env, net, CONFIG.training).policy()
    before, after = (
        joint.success_rates(cell, net, policy, CONFIG, unseen, jax.random.key(0))[0]
        for policy in (untrained, trained)
    )
    assert before < 0.3 and after > 0.75
