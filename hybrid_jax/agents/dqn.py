# SPDX-License-Identifier: MIT
"""The hierarchical DQN of RL-LfD: a task-controller picks segments, a motion-controller skills.

Paper, section "Task-Space RL based LfD", Algorithm 2, and Kulkarni et al., arXiv:1604.06057. Many
random tasks train at once in one compiled program. Choices that do not exist or exceed the
tolerance are masked: an infinite penalty would poison the targets.
"""

import functools
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from brax.training import networks, replay_buffers
from jax import Array
from jaxtyping import Float

from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.simulation.reach import rotation_6d
from hybrid_jax.skills.library import MAX_KEY_POSES, MAX_SKILLS, SegmentCosts
from hybrid_jax.skills.segmentation import Plan
from hybrid_jax.types import pytree

_STATE = 9 + 9 * MAX_KEY_POSES + 2 * MAX_KEY_POSES
_SEGMENT = MAX_KEY_POSES + 9


@dataclass(frozen=True)
class DqnConfig:
    """Settings; the first seven are the paper's table."""

    batch: int = 256
    discount: float = 0.92
    epsilon_start: float = 0.95
    epsilon_end: float = 0.05
    epsilon_decay: float = 2000.0
    """Environment steps in which exploration falls by a factor e."""
    polyak: float = 0.005
    """Soft update of the target networks (`tau`)."""
    learning_rate: float = 1e-4
    iterations: int = 6000
    """Gradient steps of each network."""
    envs: int = 16
    """Tasks that act at once."""
    replay: int = 10_000
    hidden: tuple[int, ...] = (128, 128)
    max_grad: float = 100.0
    """Gradients are clipped to this, element by element."""
    seed: int = 0

    def __post_init__(self):
        if not 0.0 <= self.discount < 1.0:
            raise ValueError(f"discount must lie in [0, 1), got {self.discount}")


@pytree
class TaskBatch:
    """Tasks to train on; the leading axis runs over tasks."""

    key_poses: Array
    """`[task, K, 8]` padded."""
    count: Array
    """`[task]` real key poses."""
    cost: Array
    """`[task, K, K, skill]`, see `SegmentCosts`."""


@pytree
class DqnState:
    """Everything that a training continues from."""

    params: Any
    target: Any
    optimizer: Any
    buffer: Any
    task: Array
    """`[env]` task of each copy."""
    at: Array
    """`[env]` key pose reached."""
    key: Array
    iteration: Array


def _pose_features(pose: Float[Array, "8"]) -> Float[Array, "9"]:
    return jnp.concatenate([dq.position(pose), rotation_6d(pose[:4])])


def observe(key_poses: Array, count: Array, at: Array) -> Float[Array, "97"]:
    """Tool pose, key poses seen from it, which was reached, which are real (paper, `s_t`)."""
    tool = key_poses[at]
    relative = dq.mul(jnp.broadcast_to(dq.conj(tool), key_poses.shape), key_poses)
    index = jnp.arange(MAX_KEY_POSES)
    real = (index < count).astype(jnp.float32)
    seen = jax.vmap(_pose_features)(relative) * real[:, None]
    return jnp.concatenate(
        [_pose_features(tool), seen.reshape(-1), (index == at).astype(jnp.float32), real]
    )


def _segment_input(key_poses: Array, at: Array, to: Array) -> Array:
    feature = dq.mul(dq.conj(key_poses[at]), key_poses[to])
    return jnp.concatenate([jax.nn.one_hot(to, MAX_KEY_POSES), _pose_features(feature)])


def _network(outputs: int, hidden: tuple[int, ...]) -> networks.MLP:
    return networks.MLP(layer_sizes=(*hidden, outputs), activation=jax.nn.relu)


def controllers(config: DqnConfig):
    """The two networks: values of segment ends, values of skills."""
    return _network(MAX_KEY_POSES, config.hidden), _network(MAX_SKILLS, config.hidden)


def _masked(values: Array, mask: Array) -> Array:
    return jnp.where(mask, values, -jnp.inf)


def _explore(key: Array, values: Array, mask: Array, epsilon: Array) -> Array:
    """Epsilon-greedy among the allowed choices."""
    key_kind, key_choice = jax.random.split(key)
    uniform = jax.random.categorical(key_choice, jnp.where(mask, 0.0, -jnp.inf))
    greedy = jnp.argmax(_masked(values, mask))
    return jnp.where(jax.random.uniform(key_kind) < epsilon, uniform, greedy)


def segment_mask(cost: Array, at: Array) -> Array:
    """`[K]` ends that some admissible skill reaches from a key pose."""
    return jnp.any(jnp.isfinite(cost[at]), axis=-1)


def values(nets, params, key_poses, count, at):
    """Values of the segment ends `[K]`."""
    return nets[0].apply(params["task"], observe(key_poses, count, at))


def skill_values(nets, params, key_poses, count, at, to):
    """Values of the skills `[skill]` for a segment."""
    inputs = jnp.concatenate([observe(key_poses, count, at), _segment_input(key_poses, at, to)])
    return nets[1].apply(params["motion"], inputs)


def _act(nets, config: DqnConfig, tasks: TaskBatch, state: DqnState, key: Array):
    """One option of every copy: transition records and where the copies stand then."""
    key_end, key_skill, key_task = jax.random.split(key, 3)
    done_steps = state.iteration * config.envs
    epsilon = config.epsilon_end + (config.epsilon_start - config.epsilon_end) * jnp.exp(
        -done_steps / config.epsilon_decay
    )

    def one(task, at, key_end, key_skill):
        poses, count, cost = tasks.key_poses[task], tasks.count[task], tasks.cost[task]
        mask = segment_mask(cost, at)
        to = _explore(key_end, values(nets, state.params, poses, count, at), mask, epsilon)
        skills = jnp.isfinite(cost[at, to])
        skill = _explore(
            key_skill, skill_values(nets, state.params, poses, count, at, to), skills, epsilon
        )
        stuck = ~jnp.any(mask)
        reward = jnp.where(stuck, -FAILURE, -cost[at, to, skill])
        done = stuck | (to == count - 1)
        return {
            "task": task,
            "at": at,
            "to": to,
            "skill": skill,
            "reward": reward,
            "done": done.astype(jnp.float32),
        }

    split = jax.vmap(jax.random.split, (0, None))
    keys = split(jnp.stack([key_end, key_skill]), config.envs)
    record = jax.vmap(one)(state.task, state.at, keys[0], keys[1])
    fresh = jax.random.randint(key_task, (config.envs,), 0, tasks.count.size)
    done = record["done"] > 0
    return record, jnp.where(done, fresh, state.task), jnp.where(done, 0, record["to"])


FAILURE = 5.0
"""Cost of a dead end: above what any admissible plan of eight key poses can cost [m]."""


def _loss(params, nets, config: DqnConfig, tasks: TaskBatch, target, batch):
    """Huber losses of both controllers."""

    def one(r):
        poses, count, cost = (
            tasks.key_poses[r["task"]],
            tasks.count[r["task"]],
            tasks.cost[r["task"]],
        )
        later = _masked(values(nets, target, poses, count, r["to"]), segment_mask(cost, r["to"]))
        best = jnp.where(jnp.any(jnp.isfinite(later)), jnp.max(later), -FAILURE)
        wanted = r["reward"] + config.discount * (1 - r["done"]) * best
        task_error = values(nets, params, poses, count, r["at"])[r["to"]] - wanted
        # the option ends with its one skill: the motion-controller sees a bandit
        motion = skill_values(nets, params, poses, count, r["at"], r["to"])[r["skill"]]
        return optax.huber_loss(task_error), optax.huber_loss(motion - r["reward"])

    task_loss, motion_loss = jax.vmap(one)(batch)
    return jnp.mean(task_loss) + jnp.mean(motion_loss), (jnp.mean(task_loss), jnp.mean(motion_loss))


def _optimizer(config: DqnConfig):
    return optax.chain(optax.clip(config.max_grad), optax.amsgrad(config.learning_rate))


def _buffer(config: DqnConfig):
    sample = {"task": 0, "at": 0, "to": 0, "skill": 0, "reward": 0.0, "done": 0.0}
    sample = {k: jnp.asarray(v) for k, v in sample.items()}
    return replay_buffers.UniformSamplingQueue(config.replay, sample, config.batch)


def initialize(tasks: TaskBatch, config: DqnConfig) -> DqnState:
    """Fresh networks, empty replay."""
    nets = controllers(config)
    key_task, key_motion, key_buffer, key_start, key = jax.random.split(
        jax.random.PRNGKey(config.seed), 5
    )
    params = {
        "task": nets[0].init(key_task, jnp.zeros(_STATE)),
        "motion": nets[1].init(key_motion, jnp.zeros(_STATE + _SEGMENT)),
    }
    start = jax.random.randint(key_start, (config.envs,), 0, tasks.count.size)
    return DqnState(
        params,
        params,
        _optimizer(config).init(params),
        _buffer(config).init(key_buffer),
        start,
        jnp.zeros(config.envs, int),
        key,
        jnp.zeros((), jnp.int32),
    )


def _iterate(nets, config: DqnConfig, tasks: TaskBatch, state: DqnState, _):
    """Act, store, and once there is a batch take a gradient step."""
    buffer = _buffer(config)
    key_act, key = jax.random.split(state.key)
    record, task, at = _act(nets, config, tasks, state, key_act)
    stored = buffer.insert(state.buffer, record)
    stored, batch = buffer.sample(stored)
    grads, (task_loss, motion_loss) = jax.grad(_loss, has_aux=True)(
        state.params, nets, config, tasks, state.target, batch
    )
    changes, opt = _optimizer(config).update(grads, state.optimizer, state.params)
    ready = (state.iteration + 1) * config.envs >= config.batch
    params = jax.tree.map(
        lambda old, new: jnp.where(ready, new, old),
        state.params,
        optax.apply_updates(state.params, changes),
    )
    target = optax.incremental_update(params, state.target, config.polyak)
    opt = jax.tree.map(lambda old, new: jnp.where(ready, new, old), state.optimizer, opt)
    metrics = {
        "task_loss": task_loss,
        "motion_loss": motion_loss,
        "reward": jnp.mean(record["reward"]),
    }
    return state.replace(
        params=params,
        target=target,
        optimizer=opt,
        buffer=stored,
        task=task,
        at=at,
        key=key,
        iteration=state.iteration + 1,
    ), metrics


def make_trainer(tasks: TaskBatch, config: DqnConfig, chunk: int):
    """A compiled function that takes a state `chunk` iterations further."""
    step = functools.partial(_iterate, controllers(config), config, tasks)
    return jax.jit(lambda state: jax.lax.scan(step, state, length=chunk))


def greedy_plans(config: DqnConfig, params, tasks: TaskBatch) -> tuple[Array, Array]:
    """Greedy plans `[task, K - 1, 3]` (from, to, skill; -1 past the end), costs (inf: dead end)."""
    nets = controllers(config)

    def one(poses, count, cost):
        def option(carry, _):
            at, total = carry
            mask = segment_mask(cost, at)
            to = jnp.argmax(_masked(values(nets, params, poses, count, at), mask))
            allowed = jnp.isfinite(cost[at, to])
            skill = jnp.argmax(_masked(skill_values(nets, params, poses, count, at, to), allowed))
            active = at < count - 1
            total = jnp.where(
                active, total + jnp.where(jnp.any(mask), cost[at, to, skill], jnp.inf), total
            )
            record = jnp.where(active & jnp.any(mask), jnp.stack([at, to, skill]), -1)
            return (jnp.where(active & jnp.any(mask), to, at), total), record

        (at, total), records = jax.lax.scan(
            option, (jnp.zeros((), int), jnp.float32(0.0)), length=MAX_KEY_POSES - 1
        )
        return records, jnp.where(at == count - 1, total, jnp.inf)

    return jax.vmap(one)(tasks.key_poses, tasks.count, tasks.cost)


def make_chooser(config: DqnConfig, params):
    """The trained controllers as a function that the planner calls (a `SkillChooser`)."""
    run = jax.jit(functools.partial(greedy_plans, config))

    def choose(key_poses: np.ndarray, count: int, costs: SegmentCosts) -> Plan:
        one = TaskBatch(
            jnp.asarray(key_poses)[None], jnp.asarray(count)[None], jnp.asarray(costs.cost)[None]
        )
        records, total = jax.device_get(run(params, one))
        if not np.isfinite(total[0]):
            return []
        return [tuple(int(v) for v in row) for row in records[0] if row[0] >= 0]

    return choose
