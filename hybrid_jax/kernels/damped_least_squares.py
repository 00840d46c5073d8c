# SPDX-License-Identifier: MIT
"""Damped least squares from a seed towards a tool pose, as a kernel over whole batches.

Levenberg-Marquardt steps in task space; joints stay within their limits throughout, and those
that would leave them are left out of a step (an active set, as in Baerlocher and Boulic 2004).
Components first, batch last, as in `kernels.vec3`.
"""

import functools

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from hybrid_jax.kernels import vec3
from hybrid_jax.kernels.batching import batch_size, batched, in_chunks
from hybrid_jax.kernels.kinematics import scan_joints
from hybrid_jax.kernels.ldl import gram, solve
from hybrid_jax.types import KinematicChain


def _rotation_vector(quat):
    """Rotation vector of a unit quaternion along the shorter arc, both by components."""
    sign = jnp.where(quat[0] < 0, -1.0, 1.0)
    w, v = quat[0] * sign, vec3.scale(quat[1:], sign)
    sine = jnp.sqrt(vec3.dot(v, v))
    is_small = sine < 1e-6
    angle = 2 * jnp.arctan2(sine, w)
    return vec3.scale(v, jnp.where(is_small, 2.0, angle / jnp.where(is_small, 1.0, sine)))


def _task_error(chain: KinematicChain, pose, q: Array):
    """Pose error `[6, b]` (target less tool, world axes), and the Jacobian `[6, joint, b]`.

    The Jacobian is the geometric one of the tool: linear rows, then angular rows.
    """
    (position, quat), (positions, quats) = scan_joints(chain, q)
    tool_position = vec3.add(position, vec3.quat_rotate(quat, chain.tool[:3]))
    tool_quat = vec3.quat_mul(quat, chain.tool[3:])
    target_position, target_quat = pose
    rotation = _rotation_vector(vec3.quat_mul(target_quat, vec3.quat_conj(tool_quat)))
    error = jnp.stack([*vec3.sub(target_position, tool_position), *rotation])
    axes = vec3.quat_rotate(quats, [chain.axis[:, i] for i in range(3)])
    tangents = vec3.cross(axes, vec3.sub([t[None] for t in tool_position], positions))
    linear = [chain.hinge * a + (1 - chain.hinge) * x for a, x in zip(tangents, axes, strict=True)]
    return error, jnp.stack([*linear, *vec3.scale(axes, chain.hinge)])


def _step(
    chain: KinematicChain, pose, q: Array, moves: Array, max_step: float, damping: float
) -> tuple[Array, Array]:
    """One damped step of the configurations `[joint, b]`, cut off at the joint limits.

    `moves` `[joint, b]` is 0 for joints that stand at a limit and are pulled beyond it, else 1:
    counted as free, they would take part of each step in vain, and many seeds would end there.
    """
    error, jacobian = _task_error(chain, pose, q)
    matrix = gram(jacobian * moves)
    # damping that grows with the squared error: steps far from the target stay moderate
    regularisation = damping + 0.1 * jnp.sum(error * error, axis=0)
    for i in range(6):
        matrix[i][i] = matrix[i][i] + regularisation
    forces = solve(matrix, error)
    delta = moves * sum(jacobian[i] * forces[i] for i in range(6))
    # scaled as a whole, so that the tool keeps its direction
    largest = jnp.max(jnp.abs(delta), axis=0)
    delta = delta * jnp.minimum(1.0, max_step / jnp.maximum(largest, 1e-9))
    low, high = chain.limits[:, 0], chain.limits[:, 1]
    after = jnp.clip(q + delta, low, high)
    # for the next step: asked within one, XLA's CPU back end would compute the Jacobian anew for
    # each of its uses
    pull = sum(jacobian[i] * error[i] for i in range(6))
    return after, jnp.where(pull > 0, after < high, after > low).astype(q.dtype)


def _descend(chain, pose, seed, iterations, *, max_step: float, damping: float):
    """Descend a chunk of items; leaves `[1 or b, ...]`."""
    chain, pose, q = jax.tree.map(lambda a: jnp.moveaxis(a, 0, -1), (chain, pose, seed))
    target = (vec3.position(pose), tuple(pose[:4]))
    q = jnp.broadcast_to(q, (q.shape[0], batch_size((seed, pose.T))))

    def step(_, state):
        return _step(chain, target, state[0], state[1], max_step, damping)

    q = jax.lax.fori_loop(0, jnp.max(iterations), step, (q, jnp.ones_like(q)))[0]
    return q.T, _task_error(chain, target, q)[0].T


@functools.cache
def _kernel(max_step: float, damping: float):
    """Function of one item for these settings, made once: each new one would be traced anew."""
    chunk_kernel = functools.partial(_descend, max_step=max_step, damping=damping)
    return batched(lambda *args: in_chunks(chunk_kernel, *args, cpu_chunk=512))


def descend(
    chain: KinematicChain,
    pose: Float[Array, "8"],
    seed: Float[Array, " n"],
    iterations: int | Array,
    max_step: float,
    damping: float,
) -> tuple[Float[Array, " n"], Float[Array, "6"]]:
    """Follow damped least-squares steps from a seed; joints stay within their limits.

    Args:
        chain: the arm.
        pose: `[8]` target pose of the tool in the world, unit dual quaternion.
        seed: `[joint]` configuration to start from [rad or m].
        iterations: steps to take, traced: another number needs no new program. Where the items
            of a batch differ, each chunk takes the largest number of its items.
        max_step: largest change of a joint in one step [rad or m].
        damping: at a solution; it grows with the error.

    Returns:
        The configuration `[joint]` [rad or m], and its pose error `[6]` from the tool to the
        target: position [m], rotation vector [rad], in world axes.
    """
    return _kernel(max_step, damping)(chain, pose, seed, jnp.asarray(iterations, jnp.int32))
