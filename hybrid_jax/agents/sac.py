# SPDX-License-Identifier: MIT
"""Soft actor-critic on brax's networks and losses: the off-policy alternative to PPO.

Several seeds train side by side (a leading axis of every array), spread over the devices.
Reference: Haarnoja et al., arXiv:1812.05905.
"""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import optax
from brax.training import replay_buffers
from brax.training.acme import running_statistics
from brax.training.agents.sac import losses
from brax.training.agents.sac import networks as sac_networks
from brax.training.types import Transition
from jax import Array

from hybrid_jax.agents import networks
from hybrid_jax.agents.networks import ActorCritic
from hybrid_jax.envs import base
from hybrid_jax.errors import InputError
from hybrid_jax.types import Record, pytree


@dataclass(frozen=True)
class SacConfig:
    """Settings of a training."""

    steps: int = 1_000_000
    """Environment steps of the whole training, over all copies."""
    envs: int = 64
    """Copies of the environment."""
    unroll: int = 16
    """Steps of each copy in a rollout."""
    updates: int = 40
    """Gradient steps of every network after each rollout."""
    batch: int = 256
    """Transitions of a gradient step."""
    warmup: int = 10_240
    """Steps before the first update, with an untrained policy."""
    replay: int = 100_000
    """Transitions that are kept; the oldest go first."""
    learning_rate: float = 3e-4
    discount: float = 0.99
    polyak: float = 0.005
    """Soft update of the target critics."""
    hidden: tuple[int, ...] = (64, 64)
    """Widths of the hidden layers, actor and critics alike."""
    seed: int = 0

    def __post_init__(self):
        if not 0 <= self.discount <= 1:
            raise InputError(f"discount must lie in [0, 1], got {self.discount}")
        if self.steps_per_iteration > self.replay:
            raise InputError(
                f"replay {self.replay} must hold a rollout of envs * unroll = "
                f"{self.steps_per_iteration} transitions"
            )

    @property
    def steps_per_iteration(self) -> int:
        """Environment steps of a rollout."""
        return self.envs * self.unroll

    @property
    def iterations(self) -> int:
        """Rollouts of the whole training."""
        return max(1, self.steps // self.steps_per_iteration)


class Ring(replay_buffers.UniformSamplingQueue):
    """brax's queue as a ring buffer.

    brax rolls the rows of a full queue, which under `vmap` moves all of them at every insert.
    Here positions count all transitions ever inserted; sampling takes them modulo the size.
    """

    def insert_internal(self, buffer_state, samples):
        """Insert `[transition, ...]` samples; they replace the oldest ones in a full buffer."""
        update, size = self._flatten_fn(samples), self._data_shape[0]
        end = buffer_state.insert_position + len(update)
        rows = (buffer_state.insert_position + jnp.arange(len(update))) % size
        return buffer_state.replace(  # pyright: ignore[reportAttributeAccessIssue]: flax adds it
            data=buffer_state.data.at[rows].set(update, unique_indices=True),
            insert_position=end,
            sample_position=jnp.maximum(0, end - size),
        )


@pytree
class SacLearner(Record):
    """State of a training, without the copies of the environment."""

    params: Any
    """Parameters under `policy`, `critic` and `alpha` (logarithm of the entropy's weight)."""
    target: Any
    """Parameters of the target critics."""
    optimizer: Any
    """One state for each entry of `params`."""
    normalizer: Any
    """Running mean and deviation of observations."""
    replay: Any
    key: Array
    iteration: Array


def make_networks(observations: int, actions: int, hidden: tuple[int, ...]) -> ActorCritic:
    """Actor and two critics (of observation and action) on normalised observations.

    Args:
        observations: length of an observation.
        actions: length of an action.
        hidden: widths of the hidden layers, actor and critics alike.
    """
    parts = sac_networks.make_sac_networks(
        observations,
        actions,
        running_statistics.normalize,  # pyright: ignore[reportArgumentType]: brax's own default
        hidden,
        jax.nn.relu,
    )
    return ActorCritic(parts.policy_network, parts.q_network, parts.parametric_action_distribution)


def _losses(net: ActorCritic, config: SacConfig, actions: int):
    nets: Any = sac_networks.SACNetworks  # a flax dataclass: its constructor comes without types
    nets = nets(net.policy, net.value, net.actions)
    return losses.make_losses(nets, 1.0, config.discount, actions)


def _queue(env: base.Env, config: SacConfig) -> Ring:
    number, obs = jnp.zeros(()), jnp.zeros(env.observation_size)
    sample = Transition(
        obs,
        jnp.zeros(env.action_size),
        number,
        number,
        obs,
        {"state_extras": {"truncation": number}},  # pyright: ignore[reportArgumentType]: a tree
    )
    return Ring(config.replay, sample, config.batch)


def initialize(env: base.Env, net: ActorCritic, config: SacConfig, key: Array) -> SacLearner:
    """Start one seed with fresh networks and an empty replay."""
    key_policy, key_critic, key = jax.random.split(key, 3)
    params = {
        "policy": networks.fresh_policy(net, key_policy),
        "critic": net.value.init(key_critic),
        "alpha": jnp.zeros(()),
    }
    adam = optax.adam(config.learning_rate)
    return SacLearner(
        params=params,
        target=params["critic"],
        optimizer={name: adam.init(part) for name, part in params.items()},
        normalizer=networks.blank_statistics(env.observation_size),
        replay=_queue(env, config).init(key),
        key=key,
        iteration=jnp.zeros((), jnp.int32),
    )


def collect(env, net: ActorCritic, config: SacConfig, learner: SacLearner, copies, key):
    """A rollout with the present policy.

    Args:
        env: environment.
        net: networks.
        config: settings.
        learner: one seed.
        copies: running copies.
        key: consumed.

    Returns:
        The copies, and `[step, copy, ...]` arrays as of `envs.base.rollout`, with `action`; further
        `last_obs` `[copy, obs]`, and `cut` and `cut_gained` `[copy]` of `envs.base.cut_truncated`.
    """
    policy = networks.Policy(learner.params["policy"], learner.normalizer)

    def choose(obs, key):
        action = networks.act(net, policy, obs, key)
        return action, {"action": action}

    key_steps, key_cut = jax.random.split(key)
    copies, data = base.rollout(env, choose, copies, key_steps, config.unroll)
    data["last_obs"] = copies.obs
    copies, cut = base.cut_truncated(env, copies, key_cut)
    return copies, data | cut


def transitions(data) -> Transition:
    """Transitions of a rollout.

    The observation after a terminated step is of the next episode; its discount of 0 hides it.
    brax's critics skip transitions marked as truncated: here those whose `kept` is 0.

    Args:
        data: `[step, copy, ...]` from `collect`.

    Returns:
        `[step * copy, ...]` transitions.
    """
    skipped = jnp.zeros_like(data["reward"]) if data["kept"] is None else 1 - data["kept"]
    next_obs = jnp.concatenate([data["obs"][1:], data["last_obs"][None]])
    rows = Transition(
        data["obs"],
        data["action"],
        data["reward"],
        1 - data["terminated"],
        next_obs,
        {"state_extras": {"truncation": skipped}},  # pyright: ignore[reportArgumentType]: a tree
    )
    return jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:]), rows)


def improve(env: base.Env, net: ActorCritic, config: SacConfig, learner: SacLearner):
    """Gradient steps of all networks on samples from the replay.

    Args:
        env: environment.
        net: networks.
        config: settings.
        learner: one seed.

    Returns:
        The learner's changed fields by name, and scalar mean losses.
    """
    alpha_loss, critic_loss, actor_loss = _losses(net, config, env.action_size)
    adam, normal = optax.adam(config.learning_rate), learner.normalizer
    queue, replay = _queue(env, config), learner.replay

    def step(carry, key):
        params, target, optimizer = carry
        key_draw, key = jax.random.split(key)
        _, batch = queue.sample_internal(replay.replace(key=key_draw))
        alpha = jnp.exp(params["alpha"])
        keys = jax.random.split(key, 3)
        values_and_grads = {
            "alpha": jax.value_and_grad(alpha_loss)(
                params["alpha"], params["policy"], normal, batch, keys[0]
            ),
            "critic": jax.value_and_grad(critic_loss)(
                params["critic"], params["policy"], normal, target, alpha, batch, keys[1]
            ),
            "policy": jax.value_and_grad(actor_loss)(
                params["policy"], normal, params["critic"], alpha, batch, keys[2]
            ),
        }
        new_params, states = {}, {}
        for name, (_, grads) in values_and_grads.items():
            update, states[name] = adam.update(grads, optimizer[name])
            new_params[name] = optax.apply_updates(params[name], update)
        target = optax.incremental_update(new_params["critic"], target, config.polyak)
        return (new_params, target, states), {
            f"{n}_loss": v[0] for n, v in values_and_grads.items()
        }

    key, next_key = jax.random.split(learner.key)
    start = (learner.params, learner.target, learner.optimizer)
    final, terms = jax.lax.scan(step, start, jax.random.split(key, config.updates))
    params, target, optimizer = final
    changed = dict(params=params, target=target, optimizer=optimizer, key=next_key)
    return changed, jax.tree.map(jnp.mean, terms)


def remember(env: base.Env, config: SacConfig, learner: SacLearner, data) -> SacLearner:
    """The learner with a rollout in its replay; nothing else happens during the warm-up.

    Args:
        env: environment.
        config: settings.
        learner: one seed.
        data: `[step, copy, ...]` from `collect`.
    """
    return learner.replace(
        replay=_queue(env, config).insert_internal(learner.replay, transitions(data)),
        normalizer=running_statistics.update(learner.normalizer, data["obs"]),
        iteration=learner.iteration + 1,
    )


def report(data, terms) -> dict[str, Array]:
    """Scalar metrics: means of reward, `info` and loss terms, and of the episodes that ended.

    Args:
        data: `[step, copy, ...]` from `collect`.
        terms: loss terms of any shape.
    """
    means = jax.tree.map(jnp.mean, {"reward": data["reward"], **data["info"], **terms})
    return means | base.episode_means(base.episode_sums(data))
