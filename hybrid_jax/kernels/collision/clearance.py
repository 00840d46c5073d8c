# SPDX-License-Identifier: MIT
"""Signed clearance of the robot and its payload to everything else, and to themselves.

`clearance` and `clearances` are functions of one configuration; vmapped, they run as one kernel
over the whole batch (`kernels.batching`). They are exact: a batch is first measured in part, by
the bounds of the broad phase, and its uncertain configurations then in full.
"""

import functools

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float, Int

from hybrid_jax.kernels.argument_checks import checks, configuration
from hybrid_jax.kernels.batching import (
    batch_size,
    batched,
    by_backend,
    first_items,
    in_chunks,
    redo,
)
from hybrid_jax.kernels.collision import all_pairs, narrow_phase
from hybrid_jax.kernels.collision.broad_phase import groups_of, row_bounds
from hybrid_jax.kernels.collision.distance import FAR
from hybrid_jax.kernels.collision.hull_pairs import CONFIGURATIONS, nearest_pairs
from hybrid_jax.kernels.collision.nearest_pair import Nearest, no_pair
from hybrid_jax.kernels.collision.pair_distance import pair_distance
from hybrid_jax.kernels.collision.rounded_boxes import (
    has_polytopes,
    local_shapes,
    robot_rows,
    split_blocks,
    world_count,
)
from hybrid_jax.runtime.kept_programs import kept
from hybrid_jax.types import Scene, Workcell

_MEASURED = (5, 6)
"""Rows with the least bounds, and pairs of these rows, that are measured at first. More of either
makes fewer configurations uncertain, and costs more for all."""
_MEASURED_NEAR = (5, 5)
"""Rows and pairs where only what is near counts: bounds make most configurations certain."""
_TABLE = 64
"""Configurations in a pass that leaves none uncertain: it measures every pair, or refines."""
_REDO = 8
"""Uncertain configurations in a pass where only what is near counts: they are few."""
_ACCELERATOR_TABLE = 4096
"""Both passes on an accelerator: an H100 spends nine tenths of its time on passes of 64."""


def _kernel(cell: Workcell, q: Array, *, against: str, measured: tuple[int, int] | None) -> Nearest:
    """One pass over a batch: every pair, or the most promising ones by their bounds.

    Leaves of `cell` and `q` are `[1 or b, ...]`; `measured` is as `_MEASURED`, None for every pair.
    """
    if has_polytopes(cell) and not measured:
        # a table of all pairs costs too much: hulls are measured in steps
        return _refined(cell, q, jnp.full(1, FAR), jnp.ones(1, bool), against=against)
    rows, blocks = robot_rows(cell, q)
    cover_blocks, runs = split_blocks(cell, blocks)
    nearest = no_pair(q.shape[0])
    groups = groups_of(cell, cover_blocks, against)
    if not groups:
        return nearest
    if _all_balls(cell):
        return all_pairs.around(rows, cover_blocks, groups)
    if measured:
        bounds = jnp.full(rows.centre.shape[1:], FAR)
        for obstacles, pairing in groups:
            bounds = row_bounds(rows, obstacles, pairing, bounds)
    for span, row_boxes, measure in runs:
        if measured:
            candidate = _if_needed(
                measure, rows, row_boxes, groups, span, bounds, nearest, measured
            )
        else:
            candidate = all_pairs.tabulate(measure, rows, row_boxes, groups, span)
        nearest = nearest.merge(candidate)
    return nearest


def _all_balls(cell: Workcell) -> bool:
    """Is the robot made of balls, and nothing around it a hull?"""
    return local_shapes(cell).all_spheres and not has_polytopes(cell)


def _if_needed(
    measure, rows, row_boxes, groups, span: slice, bounds, known: Nearest, measured
) -> Nearest:
    """Search the rows `span`, unless no bound of any configuration is below what is known."""
    least_bound = jnp.min(bounds[span], axis=0)
    idle = known._replace(distance=jnp.full_like(least_bound, FAR), rest=least_bound)
    return jax.lax.cond(
        jnp.any(least_bound < known.distance),
        lambda: narrow_phase.search(measure, rows, row_boxes, groups, span, bounds, *measured),
        lambda: idle,
    )


def _closest(cell: Workcell, q: Array, *, against: str) -> Nearest:
    """Exact nearest pairs `[b]` of a batch; leaves of `cell` and `q` are `[1 or b, ...]`."""
    q = jnp.broadcast_to(q, (batch_size((cell, q)), q.shape[1]))
    measure_all = functools.partial(_kernel, against=against, measured=None)
    table_size = by_backend(_TABLE, _ACCELERATOR_TABLE)
    if q.shape[0] <= table_size:
        return measure_all(cell, q)
    if has_polytopes(cell):
        return _closest_hulls(cell, q, jnp.full(1, FAR), against=against)
    nearest = in_chunks(functools.partial(_kernel, against=against, measured=_MEASURED), cell, q)
    return redo(measure_all, (cell, q), nearest, ~nearest.certain, table_size)


def _closest_hulls(cell: Workcell, q: Array, enough: Array, *, against: str) -> Nearest:
    """Nearest pairs `[b]` of a cell with hulls, exact where they are nearer than `enough`."""
    measure = functools.partial(nearest_pairs, against=against)
    nearest = in_chunks(measure, cell, q, enough, cpu_chunk=CONFIGURATIONS)

    def measure_rest(cell, q, enough, known):
        limit = jnp.minimum(known.distance, enough)
        return known.merge(_refined(cell, q, limit, jnp.ones(1, bool), against=against))

    pending = nearest.rest < jnp.minimum(nearest.distance, enough)
    table_size = by_backend(_TABLE, _ACCELERATOR_TABLE)
    return redo(measure_rest, (cell, q, enough, nearest), nearest, pending, table_size)


def _near(cell: Workcell, q: Array, enough: Array) -> Array:
    """Clearances `[b]` [m] of a batch, `enough` where they are larger; leaves `[1 or b, ...]`."""
    q = jnp.broadcast_to(q, (batch_size((cell, q, enough)), q.shape[1]))
    is_shared = cell.scene.objects.pose.shape[0] == 1
    if q.shape[0] <= by_backend(_TABLE, _ACCELERATOR_TABLE) or by_backend(not is_shared, False):
        return in_chunks(_near_refined, cell, q, enough, jnp.ones(1, bool), cpu_chunk=_TABLE)
    if has_polytopes(cell):
        return jnp.minimum(_closest_hulls(cell, q, enough, against="all").distance, enough)
    measure_promising = functools.partial(_kernel, against="all", measured=_MEASURED_NEAR)
    measure_all = functools.partial(_kernel, against="all", measured=None)
    nearest = in_chunks(measure_promising, cell, q)
    # an unmeasured pair matters only where it may be nearer than what was measured and `enough`
    pending = nearest.rest < jnp.minimum(nearest.distance, enough)
    redo_size = by_backend(_REDO, _ACCELERATOR_TABLE)
    return jnp.minimum(redo(measure_all, (cell, q), nearest, pending, redo_size).distance, enough)


def _near_refined(cell: Workcell, q: Array, enough: Array, matters: Array) -> Array:
    """`_near` in one pass of as many steps as it takes; exact where it `matters` `[1 or b]`.

    For few configurations, and where each has its own scene. A large batch in one scene takes twice
    as long: it waits for the worst of its configurations.
    """
    if _all_balls(cell):
        return jnp.minimum(_kernel(cell, q, against="all", measured=None).distance, enough)
    return jnp.minimum(_refined(cell, q, enough, matters, against="all").distance, enough)


def _refined(cell: Workcell, q: Array, enough: Array, matters: Array, *, against: str) -> Nearest:
    """Nearest pairs in one pass, exact where they are nearer than `enough` and it `matters`."""
    rows, blocks = robot_rows(cell, q)
    cover_blocks, runs = split_blocks(cell, blocks)
    nearest = no_pair(q.shape[0])
    groups = groups_of(cell, cover_blocks, against)
    if not groups:
        return nearest
    bounds = jnp.full(rows.centre.shape[1:], FAR)
    for obstacles, pairing in groups:
        bounds = row_bounds(rows, obstacles, pairing, bounds)
    bounds = jnp.where(matters, bounds, FAR)
    for span, row_boxes, measure in runs:
        nearest = narrow_phase.refine(
            measure, rows, row_boxes, groups, span, bounds, nearest, enough
        )
    return nearest


def near_in_scenes(
    cell: Workcell,
    scenes: Scene,
    q: Float[Array, "scene b n"],
    enough: Array,
    used: Int[Array, " scene"],
) -> Float[Array, "scene b"]:
    """`clearance_up_to` of configurations in several scenes, as many in each.

    Args:
        cell: robot and fixtures.
        scenes: leaves `[scene, ...]`.
        q: `[scene, b, joint]` configurations [rad or m].
        enough: `[]` clearance beyond which nothing is told apart [m].
        used: `[scene]` how many configurations count in each, from the first. What follows costs
            little if whole scenes are unused from some on; these results mean nothing.
    """
    shared, places = jax.tree.map(lambda a: a[None], cell), jnp.arange(q.shape[1])

    def measure(number):
        # within a scene all obstacles are shared, which takes less than a scene for each row
        scene_cell = shared.replace(scene=jax.tree.map(lambda a: a[number][None], scenes))
        return _near_refined(scene_cell, q[number], enough[None], places < used[number])

    numbers = jnp.arange(len(used))
    if jax.default_backend() == "cpu":
        return first_items(measure, numbers, jnp.sum(used > 0))
    return jax.vmap(measure)(numbers)


_NEAR = batched(_near)
_CLOSEST = {
    against: batched(functools.partial(_closest, against=against))
    for against in ("all", "world", "own")
}


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _smallest(against: str, cell: Workcell, q: Array) -> Array:
    return _CLOSEST[against](cell, q).distance


@_smallest.defjvp
def _slope(against, primals, tangents):
    """Derivative of the smallest distance: that of the distance of the nearest pair."""
    nearest = _CLOSEST[against](*primals)
    distance_of_pair = functools.partial(pair_distance, row=nearest.row, column=nearest.column)
    if against == "own":
        column_offset = world_count(primals[0])
        distance_of_pair = functools.partial(
            pair_distance, row=nearest.row, column=nearest.column + column_offset
        )
    _, slope = jax.jvp(distance_of_pair, primals, tangents)
    return nearest.distance, jnp.where(nearest.distance < FAR / 2, slope, 0.0)


@checks(q=configuration)
@kept
def clearances(cell: Workcell, q: Float[Array, " n"]) -> Float[Array, "2"]:
    """Smallest signed distances to the world and of the robot to itself; see `clearance`.

    Args:
        cell: robot and scene.
        q: `[joint]` configuration [rad or m].

    Returns:
        `[2]` robot to fixtures and objects, robot to itself [m]; the payload counts as robot.

    Raises:
        InputError: `q` is no configuration of the arm.
    """
    return jnp.stack([_smallest("world", cell, q), _smallest("own", cell, q)])


@checks(q=configuration)
@kept
def clearance(cell: Workcell, q: Float[Array, " n"]) -> Float[Array, ""]:
    """Smallest signed distance of the robot and its payload to anything else or itself [m].

    Args:
        cell: robot and scene.
        q: `[joint]` configuration [rad or m].

    Returns:
        `[]` [m]; negative where they overlap: the depth of the deepest overlap of two primitives.
        A cylinder is several boxes: where it overlaps, the sign is right, and its depth is that of
        the deepest box, which is at most its own. Of hulls the depth is at least the true one.
        `FAR` where nothing can touch.

    Raises:
        InputError: `q` is no configuration of the arm.
    """
    return _smallest("all", cell, q)


@checks(q=configuration)
@kept
def closest(cell: Workcell, q: Float[Array, " n"]) -> tuple[Float[Array, ""], Bool[Array, ""]]:
    """Clearance `[]` [m] of a configuration `[joint]`, and whether the robot itself is nearest."""
    nearest = _CLOSEST["all"](cell, q)
    return nearest.distance, nearest.column >= world_count(cell)


@checks(q=configuration)
@kept
def clearance_up_to(
    cell: Workcell, q: Float[Array, " n"], enough: float | Array
) -> Float[Array, ""]:
    """The smaller of `clearance` and `enough`, `[]` [m].

    Exact, and cheaper in batches: what is certainly farther than enough is not measured again.

    Args:
        cell: robot and scene.
        q: `[joint]` configuration [rad or m].
        enough: `[]` clearance beyond which nothing is told apart [m].
    """
    return _NEAR(cell, q, jnp.asarray(enough, q.dtype))
