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

from hybrid_jax.kernels.collision import clearance, clearance_up_to
from hybrid_jax.kernels.inputs import checks, configuration
from hybrid_jax.kernels.primitives import local_shapes, row_links
from hybrid_jax.types import Scene, Workcell

PIECE = 0.1
"""A path is proven in pieces along which no point of the robot moves further than this [m], ..."""
SPLIT = 8
"""... each of which is split in so many at most where it comes close to something."""
CHECKED = 64, 256
"""Configurations that `path_clearance` takes in one call: few traces for all paths."""
FAR_ENOUGH = 0.05
"""Clearances beyond this are not told apart [m]."""


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
def _reach(cell: Workcell, scene: Scene) -> Array:
    return motion_reach(cell.replace(scene=scene))


@jax.jit
def _batch_clearance(cell: Workcell, scene: Scene, q: Float[Array, "point n"], enough: Array):
    inside = cell.replace(scene=scene)
    return jax.vmap(lambda one: clearance_up_to(inside, one, enough))(q)


def path_clearance(cell: Workcell, q: np.ndarray, enough: float = FAR_ENOUGH) -> np.ndarray:
    """Clearance at each configuration `[point]`, at most `enough` [m]."""
    out, start = [np.zeros(0, np.float32)], 0
    while start < len(q):
        size = next((n for n in CHECKED if n >= len(q) - start), CHECKED[-1])
        part = q[start : start + size].astype(np.float32)
        padded = np.concatenate([part, part[-1:].repeat(size - len(part), 0)])
        found = _batch_clearance(cell, cell.scene, padded, np.float32(enough))
        out.append(np.asarray(found)[: len(part)])
        start += size
    return np.concatenate(out)


def _split(q: np.ndarray, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Edges `[edge, 2, joint]` in `counts` pieces each.

    Returns:
        The pieces, the edge that each comes from, and which of them begin inside of it.
    """
    edge = np.repeat(np.arange(len(q)), counts)
    number = np.arange(len(edge)) - np.repeat(np.cumsum(counts) - counts, counts)
    share = np.stack([number, number + 1], axis=1)[..., None] / counts[edge][:, None, None]
    return q[edge, :1] + share * (q[edge, 1:] - q[edge, :1]), edge, number > 0


def path_is_free(
    cell: Workcell, q: Float[np.ndarray, "point n"], margin: float = 0.0, tolerance: float = 1e-3
) -> bool:
    """Is a polyline proven to keep a margin on all its edges?

    The clearances at the ends of a piece prove it where together they exceed what any point of the
    robot moves along it. Where they do not, it is split.

    Args:
        cell: in the scene of the path.
        q: its way points; one alone counts as free.
        margin: clearance to keep [m].
        tolerance: a path that comes this close to the margin counts as blocked [m].
    """
    if len(q) < 2:
        return True
    reach, enough = np.asarray(_reach(cell, cell.scene), float), PIECE / 2 + margin + tolerance
    pieces = np.stack([q[:-1], q[1:]], axis=1).astype(float)
    moved = lambda pieces: np.abs(pieces[:, 1] - pieces[:, 0]) @ reach  # noqa: E731
    pieces = _split(pieces, np.maximum(1, np.ceil(moved(pieces) / PIECE)).astype(int))[0]
    ends = path_clearance(cell, np.concatenate([pieces[:, 0], pieces[-1:, 1]]), enough) - margin
    gaps = np.stack([ends[:-1], ends[1:]], axis=1)
    while (gaps >= tolerance).all():
        way, sure = moved(pieces), gaps.sum(axis=1)
        open_ = way > sure
        if not open_.any():
            return True
        counts = np.clip(np.ceil(way / sure)[open_], 2, SPLIT).astype(int)
        pieces, edge, inner = _split(pieces[open_], counts)
        gaps = gaps[open_][edge]
        gaps[inner, 0] = path_clearance(cell, pieces[inner, 0], enough) - margin
        gaps[:-1, 1] = np.where(inner[1:], gaps[1:, 0], gaps[:-1, 1])
    return False


def paths_are_free(
    cell: Workcell, scenes: Scene, paths: list[np.ndarray], margin: float = 0.0
) -> np.ndarray:
    """`path_is_free` of several paths, each in its own scene, stacked: `[path]`."""
    free = np.ones(len(paths), bool)
    for i, path in enumerate(paths):
        scene = jax.tree.map(lambda a, i=i: np.asarray(a)[i], scenes)
        free[i] = path_is_free(cell.replace(scene=scene), path, margin)
    return free
