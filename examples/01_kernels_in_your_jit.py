# SPDX-License-Identifier: MIT
"""Kernels are plain JAX functions: they go into your own jit, vmap and grad.

Draws random configurations of the shipped arm, measures the clearance of all of them in one call,
and asks for the gradient that would move one of them away from what it is nearest to.

    python examples/01_kernels_in_your_jit.py
"""

import jax
import jax.numpy as jnp

import hybrid_jax as hj
from hybrid_jax.kernels import dualquat as dq

COUNT = 512


@jax.jit
def survey(cell, configurations):
    """Tool positions `[n, 3]` [m] and clearances `[n]` [m] of configurations `[n, joint]`."""
    poses = jax.vmap(lambda q: hj.tool_pose(cell, q))(configurations)
    gaps = jax.vmap(lambda q: hj.clearance(cell, q))(configurations)
    return dq.position(poses), gaps


def main() -> None:
    """Print how many configurations are free, and the way out for the worst of them."""
    cell = hj.load_workcell("gen3_handling")
    low, high = jnp.asarray(cell.joint_limits).T
    low, high = jnp.maximum(low, -jnp.pi), jnp.minimum(high, jnp.pi)
    drawn = jax.random.uniform(jax.random.key(0), (COUNT, low.size), minval=low, maxval=high)
    places, gaps = survey(cell, drawn)
    free = gaps > 0
    print(
        f"{int(free.sum())} of {COUNT} configurations are free of collision; in these the tool "
        f"is up to {float(places[free, 2].max()):.2f} m high"
    )
    worst = drawn[jnp.argmin(gaps)]
    slope = jax.grad(lambda q: hj.clearance(cell, q))(worst)
    print(
        f"the worst is {1e3 * float(gaps.min()):.0f} mm inside something; turning the joints by "
        f"{[round(float(x), 2) for x in slope]} leads out of it"
    )


if __name__ == "__main__":
    main()
