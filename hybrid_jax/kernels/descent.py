# SPDX-License-Identifier: MIT
"""Damped least squares from a seed towards a tool pose, as a kernel over whole batches.

Levenberg-Marquardt steps in task space; joints stay within their limits throughout (Chan and
Dubey 1995 clamp the same way). Components first, batch last, as in `kernels.components`.
"""

import functools

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from hybrid_jax.kernels import components as co
from hybrid_jax.kernels.batching import batch_size, batched, in_chunks
from hybrid_jax.kernels.kinematics import scan_joints
from hybrid_jax.kernels.symmetric import gram, solve
from hybrid_jax.types import KinematicChain


def _rotation_vector(quat):
    """Rotation vector of a unit quaternion, on its shorter way."""
    sign = jnp.where(quat[0] < 0, -1.0, 1.0)
    w, v = quat[0] * sign, co.scale(quat[1:], sign)
    sine = jnp.sqrt(co.dot(v, v))
    small = sine < 1e-6
    angle = 2 * jnp.arctan2(sine, w)
    return co.scale(v, jnp.where(small, 2.0, angle / jnp.where(small, 1.0, sine)))


def _task_error(chain: KinematicChain, pose, q: Array):
    """Pose error `[6, b]`, and the geometric Jacobian `[6, joint, b]`."""
    (place, quat), (places, quats) = scan_joints(chain, q)
    tool = co.add(place, co.quat_rotate(quat, chain.tool[:3]))
    turned = co.quat_mul(quat, chain.tool[3:])
    target, wanted = pose
    rotation = _rotation_vector(co.quat_mul(wanted, co.quat_conj(turned)))
    error = jnp.stack([*co.sub(target, tool), *rotation])
    axes = co.quat_rotate(quats, [chain.axis[:, i] for i in range(3)])
    arms = co.cross(axes, co.sub([t[None] for t in tool], places))
    linear = [chain.hinge * a + (1 - chain.hinge) * x for a, x in zip(arms, axes, strict=True)]
    return error, jnp.stack([*linear, *co.scale(axes, chain.hinge)])


def _step(chain: KinematicChain, pose, q: Array, max_step: float, damping: float) -> Array:
    error, jacobian = _task_error(chain, pose, q)
    matrix = gram(jacobian)
    weight = damping + 0.1 * jnp.sum(error * error, axis=0)
    for i in range(6):
        matrix[i][i] = matrix[i][i] + weight
    forces = solve(matrix, error)
    move = sum(jacobian[i] * forces[i] for i in range(6))
    largest = jnp.max(jnp.abs(move), axis=0)
    move = move * jnp.minimum(1.0, max_step / jnp.maximum(largest, 1e-9))
    return jnp.clip(q + move, chain.limits[:, 0], chain.limits[:, 1])


def _descend(chain, pose, seed, iterations, *, max_step: float, damping: float):
    """One chunk; leaves `[1 or b, ...]`."""
    chain, pose, q = jax.tree.map(lambda a: jnp.moveaxis(a, 0, -1), (chain, pose, seed))
    target = (co.position(pose), tuple(pose[:4]))
    q = jnp.broadcast_to(q, (q.shape[0], batch_size((seed, pose.T))))
    q = jax.lax.fori_loop(
        0, jnp.max(iterations), lambda _, q: _step(chain, target, q, max_step, damping), q
    )
    return q.T, _task_error(chain, target, q)[0].T


@functools.cache
def _kernel(max_step: float, damping: float):
    one = functools.partial(_descend, max_step=max_step, damping=damping)
    return batched(lambda *args: in_chunks(one, *args, cpu_chunk=512))


def descend(
    chain: KinematicChain,
    pose: Float[Array, "8"],
    seed: Float[Array, "n"],
    iterations: int | Array,
    max_step: float,
    damping: float,
) -> tuple[Float[Array, "n"], Float[Array, "6"]]:
    """Follow damped least-squares steps from a seed; joints stay within their limits.

    Args:
        chain: the arm.
        pose: wanted tool pose, unit dual quaternion.
        seed: where to start.
        iterations: steps to take; no new trace for another number.
        max_step: largest change of a joint in one step [rad or m].
        damping: at a solution; it grows with the error.

    Returns:
        The configuration and its pose error: position [m], rotation vector [rad], world axes.
    """
    return _kernel(max_step, damping)(chain, pose, seed, jnp.asarray(iterations, jnp.int32))
