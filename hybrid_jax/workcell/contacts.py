# SPDX-License-Identifier: MIT
"""Which primitives of a cell may touch which, by MuJoCo's own filters."""

import jax.numpy as jnp
import mujoco
import numpy as np

from hybrid_jax.kernels.primitives import joined_order
from hybrid_jax.types import ContactPairs
from hybrid_jax.workcell.geometry import Primitive, geom_label
from hybrid_jax.workcell.layout import Layout, home_qpos, moved_geoms


def may_collide(model: mujoco.MjModel, a: int, b: int) -> bool:
    """MuJoCo's own filter: bit masks, same or adjacent bodies, excluded body pairs."""
    bits = (model.geom_contype[a] & model.geom_conaffinity[b]) | (
        model.geom_contype[b] & model.geom_conaffinity[a]
    )
    body_a, body_b = int(model.geom_bodyid[a]), int(model.geom_bodyid[b])
    weld_a, weld_b = int(model.body_weldid[body_a]), int(model.body_weldid[body_b])
    if not bits or weld_a == weld_b:
        return False
    parent_a = int(model.body_weldid[model.body_parentid[weld_a]])
    parent_b = int(model.body_weldid[model.body_parentid[weld_b]])
    if weld_a and weld_b and (weld_a == parent_b or weld_b == parent_a):
        return False
    low, high = sorted((body_a, body_b))
    return (low << 16) + high not in set(int(s) for s in model.exclude_signature)


def overlaps(
    model: mujoco.MjModel, data: mujoco.MjData, robot: np.ndarray, within: float = 0.0
) -> dict[tuple[int, int], float]:
    """Pairs of geoms, one of them the robot's, that overlap at `data.qpos`, and how deep [m].

    Args:
        model, data: the cell in C MuJoCo.
        robot: `[geom]` True for the robot's.
        within: pairs count that are less than this apart, if the model's margins report them; how
            deep they overlap is negative then [m].
    """
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_collision(model, data)
    return {
        (int(a), int(b)): -float(contact.dist)
        for contact in data.contact[: data.ncon]
        for a, b in [sorted(contact.geom)]
        if contact.dist < within and (robot[a] or robot[b]) and may_collide(model, a, b)
    }


def home_overlaps(model: mujoco.MjModel, layout: Layout) -> list[str]:
    """What the robot overlaps with in its home configuration, in sentences."""
    data = mujoco.MjData(model)
    data.qpos[:] = home_qpos(model)
    return [
        f"the home configuration collides: {geom_label(model, a)} and {geom_label(model, b)} "
        f"overlap by {1e3 * depth:.1f} mm; change the keyframe 'home'"
        for (a, b), depth in overlaps(model, data, moved_geoms(model, layout)).items()
    ]


def _cover(table: np.ndarray, boxes: list[bool]) -> list[int]:
    """Rows that touch every pair of a symmetric table, greedily; boxes first among equals."""
    left, found = table.copy(), []
    while left.any():
        best = max(range(len(left)), key=lambda i: (left[i].sum(), boxes[i]))
        found.append(best)
        left[best] = left[:, best] = 0
    return found


def _own_table(model, rows: list[Primitive | None], links: dict[int, int], last: int) -> np.ndarray:
    """`[row, row]` 1 where two primitives of robot and payload (None) may touch."""
    table = np.zeros((len(rows), len(rows)), np.float32)
    for i, a in enumerate(rows):
        for j, b in enumerate(rows):
            if a and b:
                table[i, j] = may_collide(model, a.geom, b.geom)
            elif a or b:
                # the payload may touch the link that carries the gripper, and nothing before it
                table[i, j] = links[(a or b).geom] < last
    return table


def contact_pairs(model, robot, slots, fixtures, objects, links, last_link) -> ContactPairs:
    """Tables over rows and columns in the kernels' order (`kernels.primitives.join`).

    Args:
        model: whose filters apply.
        robot, fixtures, objects: primitives, capsules first.
        slots: capsules and boxes that a payload may have.
        links: link of each robot geom.
        last_link: the link that carries the gripper.
    """

    def slim(ones):
        return sum(p.slim for p in ones)

    order = joined_order((slim(robot), slots[0]), (len(robot), sum(slots)))
    rows = [robot[i] if i < len(robot) else None for i in order]
    boxes = [i - len(robot) >= slots[0] if p is None else not p.slim
             for i, p in zip(order, rows, strict=True)]  # fmt: skip
    columns = fixtures + objects
    world = [[p is None or may_collide(model, p.geom, c.geom) for c in columns] for p in rows]
    table = _own_table(model, rows, links, last_link)
    cover = _cover(table, boxes)
    own = table[:, cover]
    for k in range(len(cover)):
        own[cover[:k], k] = 0  # that pair stands in the other's column
    return ContactPairs(
        world=jnp.asarray(np.array(world, np.float32).reshape(len(rows), len(columns))),
        own=jnp.asarray(own),
        payload=jnp.asarray([float(p is None) for p in rows], jnp.float32),
        cover=tuple(cover),
    )
