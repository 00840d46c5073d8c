# SPDX-License-Identifier: MIT
"""Reaching as the paper states it (section MDP, equations 15 to 18): environment of preset `paper`.

Actions are absolute joint angles and the target is a ball around a position. Where the text leaves
a gap there are two readings: `PaperReachConfig` is the one that can be executed, `LITERAL` the one
word by word, in which a step crosses the cell and obstacles stop nothing. `envs.reach` is the
environment that the default planner's agent learns in.
"""

from dataclasses import dataclass
from typing import Literal

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, PRNGKeyArray

from hybrid_jax.contracts import Segments
from hybrid_jax.envs.base import StepResult
from hybrid_jax.errors import InputError
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
    radius: float = 0.05
    """Distance of the tool from the goal at which an episode ends [m]."""
    arrival: float = 0.1
    """Reward within that distance."""
    hover_cost: float = 1.0
    """What hovering at full feasibility costs: outside the target area fea is capped at this and
    lowered by it. With 0, as in the paper, hovering earns more than arriving."""
    drop_infeasible: bool = True
    """Learn from feasible transitions only (Algorithm 3, line 6)."""
    at_rates: bool = True
    """Does a step lead towards the action's configuration for one period, at the joints' highest
    rates, and not at all where it would not keep the margin? Else the arm is there at once,
    through whatever lies between."""
    margin: float = 0.008
    """Clearance below which a configuration is infeasible [m]."""
    edge_samples: int = 4
    """Clearance checks along a step at the joints' rates."""
    horizon: int = 100
    """Steps after which an episode may be cut."""
    period: float = 0.2
    """Duration of a step [s]."""


LITERAL = PaperReachConfig(
    radius=0.25, hover_cost=0.0, at_rates=False, margin=0.0, horizon=200, period=0.1
)
"""The paper word by word, with the radius of its training."""
PURE = PaperReachConfig(
    reward="distance", radius=0.25, drop_infeasible=False, arrival=float(PaperReachConfig().horizon)
)
"""The agents that DRL-Feasibility is compared with: the distance in joint space, and at the goal
the reward that feasibility gives in a whole episode at home, which is of the same scale."""


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


def home_manipulability(cell: Workcell) -> Array:
    """man(theta_0) `[]`, in whose units the paper counts manipulability.

    Raises:
        InputError: the home pose is singular; not while the cell itself is being traced.
    """
    with jax.ensure_compile_time_eval():  # a number, also where a program is being traced
        unit = manipulability(cell, cell.home)
    if not isinstance(unit, jax.core.Tracer) and float(unit) < SINGULAR_HOME:
        raise InputError(
            f"manipulability at home is {float(unit):.2g}: preset 'paper' divides by it; choose "
            f"a home pose away from singularities, or another preset"
        )
    return unit


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
            InputError: the home pose is singular.
        """
        self.cell, self.segments, self.config = cell, segments, config
        self.goal_pose = jax.vmap(tool_pose, (None, 0))(cell, segments.goal)
        self.unit = home_manipulability(cell)
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

    def feasibility(self, q: Array, hit: Array) -> Float[Array, ""]:
        """fea = RH man' (1 - COL) `[]` at a configuration `[joint]` [rad], where COL is `hit` `[]`.

        Any action is within the limits, so RH is 1.
        """
        return manipulability(self.cell, q) / self.unit * (1 - hit)

    def commanded(self, action: Float[Array, " n"]) -> Float[Array, " n"]:
        """Configuration `[joint]` [rad] of an action `[joint]`: -1 to 1 spans the joint limits.

        At the joints' rates it spans one turn around home of joints that can turn further.
        """
        low, high = self.cell.chain.limits.T
        if self.config.at_rates:
            home = self.cell.home
            low, high = jnp.maximum(low, home - jnp.pi), jnp.minimum(high, home + jnp.pi)
        return low + (high - low) * (jnp.clip(action, -1, 1) + 1) / 2

    def moved(self, state: PaperReachState, action: Array) -> tuple[Array, Array]:
        """Configuration `[joint]` [rad] after an action `[joint]`, and COL `[]` of the attempt."""
        rules, cell, target = self.config, self._inside(state.segment), self.commanded(action)
        if not rules.at_rates:
            gap = clearance_up_to(cell, target, rules.margin + SEEN)
            return target, 1.0 * (gap < rules.margin)
        periods = jnp.abs(target - state.q) / (self.cell.velocity_limits * rules.period)
        target = state.q + (target - state.q) / jnp.maximum(jnp.max(periods), 1.0)
        share = jnp.arange(rules.edge_samples + 1)[:, None] / rules.edge_samples
        way = state.q + share * (target - state.q)
        gaps = jax.vmap(clearance_up_to, (None, 0, None))(cell, way, rules.margin + SEEN)
        # an arm that stands closer to something may move, but no closer
        hit = jnp.min(gaps[1:]) < jnp.minimum(rules.margin, gaps[0])
        return jnp.where(hit, state.q, target), 1.0 * hit

    def step(self, state: PaperReachState, action: Array) -> StepResult:
        """Go to, or towards, the configuration of an action `[joint]`, see `commanded`."""
        rules = self.config
        q, hit = self.moved(state, action)
        frames = joint_frames(self.cell.chain, q)
        # the paper's distance is that of positions: orientation at the goal is not rewarded
        goal = dq.position(self.goal_pose[state.segment])
        distance = jnp.linalg.norm(dq.position(tool_pose(self.cell, q)) - goal)
        arrived = distance < rules.radius
        # an arm that does not move into an obstacle stands where it is feasible
        fea = self.feasibility(q, jnp.zeros(()) if rules.at_rates else hit)
        if rules.hover_cost:
            fea = jnp.minimum(fea, rules.hover_cost) - rules.hover_cost
        joint_distance = jnp.linalg.norm(self.segments.goal[state.segment] - q)
        running = fea - distance if rules.reward == "feasibility" else -joint_distance
        reward = jnp.where(arrived, rules.arrival, running)
        next_state = PaperReachState(q, frames, state.frames, state.segment, state.step + 1)
        info = {"collision": hit, "distance": distance}
        weight = 1 - hit if rules.drop_infeasible else None
        success = arrived if rules.at_rates else arrived & (hit == 0)
        return StepResult(next_state, reward, arrived, success, info, weight)
