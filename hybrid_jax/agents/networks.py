# SPDX-License-Identifier: MIT
"""Networks and action distributions of the agents, from brax's parts."""

import functools
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
from brax.training import distribution, networks
from brax.training.acme import running_statistics, specs
from jax import Array

from hybrid_jax.types import Record, pytree

FIRST_ACTIONS = 0.01
"""Factor on the last layer of a fresh policy: its first actions are close to the neutral one."""


class Categorical(distribution.ParametricDistribution):
    """Categorical distribution with the interface of brax's distributions.

    Parameters are logits `[..., n]`, actions and events indices `[...]`.
    """

    def __init__(self, n: int):
        super().__init__(param_size=n, postprocessor=None, event_ndims=0, reparametrizable=False)

    def create_dist(self, parameters):
        """The logits `[..., n]` themselves."""
        return parameters

    def postprocess(self, event):
        """The indices `[...]` themselves."""
        return event

    def mode(self, parameters):
        """Most likely index `[...]` under logits `[..., n]`."""
        return jnp.argmax(parameters, axis=-1)

    def sample_no_postprocessing(self, parameters, seed):
        """Random index `[...]` under logits `[..., n]`."""
        return jax.random.categorical(seed, parameters)

    def sample(self, parameters, seed):
        """Random index `[...]` under logits `[..., n]`."""
        return self.sample_no_postprocessing(parameters, seed)

    def log_prob(self, parameters, actions):
        """Log probability `[...]` of indices `[...]` under logits `[..., n]`."""
        table = jax.nn.log_softmax(parameters)
        return jnp.take_along_axis(table, actions[..., None], axis=-1)[..., 0]

    def entropy(self, parameters, seed):
        """Entropy `[...]` [nat] of logits `[..., n]`; exact, so the seed is not used."""
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
class Policy(Record):
    """The part of a trained agent that is needed to act."""

    params: Any
    """Parameters of the policy network."""
    normalizer: Any
    """Running mean and deviation of observations."""


def make_networks(
    observations: int, actions: int, hidden: tuple[int, ...], discrete: bool
) -> ActorCritic:
    """Actor and critic on normalised observations.

    Args:
        observations: length of an observation.
        actions: length of an action, or number of choices.
        hidden: widths of the hidden layers, actor and critic alike.
        discrete: choose one of `actions`, or give so many numbers within -1 and 1.
    """
    action_distribution = (
        Categorical(actions) if discrete else distribution.NormalTanhDistribution(actions)
    )
    policy, value = (
        functools.partial(
            make,
            preprocess_observations_fn=running_statistics.normalize,
            hidden_layer_sizes=hidden,
            activation=jax.nn.tanh,
        )
        for make in (networks.make_policy_network, networks.make_value_network)
    )
    return ActorCritic(
        policy(action_distribution.param_size, observations),
        value(observations),
        action_distribution,
    )


def fresh_policy(net: ActorCritic, key: Array) -> Any:
    """Random parameters of the policy, with a last layer scaled by `FIRST_ACTIONS`."""
    params = net.policy.init(key)
    layers = params["params"]
    # layers are numbered at the end of their names: the highest is the output
    last = max(layers, key=lambda name: int(name.rpartition("_")[2]))
    kernel = FIRST_ACTIONS * layers[last]["kernel"]
    return {**params, "params": {**layers, last: {**layers[last], "kernel": kernel}}}


def blank_statistics(observations: int):
    """Running mean and deviation `[observations]` before the first observation."""
    return running_statistics.init_state(specs.Array((observations,), jnp.float32))


def blank_policy(net: ActorCritic, observations: int) -> Policy:
    """A policy with arrays of the right shapes, as a template to load a trained one into."""
    return Policy(net.policy.init(jax.random.PRNGKey(0)), blank_statistics(observations))


def act(
    net: ActorCritic, policy: Policy, obs: Array, key: Array | None, spread: float | Array = 1.0
) -> Array:
    """Action for one observation or a batch.

    Args:
        net: networks.
        policy: their parameters.
        obs: `[..., obs]`.
        key: for a sample; the most likely action if None.
        spread: factor on the distance of the sample from the mode, before it is squashed; scalar
            or `[..., 1]` (continuous actions only).

    Returns:
        `[..., action]` numbers within -1 and 1, or `[...]` indices of choices.
    """
    logits = net.policy.apply(policy.normalizer, policy.params, obs)
    if key is None:
        return net.actions.mode(logits)
    raw = net.actions.sample_no_postprocessing(logits, key)
    if not net.actions.reparametrizable:
        return net.actions.postprocess(raw)
    # parameters of a normal distribution: location, then scale before its softplus
    location = jnp.split(logits, 2, axis=-1)[0]
    return net.actions.postprocess(location + spread * (raw - location))
