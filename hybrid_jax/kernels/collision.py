# SPDX-License-Identifier: MIT
"""Signed clearance of the robot and its payload to everything else, and to themselves.

`clearance` and `clearances` are functions of one configuration; vmapped, they run as one kernel
over the whole batch (`kernels.batching`). They are exact: see `kernels.nearest`.
"""

import functools

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float, Int

from hybrid_jax.errors import InputError
from hybrid_jax.kernels import components as co
from hybrid_jax.kernels import distance, nearest
from hybrid_jax.kernels.batching import batch_size, batched, by_backend, in_chunks, redo
from hybrid_jax.kernels.distance import FAR
from hybrid_jax.kernels.inputs import checks, configuration
from hybrid_jax.kernels.kinematics import link_frames
from hybrid_jax.kernels.nearest import Nearest, Pairing
from hybrid_jax.kernels.primitives import (
    Blocks,
    local_shapes,
    robot_rows,
    row_links,
    world_blocks,
    world_count,
)
from hybrid_jax.types import Shapes, Workcell

_MEASURED = (5, 6)
"""Measured at first: the best so many pairs of the best so many rows. More of either makes fewer
configurations uncertain, and costs more for all."""
_MEASURED_NEAR = (5, 5)
"""The same where only what is near counts: most configurations are certain by their bounds."""
_TABLE = 64
"""Configurations at a time of which every pair is measured: the uncertain, and small batches."""
_REDO = 8
"""The same for the uncertain ones where only what is near counts: they are few."""
_ACCELERATOR_TABLE = 4096
"""Both on an accelerator: an H100 spends nine tenths of its time on passes of 64."""


def _groups(cell: Workcell, own: Blocks, parts: str) -> list:
    """Obstacles and which of them count for which row: fixtures, objects, the robot itself.

    Fixtures stand apart from objects because they are the same for a whole batch.
    """
    pairs, scene, fixtures = cell.pairs, cell.scene, cell.fixtures
    if pairs.world.shape[0] != 1:
        raise InputError("a batch of cells must share its contact pairs: vmap over scenes only")
    payload, count = pairs.payload[0], fixtures.count
    found = []
    if parts != "own":
        objects = jnp.ones((scene.objects.count, 1))
        fixed, movable = pairs.world[0, :, :count], pairs.world[0, :, count:]
        found = [
            (world_blocks(fixtures), Pairing(fixed, payload, scene.support_on.T)),
            (world_blocks(scene.objects), Pairing(movable, payload, objects)),
        ]
    if parts != "world":
        spared = jnp.ones((own.radius.shape[0], 1))
        found.append((own, Pairing(pairs.own[0], payload, spared)))
    return [(blocks, pairing) for blocks, pairing in found if blocks.radius.shape[0]]


def _kernel(cell: Workcell, q: Array, *, parts: str, measured: tuple[int, int] | None) -> Nearest:
    """One pass over a batch: every pair, or the most promising `measured` ones by their bounds."""
    rows, blocks = robot_rows(cell, q)
    slim = cell.robot.shapes.slim + cell.scene.payload.slim
    cover = len(cell.pairs.cover)
    own = Blocks(*(a[..., :cover, :] for a in blocks))
    boxes = Blocks(*(a[..., cover:, :] for a in blocks))
    batch = q.shape[0]
    zero = jnp.zeros(batch, jnp.int32)
    answer = Nearest(jnp.full(batch, FAR), zero, zero, jnp.full(batch, FAR))
    groups = _groups(cell, own, parts)
    if not groups:
        return answer
    if local_shapes(cell).round:
        return nearest.around(rows, own, groups)
    if measured:
        bounds = jnp.full(rows.centre.shape[1:], FAR)
        for obstacles, pairing in groups:
            bounds = nearest.row_bounds(rows, obstacles, pairing, bounds)
    for some, whole in ((slice(0, slim), None), (slice(slim, rows.radius.shape[0]), boxes)):
        if some.start == some.stop:
            continue
        if measured:
            found = _if_needed(rows, whole, groups, some, bounds, answer, measured)
        else:
            found = nearest.tabulate(rows, whole, groups, some)
        answer = answer.merge(found)
    return answer


def _if_needed(rows, whole, groups, some: slice, bounds, known: Nearest, measured) -> Nearest:
    """Search unless every bound is beyond what is known."""
    least = jnp.min(bounds[some], axis=0)
    idle = known._replace(distance=jnp.full_like(least, FAR), rest=least)
    return jax.lax.cond(
        jnp.any(least < known.distance),
        lambda: nearest.search(rows, whole, groups, some, bounds, *measured),
        lambda: idle,
    )


def _closest(cell: Workcell, q: Array, *, parts: str) -> Nearest:
    """Exact nearest pairs of a batch; leaves `[1 or b, ...]`."""
    q = jnp.broadcast_to(q, (batch_size((cell, q)), q.shape[1]))
    table = functools.partial(_kernel, parts=parts, measured=None)
    few = by_backend(_TABLE, _ACCELERATOR_TABLE)
    if q.shape[0] <= few:
        return table(cell, q)
    found = in_chunks(functools.partial(_kernel, parts=parts, measured=_MEASURED), cell, q)
    return redo(table, (cell, q), found, ~found.certain, few)


def _near(cell: Workcell, q: Array, enough: Array) -> Array:
    """Clearances of a batch, `enough` where they are larger."""
    q = jnp.broadcast_to(q, (batch_size((cell, q, enough)), q.shape[1]))
    table = functools.partial(_kernel, parts="all", measured=None)
    if q.shape[0] <= by_backend(_TABLE, _ACCELERATOR_TABLE):
        return jnp.minimum(table(cell, q).distance, enough)
    some = functools.partial(_kernel, parts="all", measured=_MEASURED_NEAR)
    found = in_chunks(some, cell, q)
    pending = found.rest < jnp.minimum(found.distance, enough)
    few = by_backend(_REDO, _ACCELERATOR_TABLE)
    return jnp.minimum(redo(table, (cell, q), found, pending, few).distance, enough)


_NEAR = batched(_near)
_CLOSEST = {
    parts: batched(functools.partial(_closest, parts=parts)) for parts in ("all", "world", "own")
}


def _block(shapes: Shapes, place, rotation, index) -> Blocks:
    """One primitive of a list, by components, its frame given in the world."""
    pose, half = shapes.pose[index], shapes.half[index]
    local = co.quat_matrix(pose[3:])
    axes = [co.turn(rotation, [local[i][k] for i in range(3)]) for k in range(3)]
    turned = [[axes[k][i] for k in range(3)] for i in range(3)]
    radius = jnp.where(shapes.on[index] > 0, shapes.radius[index], -FAR)
    return Blocks(co.add(place, co.turn(rotation, pose[:3])), turned, half, half, radius)


def pair_distance(
    cell: Workcell, q: Float[Array, "n"], row: Int[Array, ""], column: Int[Array, ""]
) -> Float[Array, ""]:
    """Signed distance of one pair, named as in `Nearest`; differentiable."""
    chain = jax.tree.map(lambda a: a[None], cell.chain)
    place, rotation = (a[..., 0] for a in link_frames(chain, q[None]))
    shapes, links = local_shapes(cell), jnp.array(row_links(cell))
    cover = jnp.array(cell.pairs.cover + (0,))

    def on_robot(index):
        return _block(shapes, place[:, links[index]], rotation[:, :, links[index]], index)

    found = on_robot(cover[jnp.clip(column - world_count(cell), 0, cover.size - 1)])
    first = 0
    for fixed in (cell.fixtures, cell.scene.objects):
        if fixed.count:
            here = (column >= first) & (column < first + fixed.count)
            at = jnp.clip(column - first, 0, fixed.count - 1)
            block = _block(fixed, jnp.zeros(3), jnp.eye(3), at)
            found = jax.tree.map(lambda a, b, here=here: jnp.where(here, a, b), block, found)
        first += fixed.count
    return distance.swept_blocks(on_robot(row), found)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _smallest(parts: str, cell: Workcell, q: Array) -> Array:
    return _CLOSEST[parts](cell, q).distance


@_smallest.defjvp
def _slope(parts, primals, tangents):
    """The distance changes as that of the nearest pair does."""
    found = _CLOSEST[parts](*primals)
    moving = functools.partial(pair_distance, row=found.row, column=found.column)
    if parts == "own":
        world = world_count(primals[0])
        moving = functools.partial(pair_distance, row=found.row, column=found.column + world)
    _, slope = jax.jvp(moving, primals, tangents)
    return found.distance, jnp.where(found.distance < FAR / 2, slope, 0.0)


@checks(q=configuration)
@jax.jit
def clearances(cell: Workcell, q: Float[Array, "n"]) -> Float[Array, "2"]:
    """Smallest signed distance robot-world and robot-robot [m]; the payload counts as robot."""
    return jnp.stack([_smallest("world", cell, q), _smallest("own", cell, q)])


@checks(q=configuration)
@jax.jit
def clearance(cell: Workcell, q: Float[Array, "n"]) -> Float[Array, ""]:
    """Smallest signed distance of the robot and its payload to anything else or itself [m].

    Args:
        cell: robot and scene.
        q: `[joint]` configuration [rad].

    Returns:
        `[]` [m]; negative where they overlap: the depth of the deepest overlap of two primitives.
        A cylinder or mesh is several boxes: where it overlaps, the sign is right, and its depth is
        that of the deepest box, which is at most its own. `FAR` where nothing can touch.

    Raises:
        InputError: `q` is no configuration of the arm.
    """
    return _smallest("all", cell, q)


@checks(q=configuration)
@jax.jit
def closest(cell: Workcell, q: Float[Array, "n"]) -> tuple[Float[Array, ""], Bool[Array, ""]]:
    """Clearance [m], and whether what is nearest is the robot itself."""
    found = _CLOSEST["all"](cell, q)
    return found.distance, found.column >= world_count(cell)


@checks(q=configuration)
@jax.jit
def clearance_up_to(
    cell: Workcell, q: Float[Array, "n"], enough: float | Array
) -> Float[Array, ""]:
    """The smaller of `clearance` and `enough` [m].

    Exact, and cheaper in batches: what is certainly farther than enough is not measured again.
    """
    return _NEAR(cell, q, jnp.asarray(enough, q.dtype))


def points_between(
    start: Float[Array, "n"], end: Float[Array, "n"], samples: int
) -> Float[Array, "sample n"]:
    """Evenly spaced points of a straight edge after `start` up to `end`."""
    phase = jnp.arange(1, samples + 1)[:, None] / samples
    return start + phase * (end - start)
