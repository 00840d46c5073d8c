# SPDX-License-Identifier: MIT
"""Pad the shapes of many cells of one robot, so that they share their compiled programs."""

import jax.numpy as jnp
import numpy as np

from hybrid_jax.errors import InputError
from hybrid_jax.kernels.collision.primitive_kinds import spans
from hybrid_jax.types import PRIMITIVE_AXIS, ContactPairs, Shapes, Workcell, WorkcellSource


class SharedSource(WorkcellSource):
    """Host-side half of one of many cells that share their programs.

    JAX takes it for a part of the program. Sources of one group are equal, whatever they hold.
    """

    def __init__(self, own: WorkcellSource, group: str):
        super().__init__(
            name=own.name,
            digest=own.digest,
            model=own.model,
            layout=own.layout,
            task=own.task,
            owners=own.owners,
            fixture_bodies=own.fixture_bodies,
            path=own.path,
            tool=own.tool,
        )
        self.group = group

    def __eq__(self, other):
        return isinstance(other, SharedSource) and self.group == other.group

    def __hash__(self):
        return hash(self.group)


def _padded(shapes: Shapes, counts: tuple[int, ...]) -> tuple[Shapes, np.ndarray]:
    """Shapes with empty slots added, and the slot of each given primitive `[n]`."""
    by_kind = zip(spans(shapes.counts), spans(counts), strict=True)
    slots = np.concatenate([new.start + np.arange(old.stop - old.start) for old, new in by_kind])
    total = sum(counts)

    def into(values: np.ndarray, fill) -> jnp.ndarray:
        padded = np.broadcast_to(np.asarray(fill, np.float32), (total, *values.shape[1:])).copy()
        padded[slots] = values
        return jnp.asarray(padded)

    # empty slots are not rotated
    fills = {"pose": [0, 0, 0, 1, 0, 0, 0]}
    arrays = {
        name: into(np.asarray(getattr(shapes, name)), fills.get(name, 0)) for name in PRIMITIVE_AXIS
    }
    return Shapes(**arrays, counts=counts), slots


def unify_shapes(cells: list[Workcell]) -> list[Workcell]:
    """The same cells with equal numbers of slots for fixtures, so that one trace serves them all.

    Args:
        cells: of one robot, without movable objects.

    Returns:
        Cells whose fixtures have `[slot, ...]` slots: of each kind the most that any cell needs.

    Raises:
        InputError: a cell has movable objects, or another robot.
    """
    robot = cells[0].robot.link, cells[0].robot.shapes.count, cells[0].pairs.cover
    for cell in cells:
        if cell.objects.count:
            raise InputError(f"the cell {cell.source.name!r} has movable objects")
        if (cell.robot.link, cell.robot.shapes.count, cell.pairs.cover) != robot:
            raise InputError(f"the cell {cell.source.name!r} has another robot than the first one")
    counts = tuple(map(max, zip(*(cell.fixtures.counts for cell in cells), strict=True)))
    group, unified = f"{cells[0].source.digest}-{len(cells)}-{'-'.join(map(str, counts))}", []
    for cell in cells:
        fixtures, slots = _padded(cell.fixtures, counts)
        world = np.zeros((*cell.pairs.world.shape[:-1], sum(counts)), np.float32)
        world[..., slots] = np.asarray(cell.pairs.world)
        pairs = ContactPairs(
            jnp.asarray(world), cell.pairs.own, cell.pairs.payload, cell.pairs.cover
        )
        scene = cell.scene.replace(support_on=jnp.ones(sum(counts)))
        source = SharedSource(cell.source, group)
        unified.append(cell.replace(fixtures=fixtures, pairs=pairs, scene=scene, source=source))
    return unified
