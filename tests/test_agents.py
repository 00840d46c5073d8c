# SPDX-License-Identifier: MIT
"""The agents on toy environments with known answers, and against exact oracles."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax.training.networks import FeedForwardNetwork

from hybrid_jax.agents import dqn, hdqn_networks, networks, ppo, switching, training
from hybrid_jax.contracts import STEPS, Combined
from hybrid_jax.envs.base import StepResult
from hybrid_jax.errors import TrainingError
from hybrid_jax.skills.costs import MAX_KEY_POSES, SegmentCosts
from hybrid_jax.skills.library import MAX_SKILLS
from hybrid_jax.skills.task_segmentation import optimal_costs


class Track:
    """Walk along a line to the origin: every part of PPO is needed to solve it."""

    observation_size = 1

    def __init__(self, discrete=False, broken=False):
        self.discrete, self.broken = discrete, broken
        self.action_size = 2 if discrete else 1

    def reset(self, key):
        x = jax.random.uniform(key, (), jnp.float32, -1.0, 1.0)
        return {"x": x, "count": jnp.float32(0)}

    def observe(self, state):
        return state["x"][None]

    def truncated(self, state):
        return state["count"] >= 20

    def step(self, state, action):
        x = state["x"]
        move = (2.0 * action - 1.0) if self.discrete else jnp.clip(action[0], -1, 1)
        x_new = x + 0.15 * move
        reached = jnp.abs(x_new) < 0.1
        reward = jnp.abs(x) - jnp.abs(x_new) - 0.02 + reached
        reward = jnp.where(self.broken, jnp.nan, reward)
        return StepResult({"x": x_new, "count": state["count"] + 1}, reward, reached, reached, {})


SMALL = ppo.PpoConfig(steps=40_000, envs=32, unroll=16, minibatch=128, hidden=(32,))


def small_training(env, config=SMALL, **options):
    net = networks.make_networks(1, env.action_size, config.hidden, env.discrete)
    return training.train(env, net, config, **options)


def assert_same(first, second):
    """Every array of two pytrees is equal to the last bit."""
    for a, b in zip(jax.tree.leaves(first), jax.tree.leaves(second), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("discrete", [False, True])
def test_ppo_solves_a_line(discrete):
    seen = []
    small_training(Track(discrete), report=lambda steps, state, m: seen.append(m["success"][0]))
    assert np.mean(seen[-5:]) > 0.97 > np.mean(seen[:3]), seen


def test_several_seeds_train_side_by_side():
    """Each as it would alone: networks, copies and random numbers are its own."""
    config = ppo.PpoConfig(**{**SMALL.__dict__, "steps": 4 * 512})
    both = small_training(Track(), config, seeds=(3, 5)).learner.params
    alone = small_training(Track(), config, seeds=(5,)).learner.params
    for a, b in zip(jax.tree.leaves(both), jax.tree.leaves(alone), strict=True):
        np.testing.assert_allclose(a[1], b[0], atol=1e-4)
        assert a.ndim < 3 or np.abs(a[0] - a[1]).max() > 1e-3


def test_advantages_by_hand():
    """Two steps, then the goal (no value beyond) or the end of the rollout (a value beyond)."""
    value = FeedForwardNetwork(None, lambda normalizer, params, obs: obs[..., 0])
    net = networks.ActorCritic(None, value, None)
    config = ppo.PpoConfig(discount=0.9, gae_lambda=0.8)
    learner = ppo.Learner({"value": None}, None, None, None, None)
    for terminated, beyond in ((1.0, 0.0), (0.0, 4.0)):
        data = {
            "obs": jnp.array([[[0.5]], [[0.25]]]),
            "reward": jnp.array([[1.0], [2.0]]),
            "terminated": jnp.array([[0.0], [terminated]]),
            "last_obs": jnp.array([[4.0]]),
            "action": jnp.zeros((2, 1)),
            "log_prob": jnp.zeros((2, 1)),
            "kept": None,
        }
        found = ppo.judge(net, config, learner, data)
        last = 2.0 + 0.9 * beyond - 0.25
        first = 1.0 + 0.9 * 0.25 - 0.5 + 0.9 * 0.8 * last
        np.testing.assert_allclose(found["target"], [0.5 + first, 0.25 + last], rtol=1e-6)


def test_ppo_resumes_bit_for_bit():
    short = ppo.PpoConfig(**{**SMALL.__dict__, "steps": 4 * 512})
    kept = []
    whole = small_training(Track(), short, report=lambda s, state, m: kept.append(state))
    assert_same(whole, small_training(Track(), short, state=kept[1]))


def test_ppo_stops_at_nan_and_says_where():
    with pytest.raises(TrainingError, match=r"step 512.*value_loss"):
        small_training(Track(broken=True))


def test_ppo_configuration_is_checked():
    with pytest.raises(ValueError, match="minibatch"):
        ppo.PpoConfig(envs=3, unroll=5, minibatch=7)


def toy_tasks(count, seed, keys=5, skills=4):
    """Tasks whose skills cost the size of a random screw; a third of them is inadmissible."""
    rng = np.random.default_rng(seed)
    shape = (count, MAX_KEY_POSES, MAX_KEY_POSES, MAX_SKILLS)
    first, near = (rng.normal(scale=0.06, size=(*shape, 6)).astype(np.float32) for _ in range(2))
    size = [np.sqrt(np.sum((x * ([1.0] * 3 + [0.3] * 3)) ** 2, axis=-1)) for x in (first, near)]
    cost = np.full(shape, np.inf, np.float32)
    for a in range(keys - 1):
        for b in range(a + 1, keys):
            inner = size[1][:, a + 1 : b, b, :skills].sum(axis=1)
            cost[:, a, b, :skills] = size[0][:, a, b, :skills] + inner
    cost[rng.uniform(size=shape) < 0.33] = np.inf
    cost[:, np.arange(keys - 1), np.arange(1, keys), 0] = 0.3  # every task can be covered
    first[:, np.arange(keys - 1), np.arange(1, keys), 0] = [0.3, 0, 0, 0, 0, 0]
    tasks = SegmentCosts(np.full(count, keys), cost, cost, first, near)
    return jax.tree.map(jnp.asarray, tasks)


TOY_DQN = dqn.DqnConfig(rounds=60, updates=16, hidden_motion=(32, 32), hidden_task=(32, 32))


@pytest.fixture(scope="module")
def toy_training():
    """A training on 64 toy tasks."""
    tasks = toy_tasks(64, 0)
    state, metrics = dqn.make_trainer(tasks, TOY_DQN, TOY_DQN.rounds)(
        dqn.initialize(tasks, TOY_DQN)
    )
    return state, metrics


def greedy(params, tasks):
    nets = dqn.make_controllers(TOY_DQN)
    return jax.device_get(jax.jit(lambda p: hdqn_networks.greedy_plans(nets, p, tasks))(params))


def test_hierarchical_dqn_plans_unseen_tasks_almost_as_well_as_the_shortest_path(toy_training):
    state, metrics = toy_training
    unseen = toy_tasks(64, 1)
    best = optimal_costs(unseen).mean()
    fresh = dqn.initialize(unseen, TOY_DQN).params
    untrained = greedy(fresh, unseen)[1].mean()
    records, total = greedy(state.params, unseen)
    assert total.mean() < 1.05 * best < 1.2 * best < untrained
    assert (records[:, 0, 0] == 0).all()
    assert int(metrics["episodes"][-1]) > 40


def test_values_of_single_skills_and_of_all_agree(toy_training):
    state, _ = toy_training
    tasks, nets = toy_tasks(2, 3), dqn.make_controllers(TOY_DQN)
    whole = hdqn_networks.skill_values(nets, state.params, tasks.first[1], tasks.near[1])
    for a, b, skill in ((0, 1, 2), (0, 4, 1), (2, 4, 3)):
        one = hdqn_networks.skill_value(nets, state.params, tasks, 1, a, b, skill)
        assert whole[a, b, skill] == pytest.approx(float(one), abs=1e-4)


def test_an_inadmissible_skill_is_never_chosen(toy_training):
    state, _ = toy_training
    tasks = toy_tasks(8, 1)
    tasks = tasks.replace(cost=tasks.cost.at[0].set(jnp.inf))
    records, total = greedy(state.params, tasks)
    assert np.isinf(total[0]) and np.isfinite(total[1:]).all()
    assert (records[0] == -1).all()


def test_the_dqn_learns_to_stay_out_of_a_dead_end():
    """From key pose 1, which is the cheaper way, nothing leads on."""
    tasks = toy_tasks(16, 5, keys=3)
    cost = jnp.full(tasks.cost.shape, jnp.inf)
    cost = cost.at[:, 0, 1, :4].set(0.05).at[:, 0, 2, :4].set(0.4)
    tasks = tasks.replace(cost=cost)
    config = dqn.DqnConfig(rounds=20, updates=16, hidden_motion=(16,), hidden_task=(16,))
    state, _ = dqn.make_trainer(tasks, config, 20)(dqn.initialize(tasks, config))
    nets = dqn.make_controllers(config)
    records, total = hdqn_networks.greedy_plans(nets, state.params, tasks)
    np.testing.assert_allclose(total, 0.4, atol=1e-6)


def test_dqn_resumes_bit_for_bit():
    tasks = toy_tasks(8, 4)
    config = dqn.DqnConfig(rounds=6, updates=4, hidden_motion=(8,), hidden_task=(8,))
    start, three = dqn.initialize(tasks, config), dqn.make_trainer(tasks, config, 3)
    whole, _ = dqn.make_trainer(tasks, config, 6)(start)
    again, _ = three(three(start)[0])
    for a, b in zip(jax.tree.leaves(whole), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(a, b)


def toy_switching(seed, joints=3):
    """A skill that collides in the middle and a joint motion that leads around."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0, 1, STEPS)[:, None]
    skill = np.sin(2 * t + rng.uniform(0, 3, joints))
    window = np.zeros(STEPS)
    first, last = 60 + rng.integers(0, 20), 130 + rng.integers(0, 20)
    window[first:last] = 1
    bump = np.zeros_like(t)
    bump[first:last, 0] = np.sin(np.linspace(0, np.pi, last - first))
    other = skill + 0.4 * bump
    collision = np.stack([np.zeros(STEPS), 1 - window])
    collision[0, first + 10 : last - 10] = 1
    man = rng.uniform(0.4, 0.6, (2, 1)) * np.ones((2, STEPS))
    return Combined(
        *(jnp.asarray(a, jnp.float32) for a in (np.stack([skill, other]), man, collision, window))
    )


def total_reward(data, choice, config):
    """The reward of a sequence, added up step by step in plain Python."""
    q, value, before, last = np.asarray(data.q), 0.0, 0, np.asarray(data.q)[0, 0]
    points = np.asarray(switching.point_reward(data, config))
    for t, c in enumerate(choice):
        jump = np.abs(q[c, t] - last).max()
        value += points[c, t] - config.jump * max(0.0, jump - config.allowed) / config.allowed
        value -= config.switch * (c != before)
        before, last = c, q[c, t]
    return value


def test_viterbi_is_worth_what_it_says_and_beats_random_choices():
    config, rng = switching.SwitchConfig(), np.random.default_rng(0)
    for seed in range(5):
        data = toy_switching(seed)
        choice, value = switching.optimal_switching(data, config)
        assert total_reward(data, choice, config) == pytest.approx(value, abs=1e-2)
        available = np.asarray(data.available) > 0
        for _ in range(20):
            a, b = np.sort(rng.integers(0, STEPS, 2))
            other = np.zeros(STEPS, int)
            other[a:b] = 1
            assert total_reward(data, other * available, config) <= value + 1e-2


def test_switching_agent_comes_close_to_viterbi():
    config = switching.SwitchConfig(
        training=ppo.PpoConfig(
            steps=100_000,
            envs=32,
            unroll=50,
            minibatch=400,
            learning_rate=1e-3,
            discount=0.96,
            hidden=(32, 32),
        )
    )
    problems = jax.tree.map(lambda *a: jnp.stack(a), *[toy_switching(s) for s in range(8)])
    net = switching.make_net(3, config)
    state = training.train(switching.SwitchEnv(problems, config), net, config.training)
    choice, reward = switching.choose(net, state.policy(), problems, config)
    best = [switching.optimal_switching(toy_switching(s), config)[1] for s in range(8)]
    assert np.mean(reward) > 0.95 * np.mean(best)
    assert total_reward(toy_switching(0), np.asarray(choice[0]), config) == pytest.approx(
        float(reward[0]), abs=0.05
    )
