# SPDX-License-Identifier: MIT
"""Training of the hierarchical DQN of RL-LfD (paper, Algorithm 2; Kulkarni et al. 2016).

Many random tasks train at once in one compiled program. In every round each copy picks the end of
its next segment and tries several skills on it; the critic keeps the best of the tries. Choices
that do not exist or exceed the tolerance are masked: an infinite penalty would poison the targets.
"""

import functools
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from brax.training import replay_buffers
from jax import Array

from hybrid_jax.agents import hdqn_networks
from hybrid_jax.agents.hdqn_networks import Controllers
from hybrid_jax.errors import InputError
from hybrid_jax.runtime.compiler_options import quick_options
from hybrid_jax.runtime.kept_programs import kept
from hybrid_jax.skills.costs import SegmentCosts
from hybrid_jax.skills.task_segmentation import SkillPlan
from hybrid_jax.types import Record, pytree

FAILURE = 5.0
"""Cost of a dead end [m]: more than any admissible plan of eight key poses can cost."""


@dataclass(frozen=True)
class DqnConfig:
    """Settings of a training."""

    batch: int = 256
    """Samples of a gradient step, for each network."""
    discount: float = 1.0
    """Below 1 it prefers many cheap segments to few: costs that come later count less."""
    epsilon_start: float = 0.95
    epsilon_end: float = 0.05
    epsilon_decay: float = 2000.0
    """Tries of skills over which exploration falls by a factor e."""
    polyak: float = 0.02
    """Soft update of the target network (`tau` in the paper's table)."""
    learning_rate: float = 3e-3
    anneal: bool = True
    """Let the learning rate fall to zero along a cosine."""
    rounds: int = 200
    """Segments that each copy covers in training."""
    envs: int = 4
    """Tasks that act at once."""
    tries: int = 8
    """Skills tried on a segment (`tau` in Algorithm 2)."""
    updates: int = 32
    """Gradient steps of each network in a round."""
    replay: int = 10_000
    hidden_motion: tuple[int, ...] = (64, 64)
    hidden_task: tuple[int, ...] = (64, 64)
    max_grad: float = 100.0
    """Gradients are clipped to this, element by element."""
    seed: int = 0

    def __post_init__(self):
        if not 0.0 <= self.discount <= 1.0:
            raise InputError(f"discount must lie in [0, 1], got {self.discount}")


@pytree
class DqnState(Record):
    """State of a training; with it alone the training goes on."""

    params: Any
    target: Any
    optimizer: Any
    task_buffer: Any
    motion_buffer: Any
    task: Array
    """`[env]` index of each copy's task."""
    at: Array
    """`[env]` index of the key pose that each copy has reached."""
    key: Array
    round: Array
    episodes: Array
    """Number of tasks that have ended so far."""


def make_controllers(config: DqnConfig) -> Controllers:
    """Networks with the sizes of a configuration."""
    return hdqn_networks.make_controllers(config.hidden_motion, config.hidden_task, config.discount)


def _explore(key: Array, values: Array, epsilon: Array) -> Array:
    """Epsilon-greedy index into `[choice]` values; those of minus infinity are never chosen."""
    key_kind, key_choice = jax.random.split(key)
    uniform = jax.random.categorical(key_choice, jnp.where(jnp.isfinite(values), 0.0, -jnp.inf))
    return jnp.where(jax.random.uniform(key_kind) < epsilon, uniform, jnp.argmax(values))


def _act(nets: Controllers, config: DqnConfig, tasks: SegmentCosts, state: DqnState, opinions, key):
    """One segment of every copy: records for both replays, and each copy's next task and place."""
    best, skills = opinions
    attempts = state.round * config.envs * config.tries
    epsilon = config.epsilon_end + (config.epsilon_start - config.epsilon_end) * jnp.exp(
        -attempts / config.epsilon_decay
    )

    def cover_segment(task, at, key):
        key_end, *key_skills = jax.random.split(key, config.tries + 1)
        values = hdqn_networks.end_values(nets, state.params, best[task], tasks.count[task], at)
        dead_end = ~jnp.any(hdqn_networks.reachable(best[task], at))
        to = jnp.where(dead_end, at, _explore(key_end, values, epsilon))
        pick = functools.partial(_explore, values=skills[task, at, to], epsilon=epsilon)
        skill = jax.vmap(pick)(jnp.stack(key_skills))
        reward = -tasks.cost[task, at, to, skill]
        gained = jnp.where(dead_end, -FAILURE, jnp.max(reward))
        done = dead_end | (to == tasks.count[task] - 1)
        option = {"task": task, "at": at, "to": to, "reward": gained, "done": done * 1.0}
        segment = {"task": task, "at": at, "to": to}
        tries = {k: jnp.broadcast_to(v, config.tries) for k, v in segment.items()}
        # a dead end teaches the task-controller, not the motion-controller: nothing was tried
        return option, tries | {
            "skill": skill,
            "reward": jnp.where(dead_end, 0.0, reward),
            "weight": jnp.broadcast_to(1.0 - dead_end, config.tries),
        }

    key_task, key = jax.random.split(key)
    # options `[env]`, tries `[env, try]`
    options, tries = jax.vmap(cover_segment)(
        state.task, state.at, jax.random.split(key, config.envs)
    )
    tries = jax.tree.map(lambda a: a.reshape(-1), tries)
    new_tasks = jax.random.randint(key_task, (config.envs,), 0, tasks.count.size)
    done = options["done"] > 0
    return options, tries, jnp.where(done, new_tasks, state.task), jnp.where(done, 0, options["to"])


def _loss(params, nets: Controllers, config: DqnConfig, tasks, target, best, options, tries):
    """Huber losses of both controllers on a batch of options and a batch of tries."""

    def task_error(r):
        opinion, count = best[r["task"]], tasks.count[r["task"]]
        next_values = hdqn_networks.end_values(nets, target, opinion, count, r["to"])
        next_best = jnp.where(jnp.any(jnp.isfinite(next_values)), jnp.max(next_values), -FAILURE)
        td_target = r["reward"] + config.discount * (1 - r["done"]) * next_best
        segment = opinion[r["at"], r["to"]]
        segment = jnp.where(jnp.isfinite(segment), segment, 0.0)  # stuck: it goes nowhere
        remaining_value = hdqn_networks.rest_value(nets, params, opinion, count, r["to"])
        return optax.huber_loss(segment + remaining_value, td_target)

    def motion_error(r):
        # the option ends with its one skill: the motion-controller sees a bandit
        value = hdqn_networks.skill_value(
            nets, params, tasks, r["task"], r["at"], r["to"], r["skill"]
        )
        return r["weight"] * optax.huber_loss(value, r["reward"])

    task_loss = jnp.mean(jax.vmap(task_error)(options))
    motion_loss = jnp.mean(jax.vmap(motion_error)(tries))
    return task_loss + motion_loss, (task_loss, motion_loss)


def _optimizer(config: DqnConfig):
    steps = config.rounds * config.updates
    rate = (
        optax.cosine_decay_schedule(config.learning_rate, steps)
        if config.anneal
        else config.learning_rate
    )
    return optax.chain(optax.clip(config.max_grad), optax.adam(rate))


def _buffers(config: DqnConfig):
    """Replay queues of options (segments) and of tries of skills."""
    option = {"task": 0, "at": 0, "to": 0, "reward": 0.0, "done": 0.0}
    attempt = {"task": 0, "at": 0, "to": 0, "skill": 0, "reward": 0.0, "weight": 0.0}
    return tuple(
        replay_buffers.UniformSamplingQueue(
            config.replay, {k: jnp.asarray(v) for k, v in sample.items()}, config.batch
        )
        for sample in (option, attempt)
    )


def initialize(tasks: SegmentCosts, config: DqnConfig, key: Array | None = None) -> DqnState:
    """Start a training with fresh networks and empty replays.

    Args:
        tasks: `[task, ...]` costs of the training tasks.
        config: settings.
        key: random key; made from the configuration's seed if None.

    Returns:
        The state; its `task` and `at` are `[env]`.
    """
    root_key = jax.random.PRNGKey(config.seed) if key is None else key
    key_nets, key_option, key_try, key_start, next_key = jax.random.split(root_key, 5)
    params = hdqn_networks.initialize(make_controllers(config), key_nets)
    options, tries = _buffers(config)
    return DqnState(
        params=params,
        target=params,
        optimizer=_optimizer(config).init(params),
        task_buffer=options.init(key_option),
        motion_buffer=tries.init(key_try),
        task=jax.random.randint(key_start, (config.envs,), 0, tasks.count.size),
        at=jnp.zeros(config.envs, int),
        key=next_key,
        round=jnp.zeros((), jnp.int32),
        episodes=jnp.zeros((), jnp.int32),
    )


def _learn(nets: Controllers, config: DqnConfig, tasks: SegmentCosts, best, state: DqnState, _):
    """One gradient step of both networks."""
    option_buffer, try_buffer = _buffers(config)
    task_buffer, options = option_buffer.sample(state.task_buffer)
    motion_buffer, tries = try_buffer.sample(state.motion_buffer)
    grads, losses = jax.grad(_loss, has_aux=True)(
        state.params, nets, config, tasks, state.target, best, options, tries
    )
    updates, optimizer = _optimizer(config).update(grads, state.optimizer, state.params)
    params = optax.apply_updates(state.params, updates)
    target = optax.incremental_update(params, state.target, config.polyak)
    return state.replace(
        params=params,
        target=target,
        optimizer=optimizer,
        task_buffer=task_buffer,
        motion_buffer=motion_buffer,
    ), losses


def training_round(nets: Controllers, config: DqnConfig, tasks: SegmentCosts, state: DqnState, _):
    """One round: every copy covers one segment, then both networks learn.

    It has the form of a step of `jax.lax.scan`, with tasks `[task, ...]`: returns the next state,
    and scalar metrics by name.
    """
    opinions = hdqn_networks.best_values(nets, state.params, tasks)
    key_act, key = jax.random.split(state.key)
    options, tries, task, at = _act(nets, config, tasks, state, opinions, key_act)
    option_buffer, try_buffer = _buffers(config)
    state = state.replace(
        task_buffer=option_buffer.insert(state.task_buffer, options),
        motion_buffer=try_buffer.insert(state.motion_buffer, tries),
        task=task,
        at=at,
        key=key,
        round=state.round + 1,
        episodes=state.episodes + jnp.sum(options["done"]).astype(jnp.int32),
    )
    step = functools.partial(_learn, nets, config, tasks, opinions[0])
    state, losses = jax.lax.scan(step, state, length=config.updates)
    return state, {
        "task_loss": jnp.mean(losses[0]),
        "motion_loss": jnp.mean(losses[1]),
        "reward": jnp.mean(options["reward"]),
        "episodes": state.episodes,
    }


def make_trainer(tasks: SegmentCosts, config: DqnConfig, rounds: int):
    """Compile a training of some rounds.

    Args:
        tasks: `[task, ...]` costs of the training tasks.
        config: settings.
        rounds: how many one call does.

    Returns:
        A function from a state to the state after these rounds and metrics `[round]`.
    """
    step = functools.partial(training_round, make_controllers(config), config, tasks)
    several = functools.partial(jax.lax.scan, step, length=rounds)
    return jax.jit(several, compiler_options=quick_options())


@kept(static=("config",))
def _greedy_plans(params, costs: SegmentCosts, config: DqnConfig):
    """`hdqn_networks.greedy_plans` of tasks `[task, ...]`."""
    return hdqn_networks.greedy_plans(make_controllers(config), params, costs)


def make_chooser(config: DqnConfig, params):
    """The trained controllers as a function that the planner calls.

    Args:
        config: settings of the training.
        params: of both networks.

    Returns:
        A `SkillChooser`: from the costs `[a, b, skill]` of one task to its plan, as a list of
        (from, to, skill); the list is empty where a dead end is met.
    """

    def choose(costs: SegmentCosts) -> SkillPlan:
        batch = jax.tree.map(lambda a: np.asarray(a)[None], costs)
        records, total = jax.device_get(_greedy_plans(params, batch, config))
        if not np.isfinite(total[0]):
            return []
        return [(int(a), int(b), int(k)) for a, b, k in records[0] if a >= 0]

    return choose
