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

from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels import vec3
from hybrid_jax.kernels.argument_checks import checks, configuration
from hybrid_jax.kernels.ldl import factor, gram
from hybrid_jax.runtime.kept_programs import kept
from hybrid_jax.types import KinematicChain, Workcell

_TINY = 1e-9


def _step(frame, joint):
    """Frame of the next joint from the frame before it, by components.

    A slide moves along its axis before a hinge turns about it; a joint is one of the two.
    """
    (position, quat), (offset, axis, hinge, motion) = frame, joint
    position = vec3.add(position, vec3.quat_rotate(quat, offset[:3]))
    quat = vec3.quat_mul(quat, offset[3:])
    position = vec3.add(position, vec3.quat_rotate(quat, vec3.scale(axis, (1 - hinge) * motion)))
    half_angle = 0.5 * motion * hinge
    quat = vec3.quat_mul(quat, (jnp.cos(half_angle), *vec3.scale(axis, jnp.sin(half_angle))))
    return (position, quat), (position, quat)


def scan_joints(chain: KinematicChain, q: Array):
    """Frames of the joints in the world, by components.

    Args:
        chain: leaves `[joint, ...]` or, for a batch, `[joint, ..., 1 or b]`.
        q: `[joint]` or `[joint, b]` [rad or m].

    Returns:
        The last joint's frame and those of all joints, each as three components of the position
        [m] and four of the quaternion: of shape `[]` or `[b]`, and `[joint]` or `[joint, b]`.
    """
    motion = q - chain.reference
    base = [jnp.broadcast_to(c, motion.shape[1:]) for c in chain.base]
    steps = (chain.offset, chain.axis, chain.hinge, motion)
    return jax.lax.scan(_step, ((*base[:3],), (*base[3:],)), steps)


def joint_frames(chain: KinematicChain, q: Float[Array, " n"]) -> Float[Array, "n 7"]:
    """Frame of every joint in the world; it sits on the joint's axis and moves with the joint.

    Args:
        chain: the arm.
        q: `[joint]` configuration [rad or m].

    Returns:
        `[joint, 7]` position [m], quaternion.
    """
    position, quat = scan_joints(chain, q)[1]
    return jnp.stack([*position, *quat], axis=-1)


def link_frames(chain: KinematicChain, q: Float[Array, "b n"]) -> tuple[Array, Array]:
    """Frames of all joints and of the tool, components first and batch last.

    Args:
        chain: leaves `[1 or b, ...]`.
        q: `[b, joint]` configurations [rad or m].

    Returns:
        Positions `[3, joint + 1, b]` [m] and rotation matrices `[3, 3, joint + 1, b]`, component
        before axis; the tool comes last.
    """
    # the scan's axis must be the first one: the batch axis moves to the end
    chain = jax.tree.map(lambda a: jnp.moveaxis(a, 0, -1), chain)
    (position, quat), (positions, quats) = scan_joints(chain, q.T)
    tool_position = vec3.add(position, vec3.quat_rotate(quat, chain.tool[:3]))
    tool_quat = vec3.quat_mul(quat, chain.tool[3:])
    quats = [jnp.concatenate([a, b[None]]) for a, b in zip(quats, tool_quat, strict=True)]
    frame_positions = [
        jnp.concatenate([a, b[None]]) for a, b in zip(positions, tool_position, strict=True)
    ]
    return jnp.stack(frame_positions), vec3.stack(vec3.quat_matrix(quats))


def _compose(frame: Array, local: Array) -> Array:
    """Frame times local frame, both `[7]`: position, quaternion."""
    position = frame[:3] + dq.quat_rotate(frame[3:], local[:3])
    return jnp.concatenate([position, dq.quat_mul(frame[3:], local[3:])])


def tool_frame(chain: KinematicChain, frames: Float[Array, "n 7"]) -> Float[Array, "7"]:
    """Tool frame in the world from the joint frames.

    Args:
        chain: the arm.
        frames: `[joint, 7]` joint frames in the world: position [m], quaternion.

    Returns:
        `[7]` position [m], quaternion.
    """
    return _compose(frames[-1], chain.tool)


@checks(q=configuration)
@kept
def tool_pose(cell: Workcell, q: Float[Array, " n"]) -> Float[Array, "8"]:
    """Pose of the tool in the world.

    Args:
        cell: the robot.
        q: `[joint]` configuration [rad or m].

    Returns:
        `[8]` unit dual quaternion (translations in m).

    Raises:
        InputError: `q` is no configuration of the arm.
    """
    tool = tool_frame(cell.chain, joint_frames(cell.chain, q))
    return dq.normalize(dq.from_parts(tool[:3], tool[3:]))


def frame_jacobian(chain: KinematicChain, frames: Array, point: Array) -> Float[Array, "6 n"]:
    """Geometric Jacobian of a point that is fixed to the last link.

    Args:
        chain: the arm.
        frames: `[joint, 7]` joint frames in the world: position [m], quaternion.
        point: `[3]` where the point is in the world [m].

    Returns:
        `[6, joint]` linear rows [m/rad, or 1 for a slide], then angular rows, in world axes.
    """
    axes = dq.quat_rotate(frames[:, 3:], chain.axis)
    tangents = jnp.cross(axes, point[None] - frames[:, :3])
    hinge = chain.hinge[:, None]
    linear = hinge * tangents + (1 - hinge) * axes
    return jnp.concatenate([linear.T, (hinge * axes).T])


@checks(q=configuration)
@kept
def jacobian(cell: Workcell, q: Float[Array, " n"]) -> Float[Array, "6 n"]:
    """Geometric Jacobian of the tool.

    Args:
        cell: the robot.
        q: `[joint]` configuration [rad or m].

    Returns:
        `[6, joint]`: linear rows [m/rad, or 1 for a slide], then angular rows, in world axes.

    Raises:
        InputError: `q` is no configuration of the arm.
    """
    frames = joint_frames(cell.chain, q)
    return frame_jacobian(cell.chain, frames, tool_frame(cell.chain, frames)[:3])


def chain_manipulability(chain: KinematicChain, q: Float[Array, " n"]) -> Float[Array, ""]:
    """`manipulability` `[]` of an arm `chain` at a configuration `[joint]` [rad or m]."""
    frames = joint_frames(chain, q)
    matrix = gram(frame_jacobian(chain, frames, tool_frame(chain, frames)[:3]))
    for i in range(6):
        matrix[i][i] = matrix[i][i] + _TINY  # pivots stay positive where the arm is singular
    determinant = functools.reduce(jnp.multiply, factor(matrix)[1])
    # a pivot that rounds to exactly zero is divided by: the arm is singular there
    regular = (determinant > 0) & (determinant < jnp.inf)
    return jnp.where(regular, jnp.sqrt(jnp.where(regular, determinant, 1.0)), 0.0)


@checks(q=configuration)
@kept
def manipulability(cell: Workcell, q: Float[Array, " n"]) -> Float[Array, ""]:
    """Yoshikawa's measure `sqrt(det(J J^T))` (paper, section "Integrated Feasibility Map").

    Args:
        cell: the robot.
        q: `[joint]` configuration [rad or m].

    Returns:
        `[]`, 0 where the arm is singular [m^3 for an arm of hinges].

    Raises:
        InputError: `q` is no configuration of the arm.
    """
    return chain_manipulability(cell.chain, q)
