# SPDX-License-Identifier: MIT
"""The compiled parts of a training: where its arrays lie, how it starts and how it advances."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from hybrid_jax.agents import networks, ppo, sac, worlds
from hybrid_jax.agents.networks import ActorCritic
from hybrid_jax.devices import vector_options
from hybrid_jax.types import pytree

Config = ppo.PpoConfig | sac.SacConfig
"""Settings of a training; their type says which algorithm."""


@pytree
class Training:
    """A training that can go on; the leading axis of every array runs over seeds."""

    learner: ppo.Learner | sac.SacLearner
    copies: worlds.Copies

    def policy(self, seed: int = 0) -> networks.Policy:
        """The present policy of one seed."""
        learner = self.learner
        found = networks.Policy(learner.params["policy"], learner.normalizer)
        # free of the devices that trained it: they would all repeat what one can do
        return jax.tree.map(lambda a: a[seed], jax.device_get(found))


FEWEST_SAMPLES = 256
"""Samples of a minibatch that a device must have for its help to outweigh averaging gradients."""


def pick_devices(config: ppo.PpoConfig) -> list[Any]:
    """As many devices as share copies and minibatches evenly, and have enough of the latter."""
    devices = jax.local_devices()
    return devices[: max(
        n for n in range(1, len(devices) + 1)
        if n == 1 or (config.envs % n == 0 and config.minibatch % n == 0
                      and config.minibatch // n >= FEWEST_SAMPLES)
    )]  # fmt: skip


class PpoPrograms:
    """The compiled parts of one PPO training, over some devices."""

    def __init__(self, world: worlds.World, net: ActorCritic, config: ppo.PpoConfig, devices=None):
        self.world, self.net, self.config = world, net, config
        devices = devices or pick_devices(config)
        self.parts = len(devices)
        mesh = Mesh(np.array(devices), (ppo.AXIS,))
        whole, split = PartitionSpec(), PartitionSpec(None, ppo.AXIS)
        late = PartitionSpec(None, None, ppo.AXIS)
        kinds = dict.fromkeys(("last_obs", "cut", "cut_gained"), split)
        self._whole, self._split = NamedSharding(mesh, whole), NamedSharding(mesh, split)
        spread = functools.partial(jax.shard_map, mesh=mesh, check_vma=False)
        data = {k: late for k in ("obs", "action", "log_prob", "reward", "terminated", "success",
                                  "gained", "facts", "kept")} | kinds  # fmt: skip
        self.begin = jax.jit(spread(self._begin, in_specs=whole, out_specs=split))
        self.collect = jax.jit(
            spread(self._collect, in_specs=(whole, split), out_specs=(split, data)),
            compiler_options=vector_options(),
        )
        self.update = jax.jit(
            spread(self._update, in_specs=(whole, data), out_specs=(whole, whole))
        )

    def _own(self, key):
        """This device's key."""
        return jax.random.fold_in(key, jax.lax.axis_index(ppo.AXIS))

    def _begin(self, keys):
        count = self.config.envs // self.parts
        return jax.vmap(lambda key: worlds.start_copies(self.world, self._own(key), count))(keys)

    def _collect(self, learner, copies):
        def one(learner, copies):
            key = self._own(jax.random.split(learner.key, 3)[0])
            return ppo.collect(self.world, self.net, self.config, learner, copies, key)

        return jax.vmap(one)(learner, copies)

    def _update(self, learner, data):
        def one(learner, data):
            _, key_update, key = jax.random.split(learner.key, 3)
            learner, metrics = ppo.update(
                self.net, self.config, learner, data, self._own(key_update), self.parts
            )
            return learner.replace(key=key), metrics

        return jax.vmap(one)(learner, data)

    def advance(self, state: Training) -> tuple[Training, dict[str, Array]]:
        """One rollout, one update."""
        copies, data = self.collect(state.learner, state.copies)
        learner, metrics = self.update(state.learner, data)
        return Training(learner, copies), metrics

    def start(self, seeds) -> Training:
        """A fresh training of each seed."""
        keys = jax.vmap(jax.random.PRNGKey)(jnp.asarray(seeds))
        keys = jax.vmap(lambda key: jax.random.split(key))(keys)
        learner = jax.jit(jax.vmap(
            lambda key: ppo.initialize(self.net, self.world.observation_size, self.config, key)
        ))(keys[:, 0])  # fmt: skip
        return self.place(Training(learner, self.begin(keys[:, 1])))

    def place(self, training: Training) -> Training:
        """The same, where the programs expect it."""
        return Training(
            jax.device_put(training.learner, self._whole),
            jax.device_put(training.copies, self._split),
        )


class SacPrograms:
    """The compiled parts of one SAC training, on one device."""

    def __init__(self, world: worlds.World, net: ActorCritic, config: sac.SacConfig, devices=None):
        self.world, self.net, self.config = world, net, config
        self.device = (devices or jax.local_devices())[0]
        self.collect = jax.jit(jax.vmap(self._collect), compiler_options=vector_options())
        self.remember = jax.jit(jax.vmap(self._remember))
        self.improve = jax.jit(jax.vmap(self._improve))
        self.report = jax.jit(jax.vmap(sac.report))

    def _collect(self, learner, copies):
        key = jax.random.fold_in(learner.key, 0)
        return sac.collect(self.world, self.net, self.config, learner, copies, key)

    def _remember(self, learner, data):
        learner = sac.remember(self.world, self.config, learner, data)
        return learner.replace(key=jax.random.fold_in(learner.key, 1))

    def _improve(self, learner):
        return sac.improve(self.world, self.net, self.config, learner)

    def advance(self, state: Training) -> tuple[Training, dict[str, Array]]:
        """One rollout; gradient steps once the warm-up is over."""
        copies, data = self.collect(state.learner, state.copies)
        learner, terms = self.remember(state.learner, data), {}
        if int(learner.iteration[0]) * self.config.steps_per_iteration >= self.config.warmup:
            # outside of the program, which would copy the replay
            changed, terms = self.improve(learner)
            learner = learner.replace(**changed)
        return Training(learner, copies), self.report(data, terms)

    def start(self, seeds) -> Training:
        """A fresh training of each seed."""

        def one(key):
            key_learner, key_copies = jax.random.split(key)
            learner = sac.initialize(self.world, self.net, self.config, key_learner)
            return Training(learner, worlds.start_copies(self.world, key_copies, self.config.envs))

        keys = jax.vmap(jax.random.PRNGKey)(jnp.asarray(seeds))
        return self.place(jax.jit(jax.vmap(one))(keys))

    def place(self, training: Training) -> Training:
        """The same, where the programs expect it."""
        return jax.device_put(training, self.device)


def make_programs(world: worlds.World, net: ActorCritic, config: Config, devices=None):
    """Of the algorithm that the settings are for.

    Args:
        world: what to learn in.
        net: from `networks.make_networks` or `sac.make_networks`.
        config: settings.
        devices: to use; as many as it pays to if None.
    """
    kind = SacPrograms if isinstance(config, sac.SacConfig) else PpoPrograms
    return kind(world, net, config, devices)
