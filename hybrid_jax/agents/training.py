# SPDX-License-Identifier: MIT
"""The host's side of a training: compile, loop, report, stop where something breaks."""

import functools
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from hybrid_jax.agents import networks, ppo, worlds
from hybrid_jax.agents.networks import ActorCritic
from hybrid_jax.devices import vector_options
from hybrid_jax.errors import TrainingError
from hybrid_jax.types import pytree


@pytree
class Training:
    """A training that can go on; the leading axis of every array runs over seeds."""

    learner: ppo.Learner
    copies: worlds.Copies

    def policy(self, seed: int = 0) -> networks.Policy:
        """The present policy of one seed."""
        learner = jax.tree.map(lambda a: a[seed], self.learner)
        return networks.Policy(learner.params["policy"], learner.normalizer)


Report = Callable[[int, Training, dict[str, np.ndarray]], None]
"""Called after each update with steps done, the training and its metrics `[seed]`."""


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


@jax.jit
def _finite(tree: Any) -> jax.Array:
    """Are all numbers of a pytree finite?"""
    return jnp.all(jnp.stack([jnp.all(jnp.isfinite(a)) for a in jax.tree.leaves(tree)]))


class Programs:
    """The compiled parts of one PPO training, over some devices."""

    def __init__(self, world: worlds.World, net: ActorCritic, config: ppo.PpoConfig, devices=None):
        self.world, self.net, self.config = world, net, config
        devices = devices or pick_devices(config)
        self.parts = len(devices)
        mesh = Mesh(np.array(devices), (ppo.AXIS,))
        whole, split = PartitionSpec(), PartitionSpec(None, ppo.AXIS)
        late = PartitionSpec(None, None, ppo.AXIS)
        kinds = dict.fromkeys(("last_obs", "cut"), split)
        self._whole, self._split = NamedSharding(mesh, whole), NamedSharding(mesh, split)
        spread = functools.partial(jax.shard_map, mesh=mesh, check_vma=False)
        data = {k: late for k in ("obs", "action", "log_prob", "reward", "terminated", "success",
                                  "facts")} | kinds  # fmt: skip
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


def train(
    world: worlds.World,
    net: ActorCritic,
    config: ppo.PpoConfig,
    *,
    seeds: tuple[int, ...] | None = None,
    state: Training | None = None,
    report: Report | None = None,
    devices=None,
) -> Training:
    """Train until `config.steps`.

    Args:
        world: what to learn in.
        net: from `make_networks`.
        config: settings.
        seeds: one training each, side by side; `config.seed` alone if None.
        state: where an earlier training stopped; fresh if None.
        report: called after each update (metrics contain `rate`, steps/s of each seed).
        devices: to spread over; as many as divide copies and minibatch if None.

    Raises:
        TrainingError: a number is not finite; the message names it and the step.
    """
    programs = Programs(world, net, config, devices)
    state = programs.start(seeds or (config.seed,)) if state is None else programs.place(state)
    for iteration in range(int(state.learner.iteration[0]), config.iterations):
        began = time.perf_counter()
        copies, data = programs.collect(state.learner, state.copies)
        learner, metrics = programs.update(state.learner, data)
        state = Training(learner, copies)
        values = jax.device_get(metrics)
        steps = (iteration + 1) * config.steps_per_iteration
        broken = [k for k, v in values.items() if not np.isfinite(v).all()]
        if not jax.device_get(_finite(learner.params)):
            # the last gradient step of an update shows in its parameters only
            broken.append("parameters")
        if broken:
            raise TrainingError(f"training broke at step {steps}: {', '.join(broken)} not finite")
        if report:
            rate = config.steps_per_iteration / (time.perf_counter() - began)
            report(steps, state, values | {"rate": np.full_like(values["reward"], rate)})
    return state
