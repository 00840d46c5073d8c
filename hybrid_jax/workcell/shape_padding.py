# SPDX-License-Identifier: MIT
"""Fill up the lists of a cell's primitives to a few sizes, so that cells share their programs.

A program depends on how many primitives there are, not on what they are. Cells whose lists are
filled up to the same sizes form a class: `kept` programs of one cell serve them all. Empty slots
are far from everything, but they are computed: so the sizes lie close together, closest for the
robot, whose primitives meet all others.
"""

import copy

import numpy as np

from hybrid_jax.kernels.collision.primitive_kinds import rows_as_boxes, spans
from hybrid_jax.types import PRIMITIVE_AXIS, ContactPairs, Shapes, Workcell
from hybrid_jax.workcell.source import WorkcellSource

ROBOT_DIGITS, OBSTACLE_DIGITS = 4, 3
"""Significant binary digits of a list's size: the smallest such number that suffices. With 3
digits the sizes are 1 to 8, 10, 12, 14, 16, 20, 24, 28, 32, 40 and so on."""


def padded_size(count: int, digits: int) -> int:
    """Smallest number of at least `count` with so many significant binary digits."""
    step = 1 << max(0, count.bit_length() - digits)
    return -(-count // step) * step


def _sizes(counts: tuple[int, ...], digits: int) -> tuple[int, ...]:
    return tuple(padded_size(count, digits) for count in counts)


def _slots(counts: tuple[int, ...], sizes: tuple[int, ...]) -> np.ndarray:
    """Slot `[n]` of each primitive of a list, once its kinds are filled up to `sizes`."""
    by_kind = zip(spans(counts), spans(sizes), strict=True)
    return np.concatenate([new.start + np.arange(old.stop - old.start) for old, new in by_kind])


def _filled(shapes: Shapes, sizes: tuple[int, ...]) -> Shapes:
    """Shapes `[n, ...]` with empty slots."""
    slots, total = _slots(shapes.counts, sizes), sum(sizes)
    arrays = {name: _spread(getattr(shapes, name), (total,), (slots,)) for name in PRIMITIVE_AXIS}
    empty = ~np.isin(np.arange(total), slots)
    arrays["pose"][empty, 3] = 1.0  # not rotated
    boxes = np.isin(np.arange(total), rows_as_boxes(sizes))
    arrays["half_extents"][empty & boxes] = 1e-3  # without extent it had no axes to measure along
    return Shapes(**arrays, counts=sizes, all_spheres=shapes.all_spheres)


def _spread(values, shape: tuple[int, ...], places: tuple[np.ndarray, ...], fill=0) -> np.ndarray:
    """An array of a larger shape with `values` at some places of its first axes, else `fill`."""
    values = np.asarray(values)
    spread = np.full((*shape, *values.shape[len(shape) :]), fill, values.dtype)
    spread[np.ix_(*places)] = values
    return spread


def _joined(robot: tuple, robot_sizes: tuple, payload: tuple, payload_sizes: tuple) -> np.ndarray:
    """Row `[n]` of each row of `rounded_boxes.join`, once both of its lists are filled up."""
    rows, start = [], 0
    for a, size_a, b, size_b in zip(robot, robot_sizes, payload, payload_sizes, strict=True):
        rows += [*range(start, start + a), *range(start + size_a, start + size_a + b)]
        start += size_a + size_b
    return np.array(rows, int)


def _filled_pairs(
    pairs: ContactPairs, rows: np.ndarray, row_count: int, columns: np.ndarray, column_count: int
) -> ContactPairs:
    """Tables of pairs for filled lists; `rows` `[row]` and `columns` are the slots of the old."""
    cover = np.asarray(pairs.cover)
    cover_count = padded_size(len(cover), ROBOT_DIGITS)
    places = np.arange(len(cover))
    return ContactPairs(
        world=_spread(pairs.world, (row_count, column_count), (rows, columns)),
        own=_spread(pairs.own, (row_count, cover_count), (rows, places)),
        payload=_spread(pairs.payload, (row_count,), (rows,)),
        cover=_spread(rows[cover], (cover_count,), (places,)).astype(np.int32),
    )


def class_of(cell: Workcell) -> str:
    """Name of the class of a cell: cells with the same name run the same programs."""
    robot, scene = cell.robot.shapes, cell.scene
    lists = {
        "robot": robot,
        "payload": scene.payload,
        "fixtures": cell.fixtures,
        "objects": cell.objects,
    }
    sizes = [f"{name} {'+'.join(map(str, shapes.counts))}" for name, shapes in lists.items()]
    balls = ", balls" if robot.all_spheres else ""
    hulls, faces, _ = cell.hulls.faces.shape
    if hulls:
        sizes.append(f"hulls {hulls}, slices {len(cell.hulls.candidates)}, faces {faces}")
    return ", ".join(
        [f"{cell.home.shape[-1]} joints", *sizes, f"self {cell.pairs.cover.shape[-1]}{balls}"]
    )


def fill_up(cell: Workcell) -> Workcell:
    """The same cell with empty slots, of the class that it belongs to.

    Args:
        cell: arrays on the host, without empty slots except for those of the payload.

    Returns:
        The cell with lists of primitives `[slot, ...]`; it plans and measures the same.
    """
    robot, payload = cell.robot.shapes, cell.scene.payload
    robot_sizes = _sizes(robot.counts, ROBOT_DIGITS)
    payload_sizes = _sizes(payload.counts, OBSTACLE_DIGITS)
    fixture_sizes = _sizes(cell.fixtures.counts, OBSTACLE_DIGITS)
    object_sizes = _sizes(cell.objects.counts, OBSTACLE_DIGITS)
    rows = _joined(robot.counts, robot_sizes, payload.counts, payload_sizes)
    fixtures, objects = sum(fixture_sizes), sum(object_sizes)
    fixture_slots = _slots(cell.fixtures.counts, fixture_sizes)
    object_slots = _slots(cell.objects.counts, object_sizes)
    robot_slots = _slots(robot.counts, robot_sizes)
    columns = np.concatenate([fixture_slots, fixtures + object_slots])
    row_count = sum(robot_sizes) + sum(payload_sizes)
    spread_robot = lambda a: _spread(a, (sum(robot_sizes),), (robot_slots,))  # noqa: E731
    return cell.replace(
        robot=cell.robot.replace(
            shapes=_filled(robot, robot_sizes),
            stroke=spread_robot(cell.robot.stroke),
            link=spread_robot(cell.robot.link),
        ),
        fixtures=_filled(cell.fixtures, fixture_sizes),
        objects=_filled(cell.objects, object_sizes),
        owners=_spread(cell.owners, (objects,), (object_slots,), -1),
        pairs=_filled_pairs(cell.pairs, rows, row_count, columns, fixtures + objects),
        scene=cell.scene.replace(
            objects=_filled(cell.scene.objects, object_sizes),
            payload=_filled(payload, payload_sizes),
            support_on=_spread(cell.scene.support_on, (fixtures,), (fixture_slots,), 1),
        ),
        source=_filled_source(cell.source, fixture_slots, fixtures, object_slots, objects),
    )


def _filled_source(
    source: WorkcellSource, fixture_slots, fixtures: int, object_slots, objects: int
) -> WorkcellSource:
    """The host side with names and owners for the empty slots too."""
    owners, bodies = [-1] * objects, [""] * fixtures
    for slot, owner in zip(object_slots, source.owners, strict=True):
        owners[slot] = owner
    for slot, body in zip(fixture_slots, source.fixture_bodies, strict=True):
        bodies[slot] = body
    filled = copy.copy(source)
    filled.owners, filled.fixture_bodies = tuple(owners), tuple(bodies)
    return filled
