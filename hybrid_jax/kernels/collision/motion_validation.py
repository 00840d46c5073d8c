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

from hybrid_jax.kernels.argument_checks import checks, configuration
from hybrid_jax.kernels.batching import in_calls
from hybrid_jax.kernels.collision.clearance import clearance, near_in_scenes
from hybrid_jax.kernels.collision.rounded_boxes import local_shapes, row_links
from hybrid_jax.runtime.kept_programs import kept
from hybrid_jax.types import Scene, Workcell

PIECE = 0.1
"""Most that a point of the robot moves along one piece of a path that is to be proven [m]."""
SPLIT = 8
"""Most pieces that a piece is split in where it comes close to something."""
GROUP, GROUPS = 64, (8,)
"""Configurations that are measured together in one scene, and groups of a call: those that are not
used cost nothing."""
REACHES = (64,)
"""Size of calls that bound the motion of the robot with what it holds in a scene."""
FAR_ENOUGH = 0.05
"""Clearances beyond this are not told apart [m]."""

Measure = Callable[[np.ndarray, np.ndarray, float], np.ndarray]
"""Function that measures configurations of paths: from numbers of paths `[n]`, a configuration on
each `[n, joint]` and the largest clearance that counts [m] to clearances `[n]` [m]."""


def motion_reach(cell: Workcell) -> Float[Array, " n"]:
    """How far any point of robot or payload may move per unit of each joint.

    A point of a link is at most as far from a joint before it as the offsets between them add up
    to, plus the link's own extent and the travel of slides on the way.

    Returns:
        `[joint]` bounds [m/rad, or 1 for a slide].
    """
    chain, shapes = cell.chain, local_shapes(cell)
    extent = jnp.linalg.norm(shapes.pose[:, :3], axis=1) + shapes.radius
    extent = (extent + jnp.linalg.norm(shapes.half_extents, axis=1)) * shapes.active
    travel = jnp.max(jnp.abs(chain.limits - chain.reference[:, None]), axis=1)
    step = jnp.linalg.norm(chain.offset[:, :3], axis=1) + (1 - chain.hinge) * travel
    count = step.size
    distance_along = jnp.concatenate([jnp.cumsum(step), jnp.sum(step)[None]])
    tool = jnp.linalg.norm(chain.tool[:3])
    links = row_links(cell)
    tip_distance = distance_along[links] + jnp.where(links == count, tool, 0.0) + extent
    is_moved = links[None] >= jnp.arange(count)[:, None]
    reach = jnp.max(
        jnp.where(is_moved, tip_distance[None] - distance_along[:count, None], 0.0), axis=1
    )
    return jnp.where(chain.hinge > 0, reach, 1.0)


@checks(start=configuration, end=configuration)
@kept
def edge_is_free(
    cell: Workcell,
    start: Float[Array, " n"],
    end: Float[Array, " n"],
    margin: float | Array = 0.0,
    tolerance: float | Array = 1e-3,
) -> tuple[Bool[Array, ""], Float[Array, ""]]:
    """Is every configuration on a straight edge at least `margin` away from everything?

    Args:
        cell: robot and scene.
        start: `[joint]` one end [rad or m].
        end: `[joint]` the other [rad or m].
        margin: clearance to keep [m].
        tolerance: an edge that comes this close to the margin counts as blocked, as the steps
            would become too small [m].

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


_near = kept(near_in_scenes, hot=True)


def path_clearance(cell: Workcell, q: np.ndarray, enough: float = FAR_ENOUGH) -> np.ndarray:
    """Clearance `[point]` at configurations `[point, joint]` in the cell's scene, at most `enough`.

    All in metres; on the host.
    """
    scene = jax.tree.map(lambda a: np.asarray(a)[None], cell.scene)
    return clearances_in_scenes(cell, scene, np.zeros(len(q), int), q, enough)


def _groups(which: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows in groups of `GROUP` that share a scene; a short group repeats its last row.

    Args:
        which: `[row]` scene of each.

    Returns:
        `[group]` scene of each, `[group, GROUP]` its rows, and `[group]` how many are not repeated.
    """
    order = np.argsort(which, kind="stable")
    scenes, first, counts = np.unique(which[order], return_index=True, return_counts=True)
    sizes = -(-counts // GROUP)
    scene, number = split_counts(sizes)
    place = number[:, None] * GROUP + np.arange(GROUP)
    rows = order[first[scene][:, None] + np.minimum(place, counts[scene][:, None] - 1)]
    return scenes[scene], rows, np.minimum(counts[scene] - number * GROUP, GROUP)


def measure_here(cell: Workcell) -> Measure:
    """Function that measures paths which are all in the scene of the cell."""
    return lambda _, q, enough: path_clearance(cell, q, enough)


def measure_in_scenes(cell: Workcell, scenes: Scene) -> Measure:
    """Function that measures paths of which each has its own scene, stacked: `[path, ...]`."""
    return functools.partial(clearances_in_scenes, cell, jax.device_get(scenes))


def measure_some(measure: Measure, rows: np.ndarray) -> Measure:
    """The same function for the paths whose numbers are `rows` `[n]`, which count from 0 then."""
    return lambda path, q, enough: measure(rows[path], q, enough)


def clearances_in_scenes(
    cell: Workcell, scenes: Scene, which: np.ndarray, q: np.ndarray, enough: float = FAR_ENOUGH
) -> np.ndarray:
    """Clearance at configurations of which each has its own scene.

    Args:
        cell: robot and fixtures.
        scenes: stacked, leaves `[scene, ...]`.
        which: `[point]` scene of each configuration.
        q: `[point, joint]` configurations [rad or m].
        enough: larger clearances are not told apart [m].

    Returns:
        `[point]` clearances, at most `enough` [m].
    """
    if not len(q):
        return np.zeros(0, np.float32)
    scenes, q, limit = jax.device_get(scenes), q.astype(np.float32), np.float32(enough)
    scene, rows, sizes = _groups(which)

    def run(group, used):
        own_scenes = jax.tree.map(lambda a: a[scene[group]], scenes)
        counts = np.where(np.arange(len(group)) < used, sizes[group], 0).astype(np.int32)
        return _near(cell, own_scenes, q[rows[group]], limit, counts)

    gaps = np.empty(len(q), np.float32)
    # what repeats a row is not measured
    is_measured = np.arange(GROUP) < sizes[:, None]
    gaps[rows[is_measured]] = in_calls(run, len(rows), GROUPS)[is_measured]
    return gaps


def split_counts(counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For edges that are cut in `counts` `[edge]` pieces, the edge of each piece and its place.

    Returns:
        `[piece]` the edge that each is of, and `[piece]` its number on that edge, from 0.
    """
    edge = np.repeat(np.arange(len(counts)), counts)
    return edge, np.arange(len(edge)) - np.repeat(np.cumsum(counts) - counts, counts)


def _split(q: np.ndarray, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cut edges `[edge, 2, joint]` in `counts` `[edge]` pieces each.

    Returns:
        Pieces `[piece, 2, joint]`, the edge of each, and which of them begin inside their edge.
    """
    edge, number = split_counts(counts)
    share = np.stack([number, number + 1], axis=1)[..., None] / counts[edge][:, None, None]
    return q[edge, :1] + share * (q[edge, 1:] - q[edge, :1]), edge, number > 0


def _prove(
    measure: Measure, reach: np.ndarray, paths: list[np.ndarray], margin: float, tolerance: float
) -> np.ndarray:
    """Which polylines `[path]` are proven to keep a margin on all their edges.

    The clearances at the ends of a piece prove it where together they exceed what any point of the
    robot moves along it. Where they do not, it is split. All paths go through this together.

    Args:
        measure: clearances on them.
        reach: `[path, joint]`, see `motion_reach`.
        paths: way points `[point, joint]` of each; one alone counts as free.
        margin, tolerance: see `path_is_free`.
    """
    paths = [np.asarray(path, float) for path in paths]
    owner = np.repeat(np.arange(len(paths)), [len(path) - 1 for path in paths])
    pieces = np.concatenate([np.stack([path[:-1], path[1:]], axis=1) for path in paths])
    enough = PIECE / 2 + margin + tolerance

    def travel():
        return np.sum(np.abs(pieces[:, 1] - pieces[:, 0]) * reach[owner], axis=1)

    pieces, edge, _ = _split(pieces, np.maximum(1, np.ceil(travel() / PIECE)).astype(int))
    owner = owner[edge]
    # a piece ends where the next one of its path begins: each such configuration is measured once
    is_first = np.diff(owner, prepend=-1) > 0
    start_gaps = measure(owner[is_first], pieces[is_first, 0], enough) - margin
    gaps = np.empty((len(pieces), 2))
    gaps[:, 1] = measure(owner, pieces[:, 1], enough) - margin
    gaps[1:, 0] = gaps[:-1, 1]
    gaps[is_first, 0] = start_gaps
    free = np.ones(len(paths), bool)
    while True:
        free[owner[(gaps < tolerance).any(axis=1)]] = False
        # what both clearances cover from either end together
        distance, proven = travel(), gaps.sum(axis=1)
        undecided = free[owner] & (distance > proven)
        if not undecided.any():
            return free
        counts = np.clip(np.ceil(distance[undecided] / proven[undecided]), 2, SPLIT).astype(int)
        pieces, edge, inner = _split(pieces[undecided], counts)
        owner, gaps = owner[undecided][edge], gaps[undecided][edge]
        gaps[inner, 0] = measure(owner[inner], pieces[inner, 0], enough) - margin
        gaps[:-1, 1] = np.where(inner[1:], gaps[1:, 0], gaps[:-1, 1])


@kept
def _reach(cell: Workcell, scene: Scene) -> Array:
    return motion_reach(cell.replace(scene=scene))


@kept
def _reaches(cell: Workcell, scenes: Scene) -> Array:
    return jax.vmap(lambda scene: motion_reach(cell.replace(scene=scene)))(scenes)


def path_is_free(
    cell: Workcell, q: Float[np.ndarray, "point n"], margin: float = 0.0, tolerance: float = 1e-3
) -> bool:
    """Is a polyline proven to keep a margin on all its edges?

    Args:
        cell: in the scene of the path.
        q: `[point, joint]` its way points [rad or m]; one alone counts as free.
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
    """`path_is_free` `[path]` of several paths `[point, joint]`, each in its own scene.

    The scenes are stacked: `[path, ...]`. All paths are proven together, in few calls.
    """
    if not paths:
        return np.ones(0, bool)
    scenes = jax.device_get(scenes)
    reach_of = lambda rows, _: _reaches(cell, jax.tree.map(lambda a: a[rows], scenes))  # noqa: E731
    reach = in_calls(reach_of, len(paths), REACHES)
    return _prove(measure_in_scenes(cell, scenes), reach, paths, margin, tolerance)
