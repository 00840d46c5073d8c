# SPDX-License-Identifier: MIT
"""Forward kinematics, Jacobian and manipulability of a serial arm, for one configuration.

A `lax.scan` over the joints instead of an unrolled chain: XLA's CPU back end re-evaluates shared
sub-expressions of long element-wise chains, a scan materialises each frame once.
"""

import functools

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from hybrid_jax.kernels import components as co
from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels.inputs import checks, configuration
from hybrid_jax.kernels.symmetric import factor, gram
from hybrid_jax.types import KinematicChain, Workcell

_TINY = 1e-9


def _step(frame, joint):
    """Frame of the next joint from the frame before it, by components."""
    (position, quat), (offset, axis, hinge, motion) = frame, joint
    position = co.add(position, co.quat_rotate(quat, offset[:3]))
    quat = co.quat_mul(quat, offset[3:])
    position = co.add(position, co.quat_rotate(quat, co.scale(axis, (1 - hinge) * motion)))
    half = 0.5 * motion * hinge
    quat = co.quat_mul(quat, (jnp.cos(half), *co.scale(axis, jnp.sin(half))))
    return (position, quat), (position, quat)


def scan_joints(chain: KinematicChain, q: Array):
    """Frame of the last joint and of every joint, as (position, quaternion) by components.

    Leaves of the chain are `[joint, ..., batch]`, `q` is `[joint, batch]`.
    """
    motion = q - chain.reference
    base = [jnp.broadcast_to(c, motion.shape[1:]) for c in chain.base]
    steps = (chain.offset, chain.axis, chain.hinge, motion)
    return jax.lax.scan(_step, ((*base[:3],), (*base[3:],)), steps)


def joint_frames(chain: KinematicChain, q: Float[Array, "n"]) -> Float[Array, "n 7"]:
    """Frame of every joint in the world: position [m], quaternion.

    A joint's frame sits on its axis and moves with it.
    """
    position, quat = scan_joints(chain, q)[1]
    return jnp.stack([*position, *quat], axis=-1)


def link_frames(chain: KinematicChain, q: Float[Array, "b n"]) -> tuple[Array, Array]:
    """Frames of all joints and of the tool, components first and batch last.

    Args:
        chain: leaves `[1 or b, ...]`.
        q: configurations.

    Returns:
        Positions `[3, joint + 1, b]` [m] and rotations `[3, 3, joint + 1, b]`.
    """
    chain = jax.tree.map(lambda a: jnp.moveaxis(a, 0, -1), chain)
    (position, quat), (positions, quats) = scan_joints(chain, q.T)
    tool_position = co.add(position, co.quat_rotate(quat, chain.tool[:3]))
    tool_quat = co.quat_mul(quat, chain.tool[3:])
    quats = [jnp.concatenate([a, b[None]]) for a, b in zip(quats, tool_quat, strict=True)]
    place = [jnp.concatenate([a, b[None]]) for a, b in zip(positions, tool_position, strict=True)]
    return jnp.stack(place), co.stack(co.quat_matrix(quats))


def _compose(frame: Array, local: Array) -> Array:
    """Frame times local frame, both `[7]`: position, quaternion."""
    position = frame[:3] + dq.quat_rotate(frame[3:], local[:3])
    return jnp.concatenate([position, dq.quat_mul(frame[3:], local[3:])])


def tool_frame(chain: KinematicChain, frames: Float[Array, "n 7"]) -> Float[Array, "7"]:
    """Tool frame in the world from the joint frames."""
    return _compose(frames[-1], chain.tool)


@checks(q=configuration)
@jax.jit
def tool_pose(cell: Workcell, q: Float[Array, "n"]) -> Float[Array, "8"]:
    """Pose of the tool in the world.

    Args:
        cell: the robot.
        q: `[joint]` configuration [rad].

    Returns:
        `[8]` unit dual quaternion (translations in m).

    Raises:
        InputError: `q` is no configuration of the arm.
    """
    tool = tool_frame(cell.chain, joint_frames(cell.chain, q))
    return dq.normalize(dq.from_parts(tool[:3], tool[3:]))


def frame_jacobian(chain: KinematicChain, frames: Array, point: Array) -> Float[Array, "6 n"]:
    """Geometric Jacobian of a world point fixed to the last link, from the joint frames."""
    axes = dq.quat_rotate(frames[:, 3:], chain.axis)
    arms = jnp.cross(axes, point - frames[:, :3])
    hinge = chain.hinge[:, None]
    linear = hinge * arms + (1 - hinge) * axes
    return jnp.concatenate([linear.T, (hinge * axes).T])


@checks(q=configuration)
@jax.jit
def jacobian(cell: Workcell, q: Float[Array, "n"]) -> Float[Array, "6 n"]:
    """Geometric Jacobian of the tool.

    Args:
        cell: the robot.
        q: `[joint]` configuration [rad].

    Returns:
        `[6, joint]`: linear rows [m/rad], then angular rows, in world axes.

    Raises:
        InputError: `q` is no configuration of the arm.
    """
    frames = joint_frames(cell.chain, q)
    return frame_jacobian(cell.chain, frames, tool_frame(cell.chain, frames)[:3])


@checks(q=configuration)
@jax.jit
def manipulability(cell: Workcell, q: Float[Array, "n"]) -> Float[Array, ""]:
    """Yoshikawa's measure `sqrt(det(J J^T))` (paper, section "Integrated Feasibility Map").

    Args:
        cell: the robot.
        q: `[joint]` configuration [rad].

    Returns:
        `[]`, 0 where the arm is singular [m^3 for an arm of hinges].

    Raises:
        InputError: `q` is no configuration of the arm.
    """
    matrix = gram(jacobian(cell, q))
    for i in range(6):
        matrix[i][i] = matrix[i][i] + _TINY  # pivots stay positive where the arm is singular
    square = functools.reduce(jnp.multiply, factor(matrix)[1])
    # a pivot that rounds to exactly zero is divided by: the arm is singular there
    sound = (square > 0) & (square < jnp.inf)
    return jnp.where(sound, jnp.sqrt(jnp.where(sound, square, 1.0)), 0.0)
