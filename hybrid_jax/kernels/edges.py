# SPDX-License-Identifier: MIT
"""Straight edges in joint space, checked so that nothing slips between the samples.

Along an edge no point of the robot moves faster than a bound that follows from the lengths of the
chain, so the clearance at one sample proves a stretch of the edge free (conservative advancement:
Mirtich 1996; Schwarzer, Saha and Latombe 2005 use the same bound).
"""

import functools
from collections.abc import Callable

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
CHECKED = 64, 128, 256
"""Configurations of one scene that are measured in one call, from few to many, ..."""
CHECKED_IN_SCENES = 64, 512
"""... and of several."""
FAR_ENOUGH = 0.05
"""Clearances beyond this are not told apart [m]."""

Measure = Callable[[np.ndarray, np.ndarray, float], np.ndarray]
"""Numbers of paths `[n]`, a configuration on each `[n, joint]` and a largest clearance that counts
to clearances `[n]` [m]: all paths in one scene, or each in its own."""


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
        cell: robot and scene.
        start: `[joint]` one end [rad].
        end: `[joint]` the other [rad].
        margin: clearance to keep [m].
        tolerance: an edge that comes this close to the margin counts as blocked: the steps would
            become too small [m].

    Returns:
        `[]` True only if it is proven, and `[]` the smallest clearance that was sampled [m].

    Raises:
        InputError: an end is no configuration of the arm.
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
def _batch_clearance(cell: Workcell, scene: Scene, q: Float[Array, "point n"], enough: Array):
    inside = cell.replace(scene=scene)
    return jax.vmap(lambda one: clearance_up_to(inside, one, enough))(q)


@jax.jit
def _scene_clearance(cell: Workcell, scenes: Scene, q: Float[Array, "point n"], enough: Array):
    own = lambda scene, one: clearance_up_to(cell.replace(scene=scene), one, enough)  # noqa: E731
    return jax.vmap(own)(scenes, q)


def _in_calls(measure: Callable, q: np.ndarray, sizes: tuple[int, ...]) -> np.ndarray:
    """`measure(rows, q[rows])` of all points, so many in one call: few traces for all paths."""
    out, start = [], 0
    while start < len(q):
        size = next((n for n in sizes if n >= len(q) - start), sizes[-1])
        rows = np.minimum(np.arange(start, start + size), len(q) - 1)
        out.append(np.asarray(measure(rows, q[rows].astype(np.float32)))[: len(q) - start])
        start += size
    return np.concatenate(out) if out else np.zeros(0, np.float32)


def path_clearance(cell: Workcell, q: np.ndarray, enough: float = FAR_ENOUGH) -> np.ndarray:
    """Clearance at each configuration `[point]`, at most `enough` [m]."""
    most = np.float32(enough)
    return _in_calls(lambda _, q: _batch_clearance(cell, cell.scene, q, most), q, CHECKED)


def measure_here(cell: Workcell) -> Measure:
    """For paths in the scene of the cell."""
    return lambda _, q, enough: path_clearance(cell, q, enough)


def measure_in_scenes(cell: Workcell, scenes: Scene) -> Measure:
    """For paths of which each has its scene, stacked."""
    return functools.partial(clearances_in_scenes, cell, jax.device_get(scenes))


def measure_some(measure: Measure, rows: np.ndarray) -> Measure:
    """For those of the paths whose numbers are `rows`, numbered anew."""
    return lambda path, q, enough: measure(rows[path], q, enough)


def clearances_in_scenes(
    cell: Workcell, scenes: Scene, which: np.ndarray, q: np.ndarray, enough: float = FAR_ENOUGH
) -> np.ndarray:
    """The same where each configuration has its scene.

    Args:
        cell: robot and fixtures.
        scenes: stacked.
        which: `[point]` scene of each configuration.
        q: `[point, joint]`.
        enough: larger clearances are not told apart [m].
    """
    scenes, most = jax.device_get(scenes), np.float32(enough)

    def measure(rows, q):
        own = jax.tree.map(lambda a: a[which[rows]], scenes)
        return _scene_clearance(cell, own, q, most)

    return _in_calls(measure, q, CHECKED_IN_SCENES)


def split_counts(counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of edges in `counts` pieces each, for every piece its edge and its number on it."""
    edge = np.repeat(np.arange(len(counts)), counts)
    return edge, np.arange(len(edge)) - np.repeat(np.cumsum(counts) - counts, counts)


def _split(q: np.ndarray, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Edges `[edge, 2, joint]` in `counts` pieces each.

    Returns:
        The pieces, the edge that each comes from, and which of them begin inside of it.
    """
    edge, number = split_counts(counts)
    share = np.stack([number, number + 1], axis=1)[..., None] / counts[edge][:, None, None]
    return q[edge, :1] + share * (q[edge, 1:] - q[edge, :1]), edge, number > 0


def _prove(
    measure: Measure, reach: np.ndarray, paths: list[np.ndarray], margin: float, tolerance: float
) -> np.ndarray:
    """Which polylines are proven to keep a margin on all their edges.

    The clearances at the ends of a piece prove it where together they exceed what any point of the
    robot moves along it. Where they do not, it is split. All paths go through this together.

    Args:
        measure: clearances on them.
        reach: `[path, joint]`, see `motion_reach`.
        paths: way points of each; one alone counts as free.
        margin, tolerance: see `path_is_free`.
    """
    paths = [np.asarray(path, float) for path in paths]
    owner = np.repeat(np.arange(len(paths)), [len(path) - 1 for path in paths])
    pieces = np.concatenate([np.stack([path[:-1], path[1:]], axis=1) for path in paths])
    enough = PIECE / 2 + margin + tolerance

    def moved():
        return np.sum(np.abs(pieces[:, 1] - pieces[:, 0]) * reach[owner], axis=1)

    pieces, edge, _ = _split(pieces, np.maximum(1, np.ceil(moved() / PIECE)).astype(int))
    owner = owner[edge]
    first = np.diff(owner, prepend=-1) > 0  # of its path
    starts = measure(owner[first], pieces[first, 0], enough) - margin
    gaps = np.empty((len(pieces), 2))
    gaps[:, 1] = measure(owner, pieces[:, 1], enough) - margin
    gaps[1:, 0] = gaps[:-1, 1]
    gaps[first, 0] = starts
    free = np.ones(len(paths), bool)
    while True:
        free[owner[(gaps < tolerance).any(axis=1)]] = False
        way, sure = moved(), gaps.sum(axis=1)
        open_ = free[owner] & (way > sure)
        if not open_.any():
            return free
        counts = np.clip(np.ceil(way[open_] / sure[open_]), 2, SPLIT).astype(int)
        pieces, edge, inner = _split(pieces[open_], counts)
        owner, gaps = owner[open_][edge], gaps[open_][edge]
        gaps[inner, 0] = measure(owner[inner], pieces[inner, 0], enough) - margin
        gaps[:-1, 1] = np.where(inner[1:], gaps[1:, 0], gaps[:-1, 1])


@jax.jit
def _reach(cell: Workcell, scene: Scene) -> Array:
    return motion_reach(cell.replace(scene=scene))


@jax.jit
def _reaches(cell: Workcell, scenes: Scene) -> Array:
    return jax.vmap(lambda scene: motion_reach(cell.replace(scene=scene)))(scenes)


def path_is_free(
    cell: Workcell, q: Float[np.ndarray, "point n"], margin: float = 0.0, tolerance: float = 1e-3
) -> bool:
    """Is a polyline proven to keep a margin on all its edges?

    Args:
        cell: in the scene of the path.
        q: its way points; one alone counts as free.
        margin: clearance to keep [m].
        tolerance: a path that comes this close to the margin counts as blocked [m].
    """
    reach = np.asarray(_reach(cell, cell.scene), float)[None]
    return bool(_prove(measure_here(cell), reach, [q], margin, tolerance)[0])


def paths_are_free(
    cell: Workcell,
    scenes: Scene,
    paths: list[np.ndarray],
    margin: float = 0.0,
    tolerance: float = 1e-3,
) -> np.ndarray:
    """`path_is_free` of several paths, each in its own scene, stacked: `[path]`."""
    if not paths:
        return np.ones(0, bool)
    scenes = jax.device_get(scenes)
    own = lambda rows, _: _reaches(cell, jax.tree.map(lambda a: a[rows], scenes))  # noqa: E731
    starts = np.stack([path[0] for path in paths])
    reach = _in_calls(own, starts, CHECKED_IN_SCENES)
    return _prove(measure_in_scenes(cell, scenes), reach, paths, margin, tolerance)
