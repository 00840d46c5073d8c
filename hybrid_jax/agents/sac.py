# SPDX-License-Identifier: MIT
"""Soft actor-critic on brax's networks and losses: the off-policy rival of the joint agent.

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

from hybrid_jax.agents import networks, worlds
from hybrid_jax.agents.networks import ActorCritic
from hybrid_jax.errors import InputError
from hybrid_jax.types import pytree


@dataclass(frozen=True)
class SacConfig:
    """Settings of one training."""

    steps: int = 1_000_000
    """Environment steps in all."""
    envs: int = 64
    """Copies of the world."""
    unroll: int = 16
    """Steps of each copy between updates."""
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
        """Environment steps between updates."""
        return self.envs * self.unroll

    @property
    def iterations(self) -> int:
        """Rollouts in all."""
        return max(1, self.steps // self.steps_per_iteration)


class Ring(replay_buffers.UniformSamplingQueue):
    """brax's queue, which counts on where it would roll its rows: under `vmap` that moves them all.

    Positions are those of all transitions ever seen; sampling takes them modulo the size.
    """

    def insert_internal(self, buffer_state, samples):
        update, size = self._flatten_fn(samples), self._data_shape[0]
        end = buffer_state.insert_position + len(update)
        rows = (buffer_state.insert_position + jnp.arange(len(update))) % size
        return buffer_state.replace(
            data=buffer_state.data.at[rows].set(update, unique_indices=True),
            insert_position=end,
            sample_position=jnp.maximum(0, end - size),
        )


@pytree
class SacLearner:
    """Everything that a training continues from, but for the copies of the world."""

    params: Any
    """`policy`, `critic` and `alpha`: logarithm of the entropy's weight."""
    target: Any
    """Slow critics."""
    optimizer: Any
    """One state for each entry of `params`."""
    normalizer: Any
    replay: Any
    key: Array
    iteration: Array


def make_networks(observations: int, actions: int, hidden: tuple[int, ...]) -> ActorCritic:
    """Actor and two critics (of observation and action) on normalised observations."""
    made = sac_networks.make_sac_networks(
        observations, actions, running_statistics.normalize, hidden, jax.nn.relu
    )
    return ActorCritic(
        made.policy_network, made.q_network, made.parametric_action_distribution
    )


def _losses(net: ActorCritic, config: SacConfig, actions: int):
    parts = sac_networks.SACNetworks(net.policy, net.value, net.actions)
    return losses.make_losses(parts, 1.0, config.discount, actions)


def _queue(world: worlds.World, config: SacConfig) -> Ring:
    number, obs = jnp.zeros(()), jnp.zeros(world.observation_size)
    sample = Transition(
        obs, jnp.zeros(world.action_size), number, number, obs,
        {"state_extras": {"truncation": number}},
    )  # fmt: skip
    return Ring(config.replay, sample, config.batch)


def initialize(world: worlds.World, net: ActorCritic, config: SacConfig, key: Array) -> SacLearner:
    """Fresh networks and an empty replay; one seed."""
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
        normalizer=networks.blank_statistics(world.observation_size),
        replay=_queue(world, config).init(key),
        key=key,
        iteration=jnp.zeros((), jnp.int32),
    )


def collect(world, net: ActorCritic, config: SacConfig, learner: SacLearner, copies, key):
    """A rollout with the present policy."""
    policy = networks.Policy(learner.params["policy"], learner.normalizer)

    def choose(obs, key):
        action = networks.act(net, policy, obs, key)
        return action, {"action": action}

    key_steps, key_cut = jax.random.split(key)
    copies, data = worlds.rollout(world, choose, copies, key_steps, config.unroll)
    data["last_obs"] = copies.obs
    copies, cut = worlds.cut_overdue(world, copies, key_cut)
    return copies, data | cut


def transitions(data) -> Transition:
    """`[time * copy, ...]` of a rollout; nothing is read of what follows an end.

    brax's critics skip what is marked as truncated: here what is not to be learnt from.
    """
    skipped = jnp.zeros_like(data["reward"]) if data["kept"] is None else 1 - data["kept"]
    after = jnp.concatenate([data["obs"][1:], data["last_obs"][None]])
    rows = Transition(
        data["obs"], data["action"], data["reward"], 1 - data["terminated"], after,
        {"state_extras": {"truncation": skipped}},
    )  # fmt: skip
    return jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:]), rows)


def improve(world: worlds.World, net: ActorCritic, config: SacConfig, learner: SacLearner):
    """Gradient steps on what is remembered: the learner's changed fields, and the mean losses."""
    alpha_loss, critic_loss, actor_loss = _losses(net, config, world.action_size)
    adam, normal = optax.adam(config.learning_rate), learner.normalizer
    queue, replay = _queue(world, config), learner.replay

    def step(carry, key):
        params, target, optimizer = carry
        key_draw, key = jax.random.split(key)
        _, batch = queue.sample_internal(replay.replace(key=key_draw))
        alpha = jnp.exp(params["alpha"])
        keys = jax.random.split(key, 3)
        found = {
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
        changed, states = {}, {}
        for name, (_, gradient) in found.items():
            change, states[name] = adam.update(gradient, optimizer[name])
            changed[name] = optax.apply_updates(params[name], change)
        target = optax.incremental_update(changed["critic"], target, config.polyak)
        return (changed, target, states), {f"{n}_loss": v[0] for n, v in found.items()}

    key, following = jax.random.split(learner.key)
    start = (learner.params, learner.target, learner.optimizer)
    end, terms = jax.lax.scan(step, start, jax.random.split(key, config.updates))
    params, target, optimizer = end
    changed = dict(params=params, target=target, optimizer=optimizer, key=following)
    return changed, jax.tree.map(jnp.mean, terms)


def remember(world: worlds.World, config: SacConfig, learner: SacLearner, data) -> SacLearner:
    """The learner with a rollout in its replay; all that happens during the warm-up."""
    return learner.replace(
        replay=_queue(world, config).insert_internal(learner.replay, transitions(data)),
        normalizer=running_statistics.update(learner.normalizer, data["obs"]),
        iteration=learner.iteration + 1,
    )


def report(data, terms) -> dict[str, Array]:
    """Means over all copies: of reward, loss terms, facts, and of the episodes that ended."""
    means = jax.tree.map(jnp.mean, {"reward": data["reward"], **data["facts"], **terms})
    return means | worlds.episode_means(worlds.episode_sums(data))
