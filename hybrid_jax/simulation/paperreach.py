# SPDX-License-Identifier: MIT
"""Reaching as the paper states it (section MDP, equations 15 to 18): preset `paper`'s world.

Kept as it is, with its gaps, so that the paper's curves can be repeated: actions are absolute
joint angles, the target is a ball of 25 cm around a position, and obstacles cost reward but stop
nothing. `simulation.reach` is the world that the planner's agent learns in.
"""

from dataclasses import dataclass
from typing import Literal

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, PRNGKeyArray

from hybrid_jax.agents.segments import Segments
from hybrid_jax.agents.worlds import Move
from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels.collision import clearance_up_to
from hybrid_jax.kernels.kinematics import joint_frames, manipulability, tool_pose
from hybrid_jax.kernels.rays import RAY_COUNT, sense
from hybrid_jax.types import Workcell, pytree

SINGULAR_HOME = 1e-4
"""Manipulability below which a home pose cannot be the unit of manipulability."""
SEEN = 0.004
"""Clearances are told apart up to this much above the margin [m]."""


@dataclass(frozen=True)
class PaperReachConfig:
    """Rules of the world."""

    reward: Literal["feasibility", "distance"] = "feasibility"
    """`feasibility`: fea(D) - d (DRL-Feasibility); `distance`: minus the joint-space distance,
    the reward of the agents that it is compared with."""
    target: Literal["target", "ee"] = "target"
    """What TP and TO are: the goal's tool pose, or, to the letter, the end effector's, which
    leaves the agent without any sight of its goal."""
    radius: float = 0.25
    """Distance of the tool from the goal at which an episode ends [m]."""
    arrival: float = 0.1
    """Reward within that distance."""
    drop_infeasible: bool = True
    """Learn from feasible transitions only (Algorithm 3, line 6)."""
    margin: float = 0.0
    """Clearance below which a configuration is infeasible [m]."""
    horizon: int = 200
    """Steps after which an episode may be cut."""
    period: float = 0.1
    """Time of a step, for the velocities that are observed [s]."""


@pytree
class PaperReachState:
    """Where one copy of the world stands."""

    q: Array
    """`[joint]`."""
    frames: Array
    """`[joint, 7]` joint frames at `q`."""
    before: Array
    """The same one step earlier."""
    segment: Array
    """Index of the problem."""
    step: Array
    """Steps since the start."""


def euler(quat: Float[Array, "*n 4"]) -> Float[Array, "*n 3"]:
    """Roll, pitch and yaw [rad]: the rotation is `Rz(yaw) Ry(pitch) Rx(roll)`."""
    w, x, y, z = jnp.moveaxis(quat, -1, 0)
    roll = jnp.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = jnp.arcsin(jnp.clip(2 * (w * y - z * x), -1, 1))
    yaw = jnp.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return jnp.stack([roll, pitch, yaw], axis=-1)


class PaperReachWorld:
    """A `World` (see `agents.worlds`) of segments to be bridged, as in the paper."""

    def __init__(
        self, cell: Workcell, segments: Segments, config: PaperReachConfig = PaperReachConfig()
    ):
        """Args:
            cell: robot and fixtures.
            segments: problems to draw from.
            config: rules.

        Raises:
            ValueError: the home pose is singular: manipulability cannot be counted in its units.
        """
        self.cell, self.segments, self.config = cell, segments, config
        self.goal_pose = jax.vmap(tool_pose, (None, 0))(cell, segments.goal)
        with jax.ensure_compile_time_eval():  # a number, also where a program is being traced
            self.unit = float(manipulability(cell, cell.home))
        if self.unit < SINGULAR_HOME:
            raise ValueError(
                f"manipulability at home is {self.unit:.2g}: preset 'paper' divides by it; choose "
                f"a home pose away from singularities, or another preset"
            )
        self.action_size = cell.home.size
        self.observation_size = self.observation_length(cell)

    @staticmethod
    def observation_length(cell: Workcell) -> int:
        """Length of an observation in a cell: 12 n + 31."""
        return 12 * cell.home.size + 6 + RAY_COUNT

    def _inside(self, segment: Array) -> Workcell:
        scene = jax.tree.map(lambda a: a[segment], self.segments.scene)
        return self.cell.replace(scene=scene)

    def observe(self, state: PaperReachState) -> Float[Array, "obs"]:
        """<JP, JO, LV, AV, TP, TO, RL> (eq. 15, 16): 12 n + 31 numbers."""
        position, quat = state.frames[:, :3], state.frames[:, 3:]
        linear = (position - state.before[:, :3]) / self.config.period
        turn = dq.quat_mul(quat, dq.quat_conj(state.before[:, 3:]))
        angular = dq.quat_log(turn) / self.config.period
        tool = tool_pose(self.cell, state.q)
        aim = self.goal_pose[state.segment] if self.config.target == "target" else tool
        rays = sense(self._inside(state.segment), tool)
        joints = (position, euler(quat), linear, angular)
        parts = (*joints, dq.position(aim), euler(aim[:4]), rays)
        return jnp.concatenate([part.reshape(-1) for part in parts])

    def start(self, segment: Array, q: Array) -> PaperReachState:
        """A given problem from a given configuration, at rest."""
        frames = joint_frames(self.cell.chain, q)
        return PaperReachState(q, frames, frames, segment, jnp.zeros((), jnp.int32))

    def begin(self, key: PRNGKeyArray) -> PaperReachState:
        """A random problem, from its start."""
        segment = jax.random.randint(key, (), 0, self.segments.start.shape[0], jnp.int32)
        return self.start(segment, self.segments.start[segment])

    def overdue(self, state: PaperReachState) -> Array:
        return state.step >= self.config.horizon

    def feasibility(self, segment: Array, q: Array) -> tuple[Array, Array]:
        """fea = RH man' (1 - COL), and COL. Any action is within the limits, so RH is 1."""
        margin = self.config.margin
        hit = 1.0 * (clearance_up_to(self._inside(segment), q, margin + SEEN) < margin)
        return manipulability(self.cell, q) / self.unit * (1 - hit), hit

    def step(self, state: PaperReachState, action: Array) -> Move:
        low, high = self.cell.chain.limits.T
        q = low + (high - low) * (jnp.clip(action, -1, 1) + 1) / 2
        frames = joint_frames(self.cell.chain, q)
        goal = dq.position(self.goal_pose[state.segment])
        distance = jnp.linalg.norm(dq.position(tool_pose(self.cell, q)) - goal)
        arrived = distance < self.config.radius
        fea, hit = self.feasibility(state.segment, q)
        away = jnp.linalg.norm(self.segments.goal[state.segment] - q)
        going = fea - distance if self.config.reward == "feasibility" else -away
        reward = jnp.where(arrived, self.config.arrival, going)
        after = PaperReachState(q, frames, state.frames, state.segment, state.step + 1)
        facts = {"collision": hit, "distance": distance}
        kept = 1 - hit if self.config.drop_infeasible else None
        return Move(after, reward, arrived, arrived & (hit == 0), facts, kept)
