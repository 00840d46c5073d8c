# SPDX-License-Identifier: MIT
"""Straight edges in joint space, checked so that nothing slips between the samples.

Along an edge no point of the robot moves faster than a bound that follows from the lengths of the
chain, so the clearance at one sample proves a stretch of the edge free (conservative advancement:
Mirtich 1996; Schwarzer, Saha and Latombe 2005 use the same bound).
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float

from hybrid_jax.kernels.batching import padded_chunks
from hybrid_jax.kernels.collision import clearance
from hybrid_jax.kernels.inputs import checks, configuration
from hybrid_jax.kernels.primitives import local_shapes, row_links
from hybrid_jax.types import Scene, Workcell

PIECE = 32
"""Way points of a path that are proven at once, ..."""
PIECES = 4
"""... in so many pieces of paths."""


def motion_reach(cell: Workcell) -> Float[Array, "n"]:
    """How far any point of robot or payload may move per unit of each joint [m/rad or m/m].

    A point of a link is at most as far from a joint before it as the offsets between them add up
    to, plus the link's own extent and the travel of slides on the way.
    """
    chain, shapes = cell.chain, local_shapes(cell)
    extent = jnp.linalg.norm(shapes.pose[:, :3], axis=1) + shapes.radius
    extent = (extent + jnp.linalg.norm(shapes.half, axis=1)) * shapes.on
    travel = jnp.max(jnp.abs(chain.limits - chain.reference[:, None]), axis=1)
    step = jnp.linalg.norm(chain.offset[:, :3], axis=1) + (1 - chain.hinge) * travel
    count = step.size
    way = jnp.concatenate([jnp.cumsum(step), jnp.sum(step)[None]])
    tool = jnp.linalg.norm(chain.tool[:3])
    links = jnp.array(row_links(cell))
    end = way[links] + jnp.where(links == count, tool, 0.0) + extent
    moved = links[None] >= jnp.arange(count)[:, None]
    reach = jnp.max(jnp.where(moved, end[None] - way[:count, None], 0.0), axis=1)
    return jnp.where(chain.hinge > 0, reach, 1.0)


@checks(start=configuration, end=configuration)
@jax.jit
def edge_is_free(
    cell: Workcell,
    start: Float[Array, "n"],
    end: Float[Array, "n"],
    margin: float | Array = 0.0,
    tolerance: float | Array = 1e-3,
) -> tuple[Bool[Array, ""], Float[Array, ""]]:
    """Is every configuration on a straight edge at least `margin` away from everything?

    Args:
        margin: clearance to keep [m].
        tolerance: an edge that comes this close to the margin counts as blocked: the steps would
            become too small [m].

    Returns:
        True only if it is proven, and the smallest clearance that was sampled [m].
    """
    length = jnp.sum(jnp.abs(end - start) * motion_reach(cell))

    def going(state):
        phase, least = state
        return (phase < 1.0) & (least >= margin + tolerance)

    def advance(state):
        phase, least = state
        gap = clearance(cell, start + phase * (end - start))
        reached = phase + (gap - margin) / jnp.maximum(length, 1e-9)
        # the end itself is always sampled, so that the least clearance is that of the whole edge
        onward = jnp.where((reached >= 1.0) & (phase < 1.0), 1.0, reached)
        return onward, jnp.minimum(least, gap)

    first, last = jax.vmap(clearance, (None, 0))(cell, jnp.stack([start, end]))
    phase = (first - margin) / jnp.maximum(length, 1e-9)
    phase, least = jax.lax.while_loop(going, advance, (jnp.clip(phase, 0.0, 1.0), first))
    least = jnp.minimum(least, last)
    return least >= margin + tolerance, least


@jax.jit
def _pieces_are_free(cell: Workcell, scenes: Scene, pieces: Array, margin: Array) -> Array:
    def one(scene, piece):
        inside = cell.replace(scene=scene)
        free = jax.vmap(lambda a, b: edge_is_free(inside, a, b, margin)[0])
        return jnp.all(free(piece[:-1], piece[1:]))

    return jax.vmap(one)(scenes, pieces)


def paths_are_free(
    cell: Workcell, scenes: Scene, paths: list[np.ndarray], margin: float = 0.0
) -> np.ndarray:
    """Which paths are proven to keep the margin on every edge `[path]`.

    Args:
        cell: robot and fixtures.
        scenes: one a path, stacked.
        paths: `[point, joint]` each, of any lengths; none or one point is free.
        margin: clearance to keep [m].
    """
    owners, pieces = [], []
    for owner, path in enumerate(paths):
        for first in range(0, len(path) - 1, PIECE - 1):
            piece = path[first : first + PIECE]
            pieces.append(np.concatenate([piece, piece[-1:].repeat(PIECE - len(piece), axis=0)]))
            owners.append(owner)
    free = np.ones(len(paths), bool)
    for index, count in padded_chunks(len(pieces), PIECES):
        rows = np.array([owners[i] for i in index])
        block = np.stack([pieces[i] for i in index]).astype(np.float32)
        scene = jax.tree.map(lambda a, rows=rows: a[rows], scenes)
        found = np.asarray(_pieces_are_free(cell, scene, block, np.float32(margin)))
        np.logical_and.at(free, rows[:count], found[:count])
    return free
