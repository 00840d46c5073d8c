# SPDX-License-Identifier: MIT
"""Which geoms and primitives of a cell must not touch: one rule for kernels and engines."""

import jax.numpy as jnp
import mujoco
import numpy as np

from hybrid_jax.kernels.primitives import joined_order
from hybrid_jax.types import ContactPairs
from hybrid_jax.workcell.geometry import PIERCEABLE, Primitive, geom_label, pierces
from hybrid_jax.workcell.layout import Layout, geom_links, home_qpos


def contact_filter(model: mujoco.MjModel) -> np.ndarray:
    """`[geom, geom]` which geoms MuJoCo lets touch.

    Bit masks, same or adjacent bodies, excluded body pairs; and the pairs of `<contact>`, which
    go before all of these.
    """
    kind, mask = model.geom_contype, model.geom_conaffinity
    bits = (kind[:, None] & mask) | (mask[:, None] & kind)
    body = model.geom_bodyid
    weld = model.body_weldid[body]
    parent = model.body_weldid[model.body_parentid[weld]]
    adjacent = (weld[:, None] == parent) | (parent[:, None] == weld)
    moving = (weld[:, None] > 0) & (weld > 0)
    low, high = np.minimum(body[:, None], body), np.maximum(body[:, None], body)
    excluded = np.isin((low << 16) + high, model.exclude_signature)
    allowed = (bits > 0) & (weld[:, None] != weld) & ~(adjacent & moving) & ~excluded
    allowed[model.pair_geom1, model.pair_geom2] = True
    allowed[model.pair_geom2, model.pair_geom1] = True
    return allowed


def forbidden_contacts(model: mujoco.MjModel, layout: Layout) -> np.ndarray:
    """`[geom, geom]` which geoms a motion of the arm must keep apart.

    One of them is the arm's, and the arm moves them against each other: what hangs on one link, as
    the fingers of a gripper do, is the gripper's business.
    """
    links = geom_links(model, layout)
    moved = (links[:, None] != links) & ((links[:, None] >= 0) | (links >= 0))
    return contact_filter(model) & moved


def overlaps(
    model: mujoco.MjModel, data: mujoco.MjData, forbidden: np.ndarray, within: float = 0.0
) -> dict[tuple[int, int], float]:
    """Pairs of geoms that must be kept apart and overlap at `data.qpos`, and how deep [m].

    Args:
        model, data: the cell in C MuJoCo.
        forbidden: from `forbidden_contacts`.
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
        if contact.dist < within and forbidden[a, b]
    }


def pierced(
    model: mujoco.MjModel, data: mujoco.MjData, forbidden: np.ndarray
) -> list[tuple[int, int]]:
    """Capsules whose axis runs through a box that they must not touch.

    C MuJoCo reports no contact of such a pair; the kernels do.
    """
    capsules, boxes = (np.flatnonzero(model.geom_type == kind) for kind in PIERCEABLE)
    return [
        (int(capsules[a]), int(boxes[b]))
        for a, b in np.argwhere(forbidden[np.ix_(capsules, boxes)])
        if pierces(model, data, int(capsules[a]), int(boxes[b]))
    ]


def home_overlaps(model: mujoco.MjModel, layout: Layout) -> list[str]:
    """What the robot overlaps with in its home configuration, in sentences."""
    data, forbidden = mujoco.MjData(model), forbidden_contacts(model, layout)
    data.qpos[:] = home_qpos(model)
    found = {
        pair: f"overlap by {1e3 * depth:.1f} mm"
        for pair, depth in overlaps(model, data, forbidden).items()
    }
    for a, b in pierced(model, data, forbidden):
        low, high = sorted((a, b))
        found.setdefault((low, high), "overlap: one runs right through the other")
    return [
        f"the home configuration collides: {geom_label(model, a)} and {geom_label(model, b)} "
        f"{how}; change the keyframe 'home'"
        for (a, b), how in found.items()
    ]


def _cover(table: np.ndarray, boxes: list[bool]) -> list[int]:
    """Rows that touch every pair of a symmetric table, greedily; boxes first among equals."""
    left, found = table.copy(), []
    while left.any():
        best = max(range(len(left)), key=lambda i: (left[i].sum(), boxes[i]))
        found.append(best)
        left[best] = left[:, best] = 0
    return found


def _own_table(rows: list[Primitive | None], links: np.ndarray, last: int, forbidden) -> np.ndarray:
    """`[row, row]` 1 where two primitives of robot and payload (None) may touch."""
    table = np.zeros((len(rows), len(rows)), np.float32)
    for i, a in enumerate(rows):
        for j, b in enumerate(rows):
            if a and b:
                table[i, j] = forbidden[a.geom, b.geom]
            elif a or b:
                # the payload may touch the link that carries the gripper, and nothing before it
                table[i, j] = links[(a or b).geom] < last
    return table


def contact_pairs(robot, slots, fixtures, objects, links, last_link, forbidden) -> ContactPairs:
    """Tables over rows and columns in the kernels' order (`kernels.primitives.join`).

    Args:
        robot, fixtures, objects: primitives, capsules first.
        slots: capsules and boxes that a payload may have.
        links: link of each geom.
        last_link: the link that carries the gripper.
        forbidden: from `forbidden_contacts`.
    """

    def slim(ones):
        return sum(p.slim for p in ones)

    order = joined_order((slim(robot), slots[0]), (len(robot), sum(slots)))
    rows = [robot[i] if i < len(robot) else None for i in order]
    boxes = [i - len(robot) >= slots[0] if p is None else not p.slim
             for i, p in zip(order, rows, strict=True)]  # fmt: skip
    columns = fixtures + objects
    world = [[p is None or forbidden[p.geom, c.geom] for c in columns] for p in rows]
    table = _own_table(rows, links, last_link, forbidden)
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
