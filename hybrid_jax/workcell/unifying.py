# SPDX-License-Identifier: MIT
"""Let many cells of one robot share their compiled programs."""

import jax.numpy as jnp
import numpy as np

from hybrid_jax.errors import InputError
from hybrid_jax.types import ContactPairs, Shapes, Workcell, WorkcellSource


class SharedSource(WorkcellSource):
    """The host's side of one of many cells whose programs are the same."""

    def __init__(self, own: WorkcellSource, group: str):
        super().__init__(
            name=own.name, digest=own.digest, model=own.model, layout=own.layout, task=own.task,
            owners=own.owners, fixture_bodies=own.fixture_bodies, path=own.path, tool=own.tool,
        )  # fmt: skip
        self.group = group

    def __eq__(self, other):
        return isinstance(other, SharedSource) and self.group == other.group

    def __hash__(self):
        return hash(self.group)


def _padded(shapes: Shapes, slim: int, boxes: int) -> tuple[Shapes, np.ndarray]:
    """Shapes with empty slots, and where the given ones stand `[n]`."""
    missing = shapes.count - shapes.slim
    place = np.concatenate([np.arange(shapes.slim), slim + np.arange(missing)]).astype(int)
    total = slim + boxes

    def into(values: np.ndarray, fill) -> jnp.ndarray:
        out = np.broadcast_to(np.asarray(fill, np.float32), (total, *values.shape[1:])).copy()
        out[place] = values
        return jnp.asarray(out)

    pose, half, radius, on = map(np.asarray, (shapes.pose, shapes.half, shapes.radius, shapes.on))
    still = [0, 0, 0, 1, 0, 0, 0]
    return Shapes(into(pose, still), into(half, 0), into(radius, 0), into(on, 0), slim), place


def unify_shapes(cells: list[Workcell]) -> list[Workcell]:
    """The same cells with as many slots for fixtures each, so that one trace serves them all.

    Args:
        cells: of one robot, without movable objects.

    Raises:
        InputError: a cell has movable objects, or another robot.
    """
    robot = cells[0].robot.link, cells[0].robot.shapes.count, cells[0].pairs.cover
    for cell in cells:
        if cell.objects.count:
            raise InputError(f"the cell {cell.source.name!r} has movable objects")
        if (cell.robot.link, cell.robot.shapes.count, cell.pairs.cover) != robot:
            raise InputError(f"the cell {cell.source.name!r} has another robot than the first one")
    slim = max(cell.fixtures.slim for cell in cells)
    boxes = max(cell.fixtures.count - cell.fixtures.slim for cell in cells)
    group, found = f"{cells[0].source.digest}-{len(cells)}-{slim}-{boxes}", []
    for cell in cells:
        fixtures, place = _padded(cell.fixtures, slim, boxes)
        world = np.zeros((*cell.pairs.world.shape[:-1], slim + boxes), np.float32)
        world[..., place] = np.asarray(cell.pairs.world)
        pairs = ContactPairs(
            jnp.asarray(world), cell.pairs.own, cell.pairs.payload, cell.pairs.cover
        )
        scene = cell.scene.replace(support_on=jnp.ones(slim + boxes))
        source = SharedSource(cell.source, group)
        found.append(cell.replace(fixtures=fixtures, pairs=pairs, scene=scene, source=source))
    return found
