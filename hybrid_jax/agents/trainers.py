# SPDX-License-Identifier: MIT
"""The compiled programs of a training: how it starts, advances and is placed on devices."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from hybrid_jax.agents import networks, ppo, sac
from hybrid_jax.agents.networks import ActorCritic
from hybrid_jax.envs import base
from hybrid_jax.runtime.compiler_options import vector_options
from hybrid_jax.types import Record, pytree

Config = ppo.PpoConfig | sac.SacConfig
"""Settings of a training; their type selects the algorithm."""


@pytree
class Training(Record):
    """State of a training; the leading axis of every array runs over seeds."""

    learner: ppo.Learner | sac.SacLearner
    copies: base.Copies

    def policy(self, seed: int = 0) -> networks.Policy:
        """The present policy of one seed, by its index, on the host."""
        learner = self.learner
        trained = networks.Policy(learner.params["policy"], learner.normalizer)
        # not tied to the devices that trained it: they would all repeat what one can do
        return jax.tree.map(lambda a: a[seed], jax.device_get(trained))


FEWEST_SAMPLES = 256
"""Samples of a minibatch below which a further device costs more than it helps, for PPO."""


def pick_devices(config: ppo.PpoConfig) -> list[Any]:
    """As many local devices as share copies and minibatches evenly, with enough samples each."""
    devices = jax.local_devices()
    return devices[
        : max(
            n
            for n in range(1, len(devices) + 1)
            if n == 1
            or (
                config.envs % n == 0
                and config.minibatch % n == 0
                and config.minibatch // n >= FEWEST_SAMPLES
            )
        )
    ]


def _options(env: base.Env) -> dict[str, int | bool]:
    """Options of XLA's compiler that suit the steps of an environment."""
    return getattr(env, "compiler_options", vector_options())


class PpoPrograms:
    """Compiled programs of one PPO training, over some devices."""

    def __init__(self, env: base.Env, net: ActorCritic, config: ppo.PpoConfig, devices=None):
        self.env, self.net, self.config = env, net, config
        devices = devices or pick_devices(config)
        self.parts = len(devices)
        mesh = Mesh(np.array(devices), (ppo.AXIS,))
        # axes: [seed, copy, ...] of the copies, [seed, step, copy, ...] of a rollout
        replicated, by_copy = PartitionSpec(), PartitionSpec(None, ppo.AXIS)
        by_step_and_copy = PartitionSpec(None, None, ppo.AXIS)
        specs = dict.fromkeys(("last_obs", "cut", "cut_gained"), by_copy)
        self._whole, self._split = NamedSharding(mesh, replicated), NamedSharding(mesh, by_copy)
        on_devices = functools.partial(jax.shard_map, mesh=mesh, check_vma=False)
        data = {
            k: by_step_and_copy
            for k in (
                "obs",
                "action",
                "log_prob",
                "reward",
                "terminated",
                "success",
                "gained",
                "info",
                "kept",
            )
        } | specs
        self.reset = jax.jit(on_devices(self._reset, in_specs=replicated, out_specs=by_copy))
        self.collect = jax.jit(
            on_devices(self._collect, in_specs=(replicated, by_copy), out_specs=(by_copy, data)),
            compiler_options=_options(env),
        )
        self.update = jax.jit(
            on_devices(
                self._update, in_specs=(replicated, data), out_specs=(replicated, replicated)
            )
        )

    def _own(self, key):
        """A key of this device's own."""
        return jax.random.fold_in(key, jax.lax.axis_index(ppo.AXIS))

    def _reset(self, keys):
        count = self.config.envs // self.parts
        return jax.vmap(lambda key: base.start_copies(self.env, self._own(key), count))(keys)

    def _collect(self, learner, copies):
        def collect_seed(learner, copies):
            key = self._own(jax.random.split(learner.key, 3)[0])
            return ppo.collect(self.env, self.net, self.config, learner, copies, key)

        return jax.vmap(collect_seed)(learner, copies)

    def _update(self, learner, data):
        def update_seed(learner, data):
            _, key_update, key = jax.random.split(learner.key, 3)
            learner, metrics = ppo.update(
                self.net, self.config, learner, data, self._own(key_update), self.parts
            )
            return learner.replace(key=key), metrics

        return jax.vmap(update_seed)(learner, data)

    def advance(self, state: Training) -> tuple[Training, dict[str, Array]]:
        """One rollout and one update; returns the next state and metrics `[seed]`."""
        copies, data = self.collect(state.learner, state.copies)
        learner, metrics = self.update(state.learner, data)
        return Training(learner, copies), metrics

    def start(self, seeds) -> Training:
        """A fresh training of each of `[seed]` seeds."""
        keys = jax.vmap(jax.random.PRNGKey)(jnp.asarray(seeds))
        keys = jax.vmap(lambda key: jax.random.split(key))(keys)
        learner = jax.jit(
            jax.vmap(
                lambda key: ppo.initialize(self.net, self.env.observation_size, self.config, key)
            )
        )(keys[:, 0])
        return self.place(Training(learner, self.reset(keys[:, 1])))

    def place(self, training: Training) -> Training:
        """The same state on the devices: learners on all of them, copies shared out."""
        return Training(
            jax.device_put(training.learner, self._whole),
            jax.device_put(training.copies, self._split),
        )


class SacPrograms:
    """Compiled programs of one SAC training, on one device."""

    def __init__(self, env: base.Env, net: ActorCritic, config: sac.SacConfig, devices=None):
        self.env, self.net, self.config = env, net, config
        self.device = (devices or jax.local_devices())[0]
        self.collect = jax.jit(jax.vmap(self._collect), compiler_options=_options(env))
        self.remember = jax.jit(jax.vmap(self._remember))
        self.improve = jax.jit(jax.vmap(self._improve))
        self.report = jax.jit(jax.vmap(sac.report))

    def _collect(self, learner, copies):
        key = jax.random.fold_in(learner.key, 0)
        return sac.collect(self.env, self.net, self.config, learner, copies, key)

    def _remember(self, learner, data):
        learner = sac.remember(self.env, self.config, learner, data)
        return learner.replace(key=jax.random.fold_in(learner.key, 1))

    def _improve(self, learner):
        return sac.improve(self.env, self.net, self.config, learner)

    def advance(self, state: Training) -> tuple[Training, dict[str, Array]]:
        """One rollout, and gradient steps after the warm-up; returns state and metrics `[seed]`."""
        copies, data = self.collect(state.learner, state.copies)
        learner, terms = self.remember(state.learner, data), {}
        if int(learner.iteration[0]) * self.config.steps_per_iteration >= self.config.warmup:
            # fields are replaced out here: a program that returned the replay would copy it
            changed, terms = self.improve(learner)
            learner = learner.replace(**changed)
        return Training(learner, copies), self.report(data, terms)

    def start(self, seeds) -> Training:
        """A fresh training of each of `[seed]` seeds."""

        def start_seed(key):
            key_learner, key_copies = jax.random.split(key)
            learner = sac.initialize(self.env, self.net, self.config, key_learner)
            return Training(learner, base.start_copies(self.env, key_copies, self.config.envs))

        keys = jax.vmap(jax.random.PRNGKey)(jnp.asarray(seeds))
        return self.place(jax.jit(jax.vmap(start_seed))(keys))

    def place(self, training: Training) -> Training:
        """The same state on the device of the programs."""
        return jax.device_put(training, self.device)


def make_programs(env: base.Env, net: ActorCritic, config: Config, devices=None):
    """Programs of the algorithm that the settings select.

    Args:
        env: environment to learn in.
        net: from `networks.make_networks` or `sac.make_networks`.
        config: settings.
        devices: to use; see `pick_devices` if None.
    """
    if isinstance(config, sac.SacConfig):
        return SacPrograms(env, net, config, devices)
    return PpoPrograms(env, net, config, devices)
