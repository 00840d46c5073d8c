# SPDX-License-Identifier: MIT
"""Forward kinematics, Jacobian and manipulability of a serial arm, for one configuration.

A `lax.scan` over the joints instead of an unrolled chain: XLA's CPU back end re-evaluates shared
sub-expressions of long element-wise chains, a scan materialises each frame once.
"""

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.types import KinematicChain, Workcell


def _compose(frame: Array, local: Array) -> Array:
    """Frame times local frame, both `[7]`: position, quaternion."""
    position = frame[:3] + dq.quat_rotate(frame[3:], local[:3])
    return jnp.concatenate([position, dq.quat_mul(frame[3:], local[3:])])


def joint_frames(chain: KinematicChain, q: Float[Array, "n"]) -> Float[Array, "n 7"]:
    """Frame of every joint in the world: position [m], quaternion.

    A joint's frame sits on its axis and moves with it.
    """

    def step(frame, joint):
        offset, axis, hinge, motion = joint
        frame = _compose(frame, offset)
        half = 0.5 * motion * hinge
        turn = jnp.concatenate([jnp.cos(half)[None], jnp.sin(half) * axis])
        frame = _compose(frame, jnp.concatenate([(1 - hinge) * motion * axis, turn]))
        return frame, frame

    motion = q - chain.reference
    return jax.lax.scan(step, chain.base, (chain.offset, chain.axis, chain.hinge, motion))[1]


def tool_frame(chain: KinematicChain, frames: Float[Array, "n 7"]) -> Float[Array, "7"]:
    """Tool frame in the world from the joint frames."""
    return _compose(frames[-1], chain.tool)


@jax.jit
def tool_pose(cell: Workcell, q: Float[Array, "n"]) -> Float[Array, "8"]:
    """Pose of the tool in the world as a unit dual quaternion."""
    tool = tool_frame(cell.chain, joint_frames(cell.chain, q))
    return dq.normalize(dq.from_parts(tool[:3], tool[3:]))


def frame_jacobian(chain: KinematicChain, frames: Array, point: Array) -> Float[Array, "6 n"]:
    """Geometric Jacobian of a world point fixed to the last link, from the joint frames."""
    axes = dq.quat_rotate(frames[:, 3:], chain.axis)
    arms = jnp.cross(axes, point - frames[:, :3])
    hinge = chain.hinge[:, None]
    linear = hinge * arms + (1 - hinge) * axes
    return jnp.concatenate([linear.T, (hinge * axes).T])


@jax.jit
def jacobian(cell: Workcell, q: Float[Array, "n"]) -> Float[Array, "6 n"]:
    """Geometric Jacobian of the tool: linear rows [m/rad], then angular rows, world axes."""
    frames = joint_frames(cell.chain, q)
    return frame_jacobian(cell.chain, frames, tool_frame(cell.chain, frames)[:3])


@jax.jit
def manipulability(cell: Workcell, q: Float[Array, "n"]) -> Float[Array, ""]:
    """Yoshikawa's measure `sqrt(det(J J^T))` (paper, section "Integrated Feasibility Map")."""
    j = jacobian(cell, q)
    return jnp.sqrt(jnp.maximum(jnp.linalg.det(j @ j.T), 0.0))
