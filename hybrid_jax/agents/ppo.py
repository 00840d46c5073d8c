# SPDX-License-Identifier: MIT
"""Proximal policy optimisation, continuous and categorical, on brax's parts.

Rollout and update are two compiled programs: on a CPU that is several times faster than one.
Several seeds train side by side (a leading axis of every array), the copies of the environment are
spread over the devices, and gradients are averaged over them.
Reference: Schulman et al., arXiv:1707.06347.
"""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import optax
from brax.training.acme import running_statistics
from brax.training.agents.ppo.losses import compute_gae
from jax import Array

from hybrid_jax.agents import networks
from hybrid_jax.agents.networks import ActorCritic
from hybrid_jax.envs import base
from hybrid_jax.errors import InputError
from hybrid_jax.types import Record, pytree

AXIS = "copies"
"""Name of the mesh axis over which the copies of the environment are spread."""


@dataclass(frozen=True)
class PpoConfig:
    """Settings of a training."""

    steps: int = 1_000_000
    """Environment steps of the whole training, over all copies."""
    envs: int = 1024
    """Copies of the environment."""
    unroll: int = 16
    """Steps of each copy between updates."""
    epochs: int = 4
    """Passes over a rollout."""
    minibatch: int = 2048
    """Samples of a gradient step."""
    learning_rate: float = 1e-3
    discount: float = 0.99
    gae_lambda: float = 0.95
    clip: float = 0.2
    """Largest change of a probability ratio that the objective rewards."""
    entropy: float = 2e-3
    """Coefficient of the entropy bonus (`c_1`)."""
    value: float = 0.5
    """Coefficient of the value loss (`c_2`)."""
    max_grad_norm: float = 0.5
    hidden: tuple[int, ...] = (64, 64)
    """Widths of the hidden layers, actor and critic alike."""
    seed: int = 0

    def __post_init__(self):
        if not 0 <= self.discount <= 1:
            raise InputError(f"discount must lie in [0, 1], got {self.discount}")
        if (self.envs * self.unroll) % self.minibatch:
            raise InputError(
                f"minibatch {self.minibatch} must divide envs * unroll = {self.envs * self.unroll}"
            )

    @property
    def steps_per_iteration(self) -> int:
        """Environment steps between updates."""
        return self.envs * self.unroll

    @property
    def iterations(self) -> int:
        """Updates of the whole training."""
        return max(1, self.steps // self.steps_per_iteration)


@pytree
class Learner(Record):
    """State of a training, without the copies of the environment."""

    params: Any
    """Parameters under `policy` and `value`."""
    optimizer: Any
    normalizer: Any
    """Running mean and deviation of observations."""
    key: Array
    iteration: Array


def make_optimizer(config: PpoConfig) -> optax.GradientTransformation:
    """Adam with clipped gradients, on one flat vector: a small network has many small arrays."""
    steps = optax.chain(
        optax.clip_by_global_norm(config.max_grad_norm), optax.adam(config.learning_rate, eps=1e-5)
    )
    return optax.flatten(steps)


def initialize(net: ActorCritic, observations: int, config: PpoConfig, key: Array) -> Learner:
    """Start one seed with fresh networks for observations `[observations]`."""
    key_policy, key_value, key_next = jax.random.split(key, 3)
    params = {"policy": networks.fresh_policy(net, key_policy), "value": net.value.init(key_value)}
    normalizer = networks.blank_statistics(observations)
    optimizer = make_optimizer(config).init(params)
    return Learner(params, optimizer, normalizer, key_next, jnp.zeros((), jnp.int32))


def collect(env, net: ActorCritic, config: PpoConfig, learner: Learner, copies, key):
    """A rollout with the present policy.

    Args:
        env: environment.
        net: networks.
        config: settings.
        learner: one seed.
        copies: running copies.
        key: consumed.

    Returns:
        The copies, and `[step, copy, ...]` arrays as of `envs.base.rollout`, with `action` before
        it is squashed and its `log_prob`; further `last_obs` `[copy, obs]`, and `cut` and
        `cut_gained` `[copy]` of `envs.base.cut_truncated`.
    """
    policy = networks.Policy(learner.params["policy"], learner.normalizer)

    def choose(obs, key):
        logits = net.policy.apply(policy.normalizer, policy.params, obs)
        raw = net.actions.sample_no_postprocessing(logits, key)
        extras = {"action": raw, "log_prob": net.actions.log_prob(logits, raw)}
        return net.actions.postprocess(raw), extras

    key_steps, key_cut = jax.random.split(key)
    copies, data = base.rollout(env, choose, copies, key_steps, config.unroll)
    # before truncated episodes begin anew: their last value continues from this observation
    data["last_obs"] = copies.obs
    copies, cut = base.cut_truncated(env, copies, key_cut)
    return copies, data | cut


def _mean_of(kept: Array | None):
    """A function that averages `[sample]` values over those with `kept` above 0; all if None."""
    if kept is None:
        return jnp.mean
    return lambda values: jnp.sum(kept * values) / jnp.maximum(jnp.sum(kept), 1.0)


def _loss(params, net: ActorCritic, normalizer, batch, config: PpoConfig, key):
    """Sum of the clipped surrogate, value and entropy terms, and each of them by name."""
    logits = net.policy.apply(normalizer, params["policy"], batch["obs"])
    values = net.value.apply(normalizer, params["value"], batch["obs"])
    log_ratio = net.actions.log_prob(logits, batch["action"]) - batch["log_prob"]
    if batch["kept"] is not None:  # nothing holds the others back: their ratios may overflow
        log_ratio = jnp.where(batch["kept"] > 0, log_ratio, 0.0)
    ratio = jnp.exp(log_ratio)
    mean = _mean_of(batch["kept"])
    advantage = batch["advantage"] - mean(batch["advantage"])
    advantage = advantage / (jnp.sqrt(mean(advantage**2)) + 1e-8)
    clipped = jnp.clip(ratio, 1 - config.clip, 1 + config.clip)
    terms = {
        "policy_loss": -mean(jnp.minimum(ratio * advantage, clipped * advantage)),
        "value_loss": config.value * mean((values - batch["target"]) ** 2),
    }
    if config.entropy:  # an estimate that nothing weighs would take a third of the step
        entropy = net.actions.entropy(logits, key)
        terms["entropy_loss"] = -config.entropy * mean(entropy)
    return sum(terms.values()), terms


def judge(net: ActorCritic, config: PpoConfig, learner: Learner, data) -> dict[str, Array]:
    """Samples of a rollout with value targets and advantages (GAE).

    Args:
        net: networks.
        config: settings.
        learner: one seed.
        data: `[step, copy, ...]` from `collect`.

    Returns:
        `obs`, `action`, `log_prob`, `kept`, `advantage` and `target`, `[step * copy, ...]` each.
    """
    apply = net.value.apply
    values = apply(learner.normalizer, learner.params["value"], data["obs"])
    last_values = apply(learner.normalizer, learner.params["value"], data["last_obs"])
    # first argument: truncation within the rollout; episodes are cut at its end only
    target, advantage = compute_gae(
        jnp.zeros_like(values),
        data["terminated"],
        data["reward"],
        values,
        last_values,
        config.gae_lambda,
        config.discount,
    )
    samples = {k: data[k] for k in ("obs", "action", "log_prob", "kept")}
    samples |= {"advantage": advantage, "target": target}
    return jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:]), samples)


def improve(
    net: ActorCritic, config: PpoConfig, learner: Learner, samples, key: Array, device_count: int
):
    """Passes of minibatch gradient steps; each device has its share of every minibatch.

    Args:
        net: networks.
        config: settings.
        learner: one seed.
        samples: `[sample, ...]` of this device.
        key: consumed.
        device_count: number of devices.

    Returns:
        (parameters, optimizer state), and loss terms `[epoch, minibatch]`.
    """
    optimizer = make_optimizer(config)
    count = samples["target"].shape[0]

    def minibatch(carry, part):
        params, opt = carry
        batch, key = part
        grads, terms = jax.grad(_loss, has_aux=True)(
            params, net, learner.normalizer, batch, config, key
        )
        changes, opt = optimizer.update(jax.lax.pmean(grads, AXIS), opt, params)
        return (optax.apply_updates(params, changes), opt), terms

    def epoch(carry, key):
        key_order, key_entropy = jax.random.split(key)
        order = jax.random.permutation(key_order, count)
        # one gather an epoch: one a minibatch is slower where minibatches are small
        batches = jax.tree.map(
            lambda a: a[order].reshape(-1, config.minibatch // device_count, *a.shape[1:]), samples
        )
        keys = jax.random.split(key_entropy, count * device_count // config.minibatch)
        return jax.lax.scan(minibatch, carry, (batches, keys))

    keys = jax.random.split(key, config.epochs)
    return jax.lax.scan(epoch, (learner.params, learner.optimizer), keys)


def report(data, terms) -> dict[str, Array]:
    """Scalar metrics: means of reward, `info` and loss terms, and of the episodes that ended.

    Args:
        data: `[step, copy, ...]` of this device.
        terms: loss terms of any shape.
    """
    means = jax.tree.map(jnp.mean, {"reward": data["reward"], **data["info"], **terms})
    sums = jax.lax.psum(base.episode_sums(data), AXIS)
    return jax.lax.pmean(means, AXIS) | base.episode_means(sums)


def update(
    net: ActorCritic, config: PpoConfig, learner: Learner, data, key: Array, device_count: int
):
    """The learner after one rollout, and scalar metrics.

    Args:
        net: networks.
        config: settings.
        learner: one seed.
        data: `[step, copy, ...]` from `collect`, of this device.
        key: consumed.
        device_count: number of devices.
    """
    samples = judge(net, config, learner, data)
    (params, opt), terms = improve(net, config, learner, samples, key, device_count)
    # for the next rollout: the stored `log_prob` belong to the present statistics
    normalizer = running_statistics.update(learner.normalizer, data["obs"], pmap_axis_name=AXIS)
    updated = learner.replace(params=params, optimizer=opt, normalizer=normalizer)
    return updated.replace(iteration=learner.iteration + 1), report(data, terms)
