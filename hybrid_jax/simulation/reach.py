# SPDX-License-Identifier: MIT
"""Reaching among obstacles: the world of the joint-space agent (paper, section MDP).

Everything runs on the kernels, so thousands of copies live in one compiled program. A move that
would bring the robot closer than the margin is not made: a rollout's way points are always free.
With `physics="mjx"` the arm's servos carry out a move, in dynamics, and it ends where they get to:
there the commanded line is free, the servos' way is not checked.

One choice makes it learnable in a minute: the action corrects a straight step towards the goal and
fades out beside it. So an untrained agent already solves what a straight line solves, and ends
are exact (residual policies: Johannink et al., arXiv:1812.03201). Beside it neither a reward that
follows an expert's path nor starts along that path made a difference: there are none.
"""

import math
from dataclasses import dataclass
from typing import Literal

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, PRNGKeyArray

from hybrid_jax.agents.segments import Segments
from hybrid_jax.agents.worlds import Move
from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels.collision import clearance_up_to, points_between
from hybrid_jax.kernels.kinematics import tool_pose
from hybrid_jax.simulation.servos import Body, Servos
from hybrid_jax.types import Workcell, pytree
from hybrid_jax.workcell.mjxcollision import backend


@dataclass(frozen=True)
class ReachConfig:
    """Rules of the world."""

    max_delta: float = 0.08
    """Largest change of a joint in one step [rad]."""
    authority: float = 2.0
    """Size of the largest correction, in units of `max_delta`: 2 overrules the straight step."""
    fade: float = 3.0
    """Corrections fade within this many steps of the goal."""
    near: float = 0.01
    """A goal is reached when the tool is this close [m], ..."""
    turned: float = math.radians(2)
    """... is turned by no more than this [rad], ..."""
    same_branch: float = 0.1
    """... and every joint is this close [rad]."""
    margin: float = 0.004
    """Clearance that a move must keep [m]."""
    edge_samples: int = 3
    """Clearance checks along a move."""
    backend: str = "fused"
    """What checks collisions: `fused` (our kernels) or `mjx` (without the payload)."""
    physics: Literal["kinematic", "mjx"] = "kinematic"
    """What a move is: a step of the joints, or the arm's servos commanded for `period`."""
    period: float = 0.1
    """Time of a move in dynamics [s]."""
    horizon: int = 96
    """Steps after which an episode may be cut."""
    step_cost: float = 0.02
    """Cost of a step."""
    blocked_cost: float = 0.05
    """Cost of a move that was not made."""
    success_bonus: float = 2.0
    """Reward for reaching the goal."""


@pytree
class ReachState:
    """Where one copy of the world stands."""

    q: Array
    """`[joint]`."""
    pose: Array
    """`[8]` of the tool at `q`."""
    segment: Array
    """Index of the problem."""
    clearance: Array
    """Of the last move, made or not, up to the margin [m]."""
    step: Array
    """Steps since the start."""
    potential: Array
    """Minus the distance to go [rad]."""
    body: Body | None
    """In dynamics, all bodies of the copy."""


def rotation_6d(quat: Float[Array, "4"]) -> Float[Array, "6"]:
    """First two columns of the rotation matrix: continuous, unlike Euler angles
    (Zhou et al., arXiv:1812.07035)."""
    return dq.quat_matrix(quat)[:, :2].T.reshape(-1)


class ReachWorld:
    """A `World` (see `agents.worlds`) of segments to be bridged."""

    def __init__(self, cell: Workcell, segments: Segments, config: ReachConfig = ReachConfig()):
        """Args:
        cell: robot and fixtures.
        segments: problems to draw from.
        config: rules.
        """
        self.cell, self.segments, self.config = cell, segments, config
        self.goal_pose = jax.vmap(tool_pose, (None, 0))(cell, segments.goal)
        self.action_size = cell.home.size
        self.observation_size = self.observation_length(cell)
        self.servos = Servos(cell, config.period) if config.physics == "mjx" else None

    @staticmethod
    def observation_length(cell: Workcell) -> int:
        """Length of an observation in a cell."""
        return sum(count for _, count in ReachWorld.observation_parts(cell))

    @staticmethod
    def observation_parts(cell: Workcell) -> tuple[tuple[str, int], ...]:
        """What an observation consists of, in order: sentence and how many numbers."""
        joints, slots = cell.home.size, cell.scene.payload.count
        return (
            ("joint configuration over pi", joints),
            ("goal configuration minus it [rad]", joints),
            ("the same over the largest step, clipped to -1..1", joints),
            ("tool position in the world [m]", 3),
            ("first two columns of the tool's rotation matrix", 6),
            ("goal position in the tool's frame [m]", 3),
            ("first two columns of the goal's rotation matrix in the tool's frame", 6),
            ("clearance of the last move over 5 cm, clipped to -1..1", 1),
            ("was the last move refused? 0 or 1", 1),
            ("is each slot of the payload in use? 0 or 1", slots),
            ("half extents of each slot's box [dm]", 3 * slots),
        )

    def _scene(self, segment: Array) -> Workcell:
        scene = jax.tree.map(lambda a: a[segment], self.segments.scene)
        return self.cell.replace(scene=scene)

    def observe(self, state: ReachState) -> Float[Array, "obs"]:
        """What the agent sees, numbers of order one.

        No clock: an episode that the horizon cuts goes on from its last value, so time is no part
        of the state. No rays: fixtures never move, and what is carried is seen by its size.
        """
        goal = self.segments.goal[state.segment]
        relative = dq.mul(dq.conj(state.pose), self.goal_pose[state.segment])
        payload = jax.tree.map(lambda a: a[state.segment], self.segments.scene.payload)
        to_go = goal - state.q
        return jnp.concatenate(
            [
                state.q / jnp.pi,
                to_go,
                jnp.clip(to_go / self.config.max_delta, -1, 1),
                dq.position(state.pose),
                rotation_6d(state.pose[:4]),
                dq.position(relative),
                rotation_6d(relative[:4]),
                jnp.clip(state.clearance / 0.05, -1, 1)[None],
                1.0 * (state.clearance < self.config.margin)[None],
                payload.on,
                (10 * payload.half * payload.on[:, None]).reshape(-1),
            ]
        )

    def potential(self, segment: Array, q: Array) -> Float[Array, ""]:
        """Minus the distance to the goal [rad].

        Its differences shape the reward (Ng, Harada, Russell 1999).
        """
        return -jnp.linalg.norm(self.segments.goal[segment] - q)

    def start(self, segment: Array, q: Array) -> ReachState:
        """A given problem from a given configuration."""
        zero = jnp.zeros((), jnp.int32)
        margin = jnp.float32(self.config.margin)
        pose = tool_pose(self.cell, q)
        body = self.servos and self.servos.rest(self._scene(segment), q)
        return ReachState(q, pose, segment, margin, zero, self.potential(segment, q), body)

    def begin(self, key: PRNGKeyArray) -> ReachState:
        """A random problem, from its start."""
        segment = jax.random.randint(key, (), 0, self.segments.start.shape[0], jnp.int32)
        return self.start(segment, self.segments.start[segment])

    def overdue(self, state: ReachState) -> Array:
        return state.step >= self.config.horizon

    def target(self, state: ReachState, action: Array) -> Float[Array, "n"]:
        """Configuration that an action asks for."""
        rules = self.config
        to_go = (self.segments.goal[state.segment] - state.q) / rules.max_delta
        steps = jnp.max(jnp.abs(to_go))
        straight = to_go / jnp.maximum(steps, 1.0)
        correction = rules.authority * jnp.minimum(steps / rules.fade, 1.0) * action
        low, high = self.cell.chain.limits.T
        move = rules.max_delta * jnp.clip(straight + correction, -1, 1)
        return jnp.clip(state.q + move, low, high)

    def gap(self, cell: Workcell, points: Float[Array, "sample n"]) -> Float[Array, ""]:
        """Smallest clearance at some configurations, up to the margin [m]."""
        if self.config.backend == "fused":
            found = jax.vmap(clearance_up_to, (None, 0, None))(cell, points, self.config.margin)
        else:
            check = backend(self.config.backend)
            found = jax.vmap(lambda q: check(cell, q)[0])(points)
        return jnp.min(found)

    def reached(self, segment: Array, q: Array, pose: Array) -> Array:
        """Is the tool at the goal, and the arm on the goal's branch?"""
        relative = dq.mul(dq.conj(pose), self.goal_pose[segment])
        sine = jnp.linalg.norm(relative[1:4])
        return (
            (jnp.linalg.norm(dq.position(relative)) <= self.config.near)
            & (2 * jnp.arcsin(jnp.clip(sine, 0, 1)) <= self.config.turned)
            & (jnp.max(jnp.abs(self.segments.goal[segment] - q)) <= self.config.same_branch)
        )

    def step(self, state: ReachState, action: Array) -> Move:
        rules = self.config
        wanted = self.target(state, action)
        samples = points_between(state.q, wanted, rules.edge_samples)
        gap = self.gap(self._scene(state.segment), samples)
        free = gap >= rules.margin
        q, body = jnp.where(free, wanted, state.q), None
        if self.servos:
            body = self.servos.move(state.body, q, self.segments.scene.opening[state.segment])
            q = self.servos.configuration(body)
        pose = tool_pose(self.cell, q)
        reached = self.reached(state.segment, q, pose)
        potential = self.potential(state.segment, q)
        reward = (
            potential
            - state.potential
            - rules.step_cost
            - rules.blocked_cost * ~free
            + rules.success_bonus * reached
        )
        after = ReachState(q, pose, state.segment, gap, state.step + 1, potential, body)
        return Move(after, reward, reached, reached, {"blocked": 1.0 - free})
