# SPDX-License-Identifier: MIT
"""The paper's own stack on the paper's own environment: PyBullet and Stable-Baselines3.

The environment is `envs.paper_reach` once more: the same cell, observation, action and reward, one
copy, with the objects where the cell has them. It is kinematic as ours is: joints are set and
collisions detected, no dynamics. Manipulability comes from PyBullet's Jacobian.
"""

import time

import gymnasium
import numpy as np
from scipy.spatial.transform import Rotation
from stable_baselines3 import PPO

from benchmarks.rivals import Bullet
from hybrid_jax.agents.ppo import PpoConfig
from hybrid_jax.contracts import Segments
from hybrid_jax.envs.paper_reach import LITERAL, PaperReachConfig
from hybrid_jax.kernels.rays import RAY_COUNT, RAY_RANGE, fibonacci_directions
from hybrid_jax.types import Workcell

ROBOT = 64
"""PyBullet's collision group of the robot."""


class BulletReach(gymnasium.Env):
    """`PaperReachEnv` in PyBullet."""

    def __init__(self, cell: Workcell, segments: Segments, config: PaperReachConfig):
        self.engine, self.config = Bullet(cell), config
        for link in range(-1, self.engine.joints + 1):  # rays do not see the robot
            self.engine.bullet.setCollisionFilterGroupMask(self.engine.robot, link, ROBOT, -1)
        self.starts, goals = np.asarray(segments.start, float), np.asarray(segments.goal, float)
        count = self.engine.joints
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (12 * count + 31,))
        self.action_space = gymnasium.spaces.Box(-1, 1, (count,))
        self.low, self.high = self.engine.limits.T
        self.directions = RAY_RANGE * fibonacci_directions(RAY_COUNT)
        self.unit = self._manipulability(np.asarray(cell.home, float))
        self.goals = [self._place(q)[2:] for q in goals]
        self.drawn = np.random.default_rng(0)

    def _place(self, q):
        """Joint frames (positions, quaternions) and the tool's at a configuration."""
        self.engine.place(q)
        p, robot, count = self.engine.bullet, self.engine.robot, self.engine.joints
        states = p.getLinkStates(robot, range(count + 1), computeForwardKinematics=1)
        position = np.array([s[4] for s in states])
        turn = np.array([s[5] for s in states])
        return position[:-1], turn[:-1], position[-1], turn[-1]

    def _manipulability(self, q) -> float:
        p, robot, count = self.engine.bullet, self.engine.robot, self.engine.joints
        zero = [0.0] * count
        jacobian = np.vstack(p.calculateJacobian(robot, count, [0, 0, 0], list(q), zero, zero))
        return float(np.sqrt(max(np.linalg.det(jacobian @ jacobian.T), 0.0)))

    def _observe(self, frames, before, goal):
        position, turn, tool, tool_turn = frames
        linear = (position - before[0]) / self.config.period
        spin = Rotation.from_quat(turn) * Rotation.from_quat(before[1]).inv()
        spin = 2 * spin.as_quat(canonical=True)[:, :3] / self.config.period
        angles = Rotation.from_quat(np.vstack([turn, goal[1]])).as_euler("xyz")
        rays = self.directions @ Rotation.from_quat(tool_turn).as_matrix().T
        hits = self.engine.bullet.rayTestBatch(
            [list(tool)] * RAY_COUNT, (tool + rays).tolist(), collisionFilterMask=~ROBOT
        )
        lengths = [RAY_RANGE * h[2] for h in hits]
        return np.concatenate(
            [
                position.ravel(),
                angles[:-1].ravel(),
                linear.ravel(),
                spin.ravel(),
                goal[0],
                angles[-1],
                lengths,
            ]
        ).astype(np.float32)

    def reset(self, *, seed=None, options=None):
        self.segment = int(self.drawn.integers(len(self.goals)))
        self.frames, self.steps = self._place(self.starts[self.segment]), 0
        return self._observe(self.frames, self.frames, self.goals[self.segment]), {}

    def step(self, action):
        q = self.low + (self.high - self.low) * (np.clip(action, -1, 1) + 1) / 2
        before, goal = self.frames, self.goals[self.segment]
        self.frames = self._place(q)
        hit = self.engine.touches()
        distance = float(np.linalg.norm(self.frames[2] - goal[0]))
        fea = 0.0 if hit else self._manipulability(q) / self.unit
        arrived = distance < self.config.radius
        reward = self.config.arrival if arrived else fea - distance
        self.steps += 1
        late = self.steps >= self.config.horizon
        return self._observe(self.frames, before, goal), reward, arrived, late, {}


class Rival:
    """Stable-Baselines3's PPO on that environment, ready to train further."""

    def __init__(self, cell: Workcell, segments: Segments, config: PpoConfig):
        env = BulletReach(cell, segments, LITERAL)
        self.rollout = config.steps_per_iteration
        self.agent = PPO(
            "MlpPolicy",
            env,
            n_steps=self.rollout,
            batch_size=config.minibatch,
            n_epochs=config.epochs,
            learning_rate=config.learning_rate,
            gamma=config.discount,
            ent_coef=config.entropy,
            vf_coef=config.value,
            max_grad_norm=config.max_grad_norm,
            policy_kwargs={"net_arch": list(config.hidden)},
            device="cpu",
        )

    def train(self) -> None:
        """One more rollout and its update."""
        self.agent.learn(self.rollout, reset_num_timesteps=False)

    def world_steps_per_second(self, count: int = 1000) -> float:
        """Of the environment alone, with random actions."""
        env = self.agent.get_env().envs[0].unwrapped
        env.reset()
        actions = np.random.default_rng(0).uniform(-1, 1, (count, env.engine.joints))
        began = time.perf_counter()
        for action in actions:
            _, _, over, late, _ = env.step(action)
            if over or late:
                env.reset()
        return count / (time.perf_counter() - began)
