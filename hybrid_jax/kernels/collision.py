# SPDX-License-Identifier: MIT
"""Signed clearance of the robot and its payload to everything else, and to themselves.

`clearance` and `clearances` are functions of one configuration; vmapped, they run as one kernel
over the whole batch (`kernels.batching`). They are exact: see `kernels.nearest`.
"""

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float, Int

from hybrid_jax.kernels import components as co
from hybrid_jax.kernels import distance, nearest
from hybrid_jax.kernels.batching import batch_size, batched, in_chunks, redo
from hybrid_jax.kernels.distance import FAR
from hybrid_jax.kernels.inputs import checks, configuration
from hybrid_jax.kernels.kinematics import link_frames
from hybrid_jax.kernels.nearest import Nearest, Pairing
from hybrid_jax.kernels.primitives import (
    Blocks,
    joined_order,
    local_shapes,
    robot_rows,
    row_links,
    world_blocks,
    world_shapes,
)
from hybrid_jax.types import Shapes, Workcell

_ROWS, _PAIRS = 5, 6
"""Measured at first: the best so many pairs of the best so many rows. More of either makes fewer
configurations uncertain, and costs more for all."""
_TABLE = 64
"""Configurations at a time of which every pair is measured: the uncertain, and small batches."""


def _groups(cell: Workcell, own: Blocks, parts: str) -> list:
    """Obstacles and which of them count for which row."""
    pairs, scene, fixtures = cell.pairs, cell.scene, cell.fixtures
    if pairs.world.shape[0] != 1:
        raise ValueError("a batch of cells must share its contact pairs: vmap over scenes only")
    payload = pairs.payload[0]
    order = jnp.array(
        joined_order((fixtures.slim, scene.objects.slim), (fixtures.count, scene.objects.count)),
        int,
    )
    objects = jnp.ones((scene.support_on.shape[0], scene.objects.count))
    support = jnp.concatenate([scene.support_on, objects], axis=1)[:, order].T
    spared = jnp.ones((own.radius.shape[0], 1))
    groups = {
        "world": (world_blocks(cell), Pairing(pairs.world[0], payload, support)),
        "own": (own, Pairing(pairs.own[0], payload, spared)),
    }
    wanted = ("world", "own") if parts == "all" else (parts,)
    return [groups[name] for name in wanted if groups[name][0].radius.shape[0]]


def _kernel(cell: Workcell, q: Array, *, parts: str, every: bool) -> Nearest:
    """One pass over a batch: every pair, or the most promising ones by their bounds."""
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
    if not every:
        bounds = jnp.full(rows.centre.shape[1:], FAR)
        for obstacles, pairing in groups:
            bounds = nearest.row_bounds(rows, obstacles, pairing, bounds)
    for some, whole in ((slice(0, slim), None), (slice(slim, rows.radius.shape[0]), boxes)):
        if some.start == some.stop:
            continue
        if every:
            found = nearest.tabulate(rows, whole, groups, some)
        else:
            found = _if_needed(rows, whole, groups, some, bounds, answer)
        answer = answer.merge(found)
    return answer


def _if_needed(rows, whole, groups, some: slice, bounds, known: Nearest) -> Nearest:
    """Search unless every bound is beyond what is known."""
    least = jnp.min(bounds[some], axis=0)
    idle = known._replace(distance=jnp.full_like(least, FAR), rest=least)
    return jax.lax.cond(
        jnp.any(least < known.distance),
        lambda: nearest.search(rows, whole, groups, some, bounds, _ROWS, _PAIRS),
        lambda: idle,
    )


def _closest(cell: Workcell, q: Array, *, parts: str) -> Nearest:
    """Exact nearest pairs of a batch; leaves `[1 or b, ...]`."""
    q = jnp.broadcast_to(q, (batch_size((cell, q)), q.shape[1]))
    table = functools.partial(_kernel, parts=parts, every=True)
    if q.shape[0] <= _TABLE:
        return table(cell, q)
    found = in_chunks(functools.partial(_kernel, parts=parts, every=False), cell, q)
    return redo(table, (cell, q), found, ~found.certain, _TABLE)


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
    world, cover = world_shapes(cell), jnp.array(cell.pairs.cover + (0,))
    moving = _block(shapes, place[:, links[row]], rotation[:, :, links[row]], row)
    other = cover[jnp.clip(column - world.count, 0, cover.size - 1)]
    own = _block(shapes, place[:, links[other]], rotation[:, :, links[other]], other)
    if world.count == 0:
        return distance.swept_blocks(moving, own)
    fixed = _block(world, jnp.zeros(3), jnp.eye(3), jnp.clip(column, 0, world.count - 1))
    inside = column < world.count
    return distance.swept_blocks(
        moving, jax.tree.map(lambda a, b: jnp.where(inside, a, b), fixed, own)
    )


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _smallest(parts: str, cell: Workcell, q: Array) -> Array:
    return _CLOSEST[parts](cell, q).distance


@_smallest.defjvp
def _slope(parts, primals, tangents):
    """The distance changes as that of the nearest pair does."""
    found = _CLOSEST[parts](*primals)
    moving = functools.partial(pair_distance, row=found.row, column=found.column)
    if parts == "own":
        world = world_shapes(primals[0]).count
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

    Negative where they overlap: the depth of the deepest overlap. `FAR` where nothing can touch.
    """
    return _smallest("all", cell, q)


@checks(q=configuration)
@jax.jit
def closest(cell: Workcell, q: Float[Array, "n"]) -> tuple[Float[Array, ""], Bool[Array, ""]]:
    """Clearance [m], and whether what is nearest is the robot itself."""
    found = _CLOSEST["all"](cell, q)
    return found.distance, found.column >= world_shapes(cell).count


@functools.partial(jax.jit, static_argnames=("samples", "check"))
def edge_clearance(
    cell: Workcell,
    start: Float[Array, "n"],
    end: Float[Array, "n"],
    samples: int = 4,
    check: Callable = closest,
) -> Float[Array, ""]:
    """Smallest clearance at `samples` evenly spaced points after `start` up to `end` [m].

    `check` is the collision backend: `closest`, or its counterpart on MJX.
    """
    points = points_between(start, end, samples)
    return jnp.min(jax.vmap(lambda q: check(cell, q)[0])(points))


def points_between(
    start: Float[Array, "n"], end: Float[Array, "n"], samples: int
) -> Float[Array, "sample n"]:
    """Evenly spaced points of a straight edge after `start` up to `end`."""
    phase = jnp.arange(1, samples + 1)[:, None] / samples
    return start + phase * (end - start)
