# SPDX-License-Identifier: MIT
"""Kinematic reaching among obstacles: the world of the joint-space agent (paper, section MDP).

Everything runs on the kernels, so thousands of copies live in one compiled program. A move that
would bring the robot closer than the margin is not made: a rollout's way points are always free.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from brax.envs.base import Env, State
from jax import Array
from jaxtyping import Float, PRNGKeyArray

from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels.collision import edge_clearance
from hybrid_jax.kernels.kinematics import tool_pose
from hybrid_jax.kernels.rays import RAY_COUNT, sense
from hybrid_jax.planner.harvest import Segments
from hybrid_jax.types import Workcell, pytree
from hybrid_jax.workcell.mjxcollision import backend


@dataclass(frozen=True)
class ReachConfig:
    """Rules of the world."""

    max_delta: float = 0.08
    """Largest change of a joint in one step [rad]."""
    tolerance: float = 0.05
    """A goal is reached when every joint is this close [rad]."""
    margin: float = 0.004
    """Clearance that a move must keep [m]."""
    edge_samples: int = 2
    """Clearance checks along a move."""
    backend: str = "fused"
    """What checks collisions: `fused` (our kernels) or `mjx` (without the payload)."""
    horizon: int = 100
    """Steps until an episode is truncated."""
    step_cost: float = 0.02
    """Cost of a step."""
    blocked_cost: float = 0.05
    """Cost of a move that was not made."""
    success_bonus: float = 2.0
    """Reward for reaching the goal."""
    on_path: float = 0.5
    """Share of episodes that start along an expert's path instead of at its beginning."""


@pytree
class ReachState:
    """Where one copy of the world stands."""

    q: Array
    """`[joint]`."""
    delta: Array
    """`[joint]` last change."""
    segment: Array
    """Index of the problem."""
    clearance: Array
    """Of the last move, made or not [m]."""
    step: Array
    """Steps since the start."""


def rotation_6d(quat: Float[Array, "4"]) -> Float[Array, "6"]:
    """First two columns of the rotation matrix: continuous, unlike Euler angles
    (Zhou et al., arXiv:1812.07035)."""
    return dq.quat_matrix(quat)[:, :2].T.reshape(-1)


class ReachEnv(Env):
    """Brax's environment protocol; one copy, the trainer vmaps."""

    def __init__(
        self,
        cell: Workcell,
        segments: Segments,
        paths: Float[Array, "segment point n"],
        config: ReachConfig = ReachConfig(),
    ):
        """Args:
        cell: robot and fixtures.
        segments: problems to draw from.
        paths: collision-free way points of each problem, from its start to its goal.
        config: rules.
        """
        self.cell, self.segments, self.paths, self.config = cell, segments, paths, config

    @property
    def action_size(self) -> int:
        return self.cell.home.size

    @property
    def observation_size(self) -> int:
        return self.observation_length(self.cell.home.size)

    @staticmethod
    def observation_length(joints: int) -> int:
        """Length of an observation of an arm with `joints` joints."""
        return 3 * joints + 18 + RAY_COUNT + 2

    @property
    def backend(self) -> str:
        return "kernels"

    def _scene(self, segment: Array) -> tuple[Workcell, Array]:
        scene = jax.tree.map(lambda a: a[segment], self.segments.scene)
        return self.cell.replace(scene=scene), self.segments.goal[segment]

    def observe(self, cell: Workcell, goal: Array, state: ReachState) -> Float[Array, "obs"]:
        """What the agent sees; `3 n + 45` numbers of order one.

        No clock: an episode that the horizon cuts goes on from its last value, so time is no part
        of the state. With a clock the value at the horizon is never a training input, is
        extrapolated, and training diverges.
        """
        low, high = cell.chain.limits.T
        pose, goal_pose = tool_pose(cell, state.q), tool_pose(cell, goal)
        relative = dq.mul(dq.conj(pose), goal_pose)
        return jnp.concatenate(
            [
                2 * (state.q - low) / (high - low) - 1,
                state.delta / self.config.max_delta,
                goal - state.q,
                dq.position(pose),
                rotation_6d(pose[:4]),
                dq.position(relative),
                rotation_6d(relative[:4]),
                sense(cell, pose),
                jnp.stack([jnp.clip(10 * state.clearance, -1, 1), self._loaded(cell)]),
            ]
        )

    def _loaded(self, cell: Workcell) -> Float[Array, ""]:
        """1 while an object is held."""
        payload = cell.scene.payload
        return jnp.max(payload.on, initial=0.0)

    def begin(self, segment: Array, q: Array) -> State:
        """Start a given problem from a given configuration."""
        cell, goal = self._scene(segment)
        state = ReachState(q, jnp.zeros_like(q), segment, jnp.float32(0.05), jnp.zeros((), int))
        zero = jnp.float32(0.0)
        return State(
            state,
            self.observe(cell, goal, state),
            zero,
            zero,
            {"success": zero},
            {"truncation": zero},
        )

    def reset(self, rng: PRNGKeyArray) -> State:
        key_segment, key_point, key_kind = jax.random.split(rng, 3)
        segment = jax.random.randint(key_segment, (), 0, self.segments.start.shape[0])
        point = jax.random.randint(key_point, (), 0, self.paths.shape[1] - 1)
        along = jax.random.uniform(key_kind) < self.config.on_path
        return self.begin(segment, self.paths[segment, jnp.where(along, point, 0)])

    def potential(self, q: Array, goal: Array) -> Float[Array, ""]:
        """Minus the distance to go, of order one; its differences shape the reward
        (Ng, Harada, Russell 1999)."""
        return -jnp.linalg.norm(goal - q)

    def step(self, state: State, action: Array) -> State:
        rules, world = self.config, state.pipeline_state
        cell, goal = self._scene(world.segment)
        low, high = cell.chain.limits.T
        wanted = jnp.clip(world.q + rules.max_delta * jnp.clip(action, -1, 1), low, high)
        check = backend(rules.backend)
        gap = edge_clearance(cell, world.q, wanted, rules.edge_samples, check)
        free = gap >= rules.margin
        q = jnp.where(free, wanted, world.q)
        reached = jnp.max(jnp.abs(goal - q)) <= rules.tolerance
        count = world.step + 1
        truncated = (count >= rules.horizon) & ~reached
        reward = (
            self.potential(q, goal)
            - self.potential(world.q, goal)
            - rules.step_cost
            - rules.blocked_cost * ~free
            + rules.success_bonus * reached
        )
        world = ReachState(q, q - world.q, world.segment, gap, count)
        return State(
            world,
            self.observe(cell, goal, world),
            reward,
            (reached | truncated).astype(jnp.float32),
            {"success": reached.astype(jnp.float32)},
            {"truncation": truncated.astype(jnp.float32)},
        )


def resample_path(path: np.ndarray, points: int) -> np.ndarray:
    """`points` configurations evenly spaced along a polyline `[n, joint]`."""
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    at = np.linspace(0, max(length[-1], 1e-9), points)
    return np.stack([np.interp(at, length, column) for column in path.T], axis=1)
