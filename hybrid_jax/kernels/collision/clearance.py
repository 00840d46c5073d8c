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

from hybrid_jax.errors import InputError
from hybrid_jax.kernels import vec3
from hybrid_jax.kernels.argument_checks import checks, configuration
from hybrid_jax.kernels.batching import batch_size, batched, by_backend, in_chunks, redo
from hybrid_jax.kernels.collision import distance, narrow_phase
from hybrid_jax.kernels.collision.broad_phase import Pairing, row_bounds
from hybrid_jax.kernels.collision.distance import FAR
from hybrid_jax.kernels.collision.narrow_phase import Nearest
from hybrid_jax.kernels.collision.primitive_kinds import KINDS, PAIRS, spans
from hybrid_jax.kernels.collision.rounded_boxes import (
    RoundedBoxes,
    local_shapes,
    robot_rows,
    row_counts,
    row_links,
    split_blocks,
    world_boxes,
    world_count,
)
from hybrid_jax.kernels.kinematics import link_frames
from hybrid_jax.runtime.kept_programs import kept
from hybrid_jax.types import Shapes, Workcell

_MEASURED = (5, 6)
"""Rows with the least bounds, and pairs of these rows, that are measured at first. More of either
makes fewer configurations uncertain, and costs more for all."""
_MEASURED_NEAR = (5, 5)
"""Rows and pairs where only what is near counts: bounds make most configurations certain."""
_TABLE = 64
"""Configurations in a pass that measures every pair: of small batches, and the uncertain ones."""
_REDO = 8
"""Uncertain configurations in a pass where only what is near counts: they are few."""
_ACCELERATOR_TABLE = 4096
"""Both passes on an accelerator: an H100 spends nine tenths of its time on passes of 64."""


def _groups(cell: Workcell, own: RoundedBoxes, against: str) -> list:
    """Obstacles and which of them count for which row: fixtures, objects, the robot itself.

    Fixtures stand apart from objects because they are the same for a whole batch. `own` are the
    robot's primitives `ContactPairs.cover`; `against` is `all`, `world` or `own`.
    """
    pairs, scene, fixtures = cell.pairs, cell.scene, cell.fixtures
    if pairs.world.shape[0] != 1:
        raise InputError("a batch of cells must share its contact pairs: vmap over scenes only")
    payload, count = pairs.payload[0], fixtures.count
    groups = []
    if against != "own":
        object_support = jnp.ones((scene.objects.count, 1))
        fixed, movable = pairs.world[0, :, :count], pairs.world[0, :, count:]
        groups = [
            (world_boxes(fixtures), Pairing(fixed, payload, scene.support_on.T)),
            (world_boxes(scene.objects), Pairing(movable, payload, object_support)),
        ]
    if against != "world":
        own_support = jnp.ones((own.radius.shape[0], 1))
        groups.append((own, Pairing(pairs.own[0], payload, own_support)))
    return [(blocks, pairing) for blocks, pairing in groups if blocks.radius.shape[0]]


def _kernel(cell: Workcell, q: Array, *, against: str, measured: tuple[int, int] | None) -> Nearest:
    """One pass over a batch: every pair, or the most promising ones by their bounds.

    Leaves of `cell` and `q` are `[1 or b, ...]`; `measured` is as `_MEASURED`, None for every pair.
    """
    rows, blocks = robot_rows(cell, q)
    cover_blocks, boxes_by_kind = split_blocks(cell, blocks)
    batch = q.shape[0]
    zero = jnp.zeros(batch, jnp.int32)
    nearest = Nearest(jnp.full(batch, FAR), zero, zero, jnp.full(batch, FAR))
    groups = _groups(cell, cover_blocks, against)
    if not groups:
        return nearest
    if local_shapes(cell).all_spheres:
        return narrow_phase.around(rows, cover_blocks, groups)
    if measured:
        bounds = jnp.full(rows.centre.shape[1:], FAR)
        for obstacles, pairing in groups:
            bounds = row_bounds(rows, obstacles, pairing, bounds)
    for kind, row_boxes, span in zip(KINDS, boxes_by_kind, spans(row_counts(cell)), strict=True):
        if span.start == span.stop:
            continue
        measure = PAIRS[kind.name, "rounded box"]
        if measured:
            candidate = _if_needed(
                measure, rows, row_boxes, groups, span, bounds, nearest, measured
            )
        else:
            candidate = narrow_phase.tabulate(measure, rows, row_boxes, groups, span)
        nearest = nearest.merge(candidate)
    return nearest


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
    nearest = in_chunks(functools.partial(_kernel, against=against, measured=_MEASURED), cell, q)
    return redo(measure_all, (cell, q), nearest, ~nearest.certain, table_size)


def _near(cell: Workcell, q: Array, enough: Array) -> Array:
    """Clearances `[b]` [m] of a batch, `enough` where they are larger; leaves `[1 or b, ...]`."""
    q = jnp.broadcast_to(q, (batch_size((cell, q, enough)), q.shape[1]))
    measure_all = functools.partial(_kernel, against="all", measured=None)
    if q.shape[0] <= by_backend(_TABLE, _ACCELERATOR_TABLE):
        return jnp.minimum(measure_all(cell, q).distance, enough)
    measure_promising = functools.partial(_kernel, against="all", measured=_MEASURED_NEAR)
    nearest = in_chunks(measure_promising, cell, q)
    # an unmeasured pair matters only where it may be nearer than what was measured and `enough`
    pending = nearest.rest < jnp.minimum(nearest.distance, enough)
    redo_size = by_backend(_REDO, _ACCELERATOR_TABLE)
    return jnp.minimum(redo(measure_all, (cell, q), nearest, pending, redo_size).distance, enough)


_NEAR = batched(_near)
_CLOSEST = {
    against: batched(functools.partial(_closest, against=against))
    for against in ("all", "world", "own")
}


def _block(shapes: Shapes, position, rotation, index) -> RoundedBoxes:
    """Primitive `index` in the world, by components, from the pose of the frame that carries it."""
    pose, half = shapes.pose[index], shapes.half_extents[index]
    local = vec3.quat_matrix(pose[3:])
    axes = [vec3.turn(rotation, [local[i][k] for i in range(3)]) for k in range(3)]
    turned = [[axes[k][i] for k in range(3)] for i in range(3)]
    radius = jnp.where(shapes.active[index] > 0, shapes.radius[index], -FAR)
    return RoundedBoxes(
        vec3.add(position, vec3.turn(rotation, pose[:3])), turned, half, half, radius
    )


def pair_distance(
    cell: Workcell, q: Float[Array, " n"], row: Int[Array, ""], column: Int[Array, ""]
) -> Float[Array, ""]:
    """Signed distance of one pair, differentiable in `cell` and `q`.

    Args:
        cell: robot and scene.
        q: `[joint]` configuration [rad or m].
        row: `[]` number of the robot's or payload's primitive.
        column: `[]` number of the obstacle: fixtures, then objects, then the robot's own `cover`.

    Returns:
        `[]` [m].
    """
    chain = jax.tree.map(lambda a: a[None], cell.chain)
    positions, rotations = (a[..., 0] for a in link_frames(chain, q[None]))
    shapes, links = local_shapes(cell), row_links(cell)
    cover = jnp.append(cell.pairs.cover, 0)

    def on_robot(index):
        return _block(shapes, positions[:, links[index]], rotations[:, :, links[index]], index)

    obstacle = on_robot(cover[jnp.clip(column - world_count(cell), 0, cover.size - 1)])
    # indices are traced: each group is looked up, and the one that has the column is kept
    column_offset = 0
    for world_group in (cell.fixtures, cell.scene.objects):
        if world_group.count:
            selected = (column >= column_offset) & (column < column_offset + world_group.count)
            local_index = jnp.clip(column - column_offset, 0, world_group.count - 1)
            block = _block(world_group, jnp.zeros(3), jnp.eye(3), local_index)
            obstacle = jax.tree.map(
                lambda a, b, selected=selected: jnp.where(selected, a, b), block, obstacle
            )
        column_offset += world_group.count
    return distance.rounded_box_rounded_box(on_robot(row), obstacle)


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
        A cylinder or mesh is several boxes: where it overlaps, the sign is right, and its depth is
        that of the deepest box, which is at most its own. `FAR` where nothing can touch.

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


def points_between(
    start: Float[Array, " n"], end: Float[Array, " n"], samples: int
) -> Float[Array, "sample n"]:
    """Evenly spaced points `[sample, joint]` of a straight edge, without `start`, with `end`."""
    phase = jnp.arange(1, samples + 1)[:, None] / samples
    return start + phase * (end - start)
