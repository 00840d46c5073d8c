# SPDX-License-Identifier: MIT
"""Proximal policy optimisation, continuous and categorical, on brax's networks and distributions.

Rollout and update are two compiled programs with a short host loop around them: on a CPU that is
several times faster than one program, and the loop can report, stop and save.
Reference: Schulman et al., arXiv:1707.06347.
"""

import functools
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import optax
from brax.envs.base import Env
from brax.training import distribution, networks
from brax.training.acme import running_statistics, specs
from jax import Array

from hybrid_jax.errors import TrainingError
from hybrid_jax.types import pytree


@dataclass(frozen=True)
class PpoConfig:
    """Settings of one training."""

    steps: int = 1_000_000
    """Environment steps in all."""
    envs: int = 256
    """Copies of the environment."""
    unroll: int = 32
    """Steps of each copy between updates."""
    epochs: int = 4
    """Passes over a rollout."""
    minibatch: int = 1024
    """Samples of a gradient step."""
    learning_rate: float = 5e-4
    discount: float = 0.99
    gae_lambda: float = 0.95
    clip: float = 0.2
    """Largest change of a probability ratio."""
    entropy: float = 2e-3
    """Coefficient of the entropy bonus (`c_1`)."""
    value: float = 0.5
    """Coefficient of the value loss (`c_2`)."""
    max_grad_norm: float = 0.5
    hidden: tuple[int, ...] = (128, 128)
    """Widths of the hidden layers, actor and critic alike."""
    seed: int = 0

    def __post_init__(self):
        if not 0 <= self.discount <= 1:
            raise ValueError(f"discount must lie in [0, 1], got {self.discount}")
        if (self.envs * self.unroll) % self.minibatch:
            raise ValueError(
                f"minibatch {self.minibatch} must divide envs * unroll = {self.envs * self.unroll}"
            )

    @property
    def iterations(self) -> int:
        """Updates in all."""
        return max(1, self.steps // (self.envs * self.unroll))


class Categorical(distribution.ParametricDistribution):
    """A choice among `n`, in the shape of brax's distributions."""

    def __init__(self, n: int):
        super().__init__(param_size=n, postprocessor=None, event_ndims=0, reparametrizable=False)

    def create_dist(self, parameters):
        return parameters

    def postprocess(self, event):
        return event

    def mode(self, parameters):
        return jnp.argmax(parameters, axis=-1)

    def sample_no_postprocessing(self, parameters, seed):
        return jax.random.categorical(seed, parameters)

    def sample(self, parameters, seed):
        return self.sample_no_postprocessing(parameters, seed)

    def log_prob(self, parameters, actions):
        table = jax.nn.log_softmax(parameters)
        return jnp.take_along_axis(table, actions[..., None], axis=-1)[..., 0]

    def entropy(self, parameters, seed):
        del seed
        table = jax.nn.log_softmax(parameters)
        return -jnp.sum(jnp.exp(table) * table, axis=-1)


@dataclass(frozen=True)
class ActorCritic:
    """Networks and action distribution of an agent."""

    policy: networks.FeedForwardNetwork
    value: networks.FeedForwardNetwork
    actions: distribution.ParametricDistribution


@pytree
class Policy:
    """What acting needs of a trained agent."""

    params: Any
    normalizer: Any


@pytree
class PpoState:
    """Everything that a training continues from."""

    policy: Any
    value: Any
    optimizer: Any
    normalizer: Any
    env: Any
    key: Array
    iteration: Array


def make_networks(
    observations: int, actions: int, hidden: tuple[int, ...], discrete: bool
) -> ActorCritic:
    """Actor and critic on normalised observations."""
    kind = Categorical(actions) if discrete else distribution.NormalTanhDistribution(actions)
    shared = dict(
        preprocess_observations_fn=running_statistics.normalize,
        hidden_layer_sizes=hidden,
        activation=jax.nn.swish,
    )
    return ActorCritic(
        networks.make_policy_network(kind.param_size, observations, **shared),
        networks.make_value_network(observations, **shared),
        kind,
    )


def blank_policy(net: ActorCritic, observations: int) -> Policy:
    """A policy of the right shape, to load a trained one into."""
    normalizer = running_statistics.init_state(specs.Array((observations,), jnp.float32))
    return Policy(net.policy.init(jax.random.PRNGKey(0)), normalizer)


def act(net: ActorCritic, policy: Policy, obs: Array, key: Array | None) -> Array:
    """Action for one observation or a batch; the most likely one if there is no key."""
    logits = net.policy.apply(policy.normalizer, policy.params, obs)
    return net.actions.mode(logits) if key is None else net.actions.sample(logits, key)


def _optimizer(config: PpoConfig):
    return optax.chain(
        optax.clip_by_global_norm(config.max_grad_norm), optax.adam(config.learning_rate, eps=1e-5)
    )


def initialize(env: Env, net: ActorCritic, config: PpoConfig) -> PpoState:
    """Fresh networks and environments."""
    key_policy, key_value, key_env, key = jax.random.split(jax.random.PRNGKey(config.seed), 4)
    params = {"policy": net.policy.init(key_policy), "value": net.value.init(key_value)}
    normalizer = running_statistics.init_state(specs.Array((env.observation_size,), jnp.float32))
    states = jax.jit(jax.vmap(env.reset))(jax.random.split(key_env, config.envs))
    return PpoState(
        params["policy"],
        params["value"],
        _optimizer(config).init(params),
        normalizer,
        states,
        key,
        jnp.zeros((), jnp.int32),
    )


def _rollout(env: Env, net: ActorCritic, config: PpoConfig, state: PpoState, key: Array):
    """Run every copy for `unroll` steps; finished copies start anew. Time comes first."""
    policy = Policy(state.policy, state.normalizer)

    def step(before, key):
        key_act, key_reset = jax.random.split(key)
        logits = net.policy.apply(policy.normalizer, policy.params, before.obs)
        raw = net.actions.sample_no_postprocessing(logits, key_act)
        after = jax.vmap(env.step)(before, net.actions.postprocess(raw))
        fresh = jax.vmap(env.reset)(jax.random.split(key_reset, config.envs))
        done = after.done
        carry = jax.tree.map(
            lambda a, b: jnp.where(done.reshape(-1, *[1] * (a.ndim - 1)) > 0, b, a), after, fresh
        )
        data = {
            "obs": before.obs,
            "next_obs": after.obs,
            "action": raw,
            "log_prob": net.actions.log_prob(logits, raw),
            "reward": after.reward,
            "done": done,
            "truncation": after.info["truncation"],
            "success": after.metrics["success"],
        }
        return carry, data

    return jax.lax.scan(step, state.env, jax.random.split(key, config.unroll))


def advantages(
    reward: Array,
    value: Array,
    next_value: Array,
    terminated: Array,
    done: Array,
    discount: float,
    gae_lambda: float,
) -> Array:
    """Generalised advantages `[time, env]` (Schulman et al., arXiv:1506.02438).

    An episode that a time limit cut (`done` but not `terminated`) goes on from the value of its
    final observation. (brax's version instead takes such steps out: then nothing holds the value
    of the last states, and on short horizons it drifts off.)
    """
    surprise = reward + discount * (1 - terminated) * next_value - value

    def back(ahead, step):
        delta, ended = step
        ahead = delta + discount * gae_lambda * (1 - ended) * ahead
        return ahead, ahead

    return jax.lax.scan(back, jnp.zeros_like(reward[0]), (surprise, done), reverse=True)[1]


def _loss(params, net: ActorCritic, normalizer, batch, config: PpoConfig, key):
    """Clipped surrogate, value and entropy terms; returns each beside the sum."""
    logits = net.policy.apply(normalizer, params["policy"], batch["obs"])
    values = net.value.apply(normalizer, params["value"], batch["obs"])
    ratio = jnp.exp(net.actions.log_prob(logits, batch["action"]) - batch["log_prob"])
    advantage = batch["advantage"]
    advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
    clipped = jnp.clip(ratio, 1 - config.clip, 1 + config.clip)
    terms = {
        "policy_loss": -jnp.mean(jnp.minimum(ratio * advantage, clipped * advantage)),
        "value_loss": config.value * jnp.mean((values - batch["target"]) ** 2),
        "entropy_loss": -config.entropy * jnp.mean(net.actions.entropy(logits, key)),
    }
    return sum(terms.values()), terms


def _update(net: ActorCritic, config: PpoConfig, state: PpoState, env_state, data, key: Array):
    """Passes of minibatch gradient steps over one rollout."""
    normalizer = running_statistics.update(state.normalizer, data["obs"])
    values, later = (
        net.value.apply(state.normalizer, state.value, data[k]) for k in ("obs", "next_obs")
    )
    advantage = advantages(
        data["reward"],
        values,
        later,
        data["done"] * (1 - data["truncation"]),
        data["done"],
        config.discount,
        config.gae_lambda,
    )
    samples = {k: data[k] for k in ("obs", "action", "log_prob")}
    samples |= {"advantage": advantage, "target": values + advantage}
    count = config.envs * config.unroll
    samples = jax.tree.map(lambda a: a.reshape(count, *a.shape[2:]), samples)
    optimizer = _optimizer(config)

    def minibatch(carry, part):
        params, opt = carry
        index, key = part
        batch = jax.tree.map(lambda a: a[index], samples)
        grads, terms = jax.grad(_loss, has_aux=True)(
            params, net, state.normalizer, batch, config, key
        )
        changes, opt = optimizer.update(grads, opt, params)
        return (optax.apply_updates(params, changes), opt), terms

    def epoch(carry, key):
        key_order, key_entropy = jax.random.split(key)
        order = jax.random.permutation(key_order, count).reshape(-1, config.minibatch)
        return jax.lax.scan(minibatch, carry, (order, jax.random.split(key_entropy, len(order))))

    carry = ({"policy": state.policy, "value": state.value}, state.optimizer)
    (params, opt), terms = jax.lax.scan(epoch, carry, jax.random.split(key, config.epochs))
    finished = jnp.maximum(jnp.sum(data["done"]), 1.0)
    metrics = jax.tree.map(jnp.mean, terms) | {
        "reward": jnp.mean(data["reward"]),
        "episodes": jnp.sum(data["done"]),
        "success": jnp.sum(data["success"]) / finished,
        "return": jnp.sum(data["reward"]) / finished,
    }
    return state.replace(
        policy=params["policy"],
        value=params["value"],
        optimizer=opt,
        normalizer=normalizer,
        env=env_state,
    ), metrics


def train(
    env: Env,
    net: ActorCritic,
    config: PpoConfig,
    *,
    state: PpoState | None = None,
    report: Callable[[int, PpoState, dict[str, float]], None] | None = None,
) -> PpoState:
    """Train until `config.steps`.

    Args:
        env: one copy of the environment.
        net: from `make_networks`.
        config: settings.
        state: where an earlier training stopped; fresh if None.
        report: called after each update with steps done, state and metrics (and `rate`, steps/s).

    Raises:
        TrainingError: a loss term is not finite; the message names it and the step.
    """
    state = initialize(env, net, config) if state is None else state
    rollout = jax.jit(functools.partial(_rollout, env, net, config))
    update = jax.jit(functools.partial(_update, net, config))
    per_iteration = config.envs * config.unroll
    for iteration in range(int(state.iteration), config.iterations):
        began = time.perf_counter()
        key_rollout, key_update, key = jax.random.split(state.key, 3)
        env_state, data = rollout(state, key_rollout)
        state, metrics = update(state, env_state, data, key_update)
        state = state.replace(key=key, iteration=jnp.int32(iteration + 1))
        values = {k: float(v) for k, v in jax.device_get(metrics).items()}
        if not values["episodes"]:  # nothing ended: there is no success rate to speak of
            del values["success"], values["return"]
        steps = (iteration + 1) * per_iteration
        broken = [k for k, v in values.items() if not v == v or abs(v) == float("inf")]
        if broken:
            raise TrainingError(f"training broke at step {steps}: {', '.join(broken)} not finite")
        if report:
            report(steps, state, values | {"rate": per_iteration / (time.perf_counter() - began)})
    return state
