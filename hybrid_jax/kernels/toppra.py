# SPDX-License-Identifier: MIT
"""The fastest motion along a path under velocity and acceleration limits, for many paths at once.

TOPP-RA (Pham and Pham 2018, arXiv:1707.07239) with its "interpolation" scheme. Its linear programs
have two unknowns, acceleration u and squared speed x along the path, and symmetric limits: standing
still is always possible, so every set of controllable speeds begins at zero and its end is the
least of a few ratios (Fourier-Motzkin elimination of u). No solver is needed.
"""

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

INSIDE = 1 - 1e-5
"""Share of the controllable speeds that is used: single precision would leave them."""


def _ratio(above: Array, below: Array) -> Array:
    """`above / below` where `below` is positive, else no bound: infinity."""
    return jnp.where(below > 0, above / jnp.where(below > 0, below, 1.0), jnp.inf)


def _lines(slope: Array, bend: Array, step: Array, rate: Array) -> tuple[Array, Array, Array]:
    """Limits `|a u + b x| <= c` of each point, for itself and the next one; a >= 0.

    Args:
        slope, bend, rate: `[point, joint]`, see `controllable_speeds`.
        step: `[point]`.

    Returns:
        a, b and c `[point, 2 joint]`.
    """
    # at the next point x is x + 2 step u: the "interpolation" scheme keeps the limits there too
    double_step = 2 * step[:, None]
    next_slope, next_bend = jnp.roll(slope, -1, axis=0), jnp.roll(bend, -1, axis=0)
    a = jnp.concatenate([slope, next_slope + double_step * next_bend], axis=1)
    b = jnp.concatenate([bend, next_bend], axis=1)
    c = jnp.concatenate([rate, jnp.roll(rate, -1, axis=0)], axis=1)
    return jnp.abs(a), jnp.where(a < 0, -b, b), c


def _still_bounds(slope: Array, step: Array, lines, speed: Array, cap: Array) -> Array:
    """Largest squared speed `[point]` that the limits of the point itself allow."""
    a, b, c = lines
    # Fourier-Motzkin: some u lies between the bounds of each two limits
    pairs = _ratio(
        a[:, None] * c[:, :, None] + a[:, :, None] * c[:, None],
        a[:, None] * b[:, :, None] - a[:, :, None] * b[:, None],
    )
    bound = jnp.minimum(jnp.min(pairs, axis=(1, 2)), jnp.min((speed / jnp.abs(slope)) ** 2, axis=1))
    bound = jnp.minimum(bound, cap**2)
    # the squared speed at the next point must not be negative
    double_step = 2 * step[:, None]
    return jnp.minimum(bound, jnp.min(_ratio(double_step * c, double_step * b - a), axis=1))


def controllable_speeds(
    slope: Float[Array, "point n"],
    bend: Float[Array, "point n"],
    step: Float[Array, " point"],
    speed: Float[Array, "point n"],
    rate: Float[Array, "point n"],
    cap: Float[Array, " point"],
    after: Float[Array, ""],
) -> Float[Array, " point"]:
    """Largest squared speed at each point of a path from which the rest of it can be followed.

    Args:
        slope, bend: `[point, joint]` first and second derivative of the joint values by the path's
            parameter, of any unit.
        step: `[point]` difference of the parameter to the next point; zero at the last one and at
            those that only fill the array.
        speed, rate: `[point, joint]` velocity [rad/s or m/s] and acceleration limits [rad/s^2 or
            m/s^2] of the joints at each point.
        cap: `[point]` largest speed of the parameter at each point [1/s].
        after: `[]` the same at the last of these points, from what follows it [1/s^2].

    Returns:
        `[point]` squared speed of the parameter [1/s^2]; the last one is `after`.
    """
    a, b, c = lines = _lines(slope, bend, step, rate)
    bound = _still_bounds(slope, step, lines, speed, cap)

    def retreat(after, row):
        a, b, c, double_step, bound, at_end = row
        controllable = jnp.min(_ratio(a * after + double_step * c, a - double_step * b))
        end = jnp.where(at_end, 0.0, INSIDE * jnp.minimum(bound, controllable))
        return end, end

    rows = jax.tree.map(lambda row: row[:-1], (a, b, c, 2 * step, bound, step <= 0))
    ends = jax.lax.scan(retreat, after, rows, reverse=True, unroll=4)[1]
    return jnp.append(ends, after)


def greatest_speeds(
    slope: Float[Array, "point n"],
    bend: Float[Array, "point n"],
    step: Float[Array, " point"],
    rate: Float[Array, "point n"],
    controllable: Float[Array, " point"],
    here: Float[Array, ""],
) -> Float[Array, " point"]:
    """Squared speed at each point of a path if it always accelerates as much as it may.

    Args:
        slope, bend, step, rate: as for `controllable_speeds`.
        controllable: `[point]` its result [1/s^2].
        here: `[]` squared speed at the first point [1/s^2].

    Returns:
        `[point]` squared speed of the parameter [1/s^2].
    """
    a, b, c = _lines(slope, bend, step, rate)

    def advance(here, row):
        a, b, c, double_step, end = row
        push = jnp.min(_ratio(c - b * here, a))
        after = jnp.clip(here + double_step * push, 0.0, end)
        return after, here

    rows = *(row[:-1] for row in (a, b, c, 2 * step)), controllable[1:]
    last, speeds = jax.lax.scan(advance, here, rows, unroll=4)
    return jnp.append(speeds, last)
