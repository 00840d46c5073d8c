# SPDX-License-Identifier: MIT
"""Networks and action distributions of the agents, from brax's parts."""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
from brax.training import distribution, networks
from brax.training.acme import running_statistics, specs
from jax import Array

from hybrid_jax.types import pytree

FIRST_ACTIONS = 0.01
"""Factor on the last layer of a fresh policy: at first every action is near the neutral one."""


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


def make_networks(
    observations: int, actions: int, hidden: tuple[int, ...], discrete: bool
) -> ActorCritic:
    """Actor and critic on normalised observations."""
    kind = Categorical(actions) if discrete else distribution.NormalTanhDistribution(actions)
    shared = dict(
        preprocess_observations_fn=running_statistics.normalize,
        hidden_layer_sizes=hidden,
        activation=jax.nn.tanh,
    )
    return ActorCritic(
        networks.make_policy_network(kind.param_size, observations, **shared),
        networks.make_value_network(observations, **shared),
        kind,
    )


def fresh_policy(net: ActorCritic, key: Array) -> Any:
    """Random parameters of the policy with a weak last layer."""
    params = net.policy.init(key)
    layers = params["params"]
    last = max(layers, key=lambda name: int(name.rpartition("_")[2]))
    kernel = FIRST_ACTIONS * layers[last]["kernel"]
    return {**params, "params": {**layers, last: {**layers[last], "kernel": kernel}}}


def blank_statistics(observations: int):
    """Running mean and deviation of observations before the first one."""
    return running_statistics.init_state(specs.Array((observations,), jnp.float32))


def blank_policy(net: ActorCritic, observations: int) -> Policy:
    """A policy of the right shape, to load a trained one into."""
    return Policy(net.policy.init(jax.random.PRNGKey(0)), blank_statistics(observations))


def act(
    net: ActorCritic, policy: Policy, obs: Array, key: Array | None, spread: float | Array = 1.0
) -> Array:
    """Action for one observation or a batch; the most likely one if there is no key.

    Args:
        spread: factor on the distance of the sample from the mode, before it is squashed
            (continuous actions only).
    """
    logits = net.policy.apply(policy.normalizer, policy.params, obs)
    if key is None:
        return net.actions.mode(logits)
    raw = net.actions.sample_no_postprocessing(logits, key)
    if not net.actions.reparametrizable:
        return net.actions.postprocess(raw)
    middle = jnp.split(logits, 2, axis=-1)[0]
    return net.actions.postprocess(middle + spread * (raw - middle))
