# SPDX-License-Identifier: MIT
"""Reaching as the paper states it (section MDP, equations 15 to 18): environment of preset `paper`.

Kept as it is, with its gaps, so that the paper's curves can be repeated: actions are absolute
joint angles, the target is a ball of 25 cm around a position, and obstacles cost reward but stop
nothing. `envs.reach` is the environment that the planner's agent learns in.
"""

from dataclasses import dataclass
from typing import Literal

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, PRNGKeyArray

from hybrid_jax.contracts import Segments
from hybrid_jax.envs.base import StepResult
from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels.collision.clearance import clearance_up_to
from hybrid_jax.kernels.kinematics import joint_frames, manipulability, tool_pose
from hybrid_jax.kernels.rays import RAY_COUNT, sense
from hybrid_jax.types import Record, Workcell, pytree

SINGULAR_HOME = 1e-4
"""Manipulability below which a home pose cannot be the unit of manipulability."""
SEEN = 0.004
"""Clearances are measured up to this much above the margin [m]."""


@dataclass(frozen=True)
class PaperReachConfig:
    """Rules of the environment."""

    reward: Literal["feasibility", "distance"] = "feasibility"
    """`feasibility`: fea(D) - d (DRL-Feasibility). `distance`: minus the joint-space distance,
    the reward of the agents that DRL-Feasibility is compared with."""
    target: Literal["target", "ee"] = "target"
    """Pose that TP and TO describe. `target`: the goal's tool pose. `ee`: the end effector's, as
    the paper says to the letter; then no observation holds the goal."""
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
    """Duration of a step, for the observed velocities [s]."""


@pytree
class PaperReachState(Record):
    """State of one copy of the environment."""

    q: Array
    """`[joint]` configuration [rad]."""
    frames: Array
    """`[joint, 7]` joint frames at `q`: position [m], quaternion."""
    before: Array
    """`[joint, 7]` joint frames one step earlier."""
    segment: Array
    """Index of the problem."""
    step: Array
    """Steps since the start."""


def euler(quat: Float[Array, "*n 4"]) -> Float[Array, "*n 3"]:
    """Roll, pitch and yaw `[..., 3]` [rad] of quaternions `[..., 4]`: `Rz(yaw) Ry(pitch) Rx(roll)`.

    They jump where the pitch passes a right angle or an angle passes half a turn.
    """
    w, x, y, z = jnp.moveaxis(quat, -1, 0)
    roll = jnp.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = jnp.arcsin(jnp.clip(2 * (w * y - z * x), -1, 1))
    yaw = jnp.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return jnp.stack([roll, pitch, yaw], axis=-1)


class PaperReachEnv:
    """An `Env` (see `envs.base`) of segments to be bridged, as in the paper."""

    def __init__(
        self, cell: Workcell, segments: Segments, config: PaperReachConfig = PaperReachConfig()
    ):
        """Make an environment of some segments.

        Args:
            cell: robot and fixtures.
            segments: problems to draw from, with `[segment, joint]` ends [rad].
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
        """Length of an observation in a cell: 12 n + 31 for n joints."""
        return 12 * cell.home.size + 6 + RAY_COUNT

    def _inside(self, segment: Array) -> Workcell:
        scene = jax.tree.map(lambda a: a[segment], self.segments.scene)
        return self.cell.replace(scene=scene)

    def observe(self, state: PaperReachState) -> Float[Array, " obs"]:
        """Observation `[obs]` of 12 n + 31 numbers: <JP, JO, LV, AV, TP, TO, RL> (eq. 15, 16)."""
        position, quat = state.frames[:, :3], state.frames[:, 3:]
        linear = (position - state.before[:, :3]) / self.config.period
        rotation = dq.quat_mul(quat, dq.quat_conj(state.before[:, 3:]))
        angular = dq.quat_log(rotation) / self.config.period
        tool = tool_pose(self.cell, state.q)
        target_pose = self.goal_pose[state.segment] if self.config.target == "target" else tool
        rays = sense(self._inside(state.segment), tool)
        joints = (position, euler(quat), linear, angular)
        parts = (*joints, dq.position(target_pose), euler(target_pose[:4]), rays)
        return jnp.concatenate([part.reshape(-1) for part in parts])

    def start(self, segment: Array, q: Array) -> PaperReachState:
        """State of a problem (index `[]`) at a configuration `[joint]` [rad], at rest."""
        frames = joint_frames(self.cell.chain, q)
        return PaperReachState(q, frames, frames, segment, jnp.zeros((), jnp.int32))

    def reset(self, key: PRNGKeyArray) -> PaperReachState:
        """State at the start of a random problem."""
        segment = jax.random.randint(key, (), 0, self.segments.start.shape[0], jnp.int32)
        return self.start(segment, self.segments.start[segment])

    def truncated(self, state: PaperReachState) -> Array:
        """True `[]` where the horizon has passed."""
        return state.step >= self.config.horizon

    def feasibility(self, segment: Array, q: Array) -> tuple[Array, Array]:
        """fea = RH man' (1 - COL) and COL, scalars `[]`, at a configuration `[joint]` [rad].

        Any action is within the limits, so RH is 1.
        """
        margin = self.config.margin
        hit = 1.0 * (clearance_up_to(self._inside(segment), q, margin + SEEN) < margin)
        return manipulability(self.cell, q) / self.unit * (1 - hit), hit

    def step(self, state: PaperReachState, action: Array) -> StepResult:
        """Go to the configuration `action` `[joint]`, where -1 to 1 spans the joint limits."""
        low, high = self.cell.chain.limits.T
        q = low + (high - low) * (jnp.clip(action, -1, 1) + 1) / 2
        frames = joint_frames(self.cell.chain, q)
        # the paper's distance is that of positions: orientation at the goal is not rewarded
        goal = dq.position(self.goal_pose[state.segment])
        distance = jnp.linalg.norm(dq.position(tool_pose(self.cell, q)) - goal)
        arrived = distance < self.config.radius
        fea, hit = self.feasibility(state.segment, q)
        joint_distance = jnp.linalg.norm(self.segments.goal[state.segment] - q)
        running = fea - distance if self.config.reward == "feasibility" else -joint_distance
        reward = jnp.where(arrived, self.config.arrival, running)
        next_state = PaperReachState(q, frames, state.frames, state.segment, state.step + 1)
        info = {"collision": hit, "distance": distance}
        weight = 1 - hit if self.config.drop_infeasible else None
        return StepResult(next_state, reward, arrived, arrived & (hit == 0), info, weight)
