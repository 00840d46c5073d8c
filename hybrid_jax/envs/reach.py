# SPDX-License-Identifier: MIT
"""Reaching among obstacles: the environment of the joint-space agent (paper, section MDP).

Everything runs on the kernels, so thousands of copies live in one compiled program. A move that
would bring the robot closer than the margin is not made: a rollout's way points are always free.
With `physics="mjx"` the arm's servos carry out a move, in dynamics, and it ends where they get to:
there the way is checked that the arm takes, and a move that comes too close is taken back.

One choice makes it learnable in a minute: the action corrects a straight step towards the goal and
fades out beside it. So an untrained agent already solves what a straight line solves, and ends
are exact (residual policies: Johannink et al., arXiv:1812.03201). Beside it neither a reward that
follows an expert's path nor starts along that path made a difference: there are none.
"""

import math
from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, PRNGKeyArray

from hybrid_jax.contracts import Segments
from hybrid_jax.envs.base import StepResult
from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels.kinematics import tool_pose
from hybrid_jax.mjx.collision import CLEARANCE_UP_TO, Backend, compiler_options
from hybrid_jax.mjx.executed_motion import Physics
from hybrid_jax.mjx.servos import Body, Servos
from hybrid_jax.types import Record, Workcell, pytree


def points_between(
    start: Float[Array, " n"], end: Float[Array, " n"], samples: int
) -> Float[Array, "sample n"]:
    """Evenly spaced points `[sample, joint]` of a straight edge, without `start`, with `end`."""
    phase = jnp.arange(1, samples + 1)[:, None] / samples
    return start + phase * (end - start)


@dataclass(frozen=True)
class ReachConfig:
    """Rules of the environment."""

    max_delta: float = 0.08
    """Largest change of a joint in one step [rad]."""
    authority: float = 2.0
    """Size of the largest correction, in units of `max_delta`: 2 overrules the straight step."""
    fade: float = 3.0
    """Corrections fade within this many steps of the goal."""
    near: float = 0.01
    """Largest distance of the tool from a goal that is reached [m]."""
    turned: float = math.radians(2)
    """Largest rotation of the tool from a goal that is reached [rad]."""
    same_branch: float = 0.1
    """Largest difference of a joint from a goal that is reached [rad]."""
    margin: float = 0.004
    """Clearance that a move must keep [m]."""
    edge_samples: int = 3
    """Clearance checks along a move."""
    backend: Backend = "fused"
    """Collision checker: `fused` (the package's kernels) or `mjx`."""
    physics: Physics = "kinematic"
    """Kind of a move: a step of the joints, or the arm's servos commanded for `period`."""
    period: float = 0.1
    """Duration of a move in dynamics [s]."""
    horizon: int = 96
    """Steps after which an episode may be cut."""
    step_cost: float = 0.02
    """Cost of a step."""
    blocked_cost: float = 0.05
    """Cost of a move that was not made."""
    success_bonus: float = 2.0
    """Reward for reaching the goal."""

    @property
    def uses_mjx(self) -> bool:
        """Is MJX part of a step?"""
        return "mjx" in (self.backend, self.physics)


@pytree
class ReachState(Record):
    """State of one copy of the environment."""

    q: Array
    """`[joint]` configuration [rad]."""
    pose: Array
    """`[8]` tool pose at `q`."""
    segment: Array
    """Index of the problem."""
    clearance: Array
    """Clearance of the last move, made or not, up to the margin [m]."""
    step: Array
    """Steps since the start."""
    potential: Array
    """Minus the joint-space distance to the goal [rad]."""
    body: Body | None
    """Positions and velocities of all bodies; None without dynamics."""


def rotation_6d(quat: Float[Array, "4"]) -> Float[Array, "6"]:
    """First two columns `[6]` of the rotation matrix of a quaternion `[4]`.

    Continuous, unlike Euler angles (Zhou et al., arXiv:1812.07035).
    """
    return dq.quat_matrix(quat)[:, :2].T.reshape(-1)


class ReachEnv:
    """An `Env` (see `envs.base`) of segments to be bridged."""

    def __init__(self, cell: Workcell, segments: Segments, config: ReachConfig = ReachConfig()):
        """Make an environment of some segments.

        Args:
            cell: robot and fixtures.
            segments: problems to draw from, with `[segment, joint]` ends [rad].
            config: rules.
        """
        self.cell, self.segments, self.config = cell, segments, config
        self.goal_pose = jax.vmap(tool_pose, (None, 0))(cell, segments.goal)
        self.action_size = cell.home.size
        self.observation_size = self.observation_length(cell)
        self.servos = Servos(cell, config.period) if config.physics == "mjx" else None

    @property
    def compiler_options(self) -> dict[str, int | bool]:
        """Options of XLA's compiler for programs that take steps."""
        return compiler_options("mjx" if self.config.uses_mjx else "fused")

    @staticmethod
    def observation_length(cell: Workcell) -> int:
        """Length of an observation in a cell."""
        return sum(count for _, count in ReachEnv.observation_parts(cell))

    @staticmethod
    def observation_parts(cell: Workcell) -> tuple[tuple[str, int], ...]:
        """Parts of an observation in order: description and length of each."""
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

    def observe(self, state: ReachState) -> Float[Array, " obs"]:
        """Observation `[obs]`, numbers of order one; see `observation_parts`.

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
                payload.active,
                (10 * payload.half_extents * payload.active[:, None]).reshape(-1),
            ]
        )

    def potential(self, segment: Array, q: Array) -> Float[Array, ""]:
        """Minus the distance `[]` of a configuration `[joint]` from the goal [rad].

        Its differences shape the reward (Ng, Harada, Russell 1999).
        """
        return -jnp.linalg.norm(self.segments.goal[segment] - q)

    def start(self, segment: Array, q: Array) -> ReachState:
        """State of a problem (index `[]`) at a configuration `[joint]` [rad], at rest."""
        zero = jnp.zeros((), jnp.int32)
        margin = jnp.float32(self.config.margin)
        pose = tool_pose(self.cell, q)
        body = self.servos and self.servos.rest(self._scene(segment), q)
        return ReachState(q, pose, segment, margin, zero, self.potential(segment, q), body)

    def reset(self, key: PRNGKeyArray) -> ReachState:
        """State at the start of a random problem."""
        segment = jax.random.randint(key, (), 0, self.segments.start.shape[0], jnp.int32)
        return self.start(segment, self.segments.start[segment])

    def truncated(self, state: ReachState) -> Array:
        """True `[]` where the horizon has passed."""
        return state.step >= self.config.horizon

    def target(self, state: ReachState, action: Array) -> Float[Array, " n"]:
        """Configuration `[joint]` [rad] that an action `[joint]` (-1 to 1) leads to, if free."""
        rules = self.config
        to_go = (self.segments.goal[state.segment] - state.q) / rules.max_delta
        steps = jnp.max(jnp.abs(to_go))
        straight = to_go / jnp.maximum(steps, 1.0)
        # corrections vanish beside the goal, so that ends are exact
        correction = rules.authority * jnp.minimum(steps / rules.fade, 1.0) * action
        low, high = self.cell.chain.limits.T
        move = rules.max_delta * jnp.clip(straight + correction, -1, 1)
        return jnp.clip(state.q + move, low, high)

    def gap(self, cell: Workcell, points: Float[Array, "sample n"]) -> Float[Array, ""]:
        """Smallest clearance `[]` at configurations `[sample, joint]`, up to the margin [m]."""
        measure = CLEARANCE_UP_TO[self.config.backend]
        return jnp.min(jax.vmap(measure, (None, 0, None))(cell, points, self.config.margin))

    def reached(self, segment: Array, q: Array, pose: Array) -> Array:
        """Is the tool at the goal, and the arm on the goal's branch? A bool `[]`.

        Args:
            segment: `[]` index of the problem.
            q: `[joint]` configuration [rad].
            pose: `[8]` tool pose at `q`.
        """
        relative = dq.mul(dq.conj(pose), self.goal_pose[segment])
        # of half the angle; unlike the cosine it keeps its digits where the rotation is small
        sine = jnp.linalg.norm(relative[1:4])
        return (
            (jnp.linalg.norm(dq.position(relative)) <= self.config.near)
            & (2 * jnp.arcsin(jnp.clip(sine, 0, 1)) <= self.config.turned)
            & (jnp.max(jnp.abs(self.segments.goal[segment] - q)) <= self.config.same_branch)
        )

    def step(self, state: ReachState, action: Array) -> StepResult:
        """Make the move of `action` `[joint]` (-1 to 1) if it keeps the margin, else stay."""
        rules = self.config
        target = self.target(state, action)
        scene, body = self._scene(state.segment), None
        if self.servos:
            body, samples = self.servos.move(scene, state.body, target, rules.edge_samples)
        else:
            samples = points_between(state.q, target, rules.edge_samples)
        gap = self.gap(scene, samples)
        free = gap >= rules.margin
        q, body = jax.tree.map(
            lambda made, old: jnp.where(free, made, old), (samples[-1], body), (state.q, state.body)
        )
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
        next_state = ReachState(q, pose, state.segment, gap, state.step + 1, potential, body)
        return StepResult(next_state, reward, reached, reached, {"blocked": 1.0 - free})
