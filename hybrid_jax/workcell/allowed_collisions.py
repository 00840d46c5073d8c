# SPDX-License-Identifier: MIT
"""Which geoms and primitives of a cell must not touch: one rule for kernels and engines."""

import mujoco
import numpy as np

from hybrid_jax.kernels.collision.primitive_kinds import joined_order, rows_as_boxes
from hybrid_jax.types import ContactPairs
from hybrid_jax.workcell.geometry import PIERCEABLE, Primitive, counts_of, geom_label, pierces
from hybrid_jax.workcell.layout import Layout, geom_links, home_qpos


def contact_filter(model: mujoco.MjModel) -> np.ndarray:
    """Pairs of geoms that MuJoCo tests for contact.

    Its filters are bit masks, bodies that are the same or adjacent, and excluded pairs of bodies.
    The pairs of `<contact>` are tested whatever the filters say.

    Returns:
        `[geom, geom]` symmetric, True where a pair is tested.
    """
    kind, mask = model.geom_contype, model.geom_conaffinity
    bits = (kind[:, None] & mask) | (mask[:, None] & kind)
    body = model.geom_bodyid
    weld = model.body_weldid[body]
    parent = model.body_weldid[model.body_parentid[weld]]
    # a body's welded parent is filtered only where both move: contacts with the world stay
    adjacent = (weld[:, None] == parent) | (parent[:, None] == weld)
    moving = (weld[:, None] > 0) & (weld > 0)
    low, high = np.minimum(body[:, None], body), np.maximum(body[:, None], body)
    # MuJoCo's signature of an excluded pair has the lower body number in its upper 16 bits
    excluded = np.isin((low << 16) + high, model.exclude_signature)
    allowed = (bits > 0) & (weld[:, None] != weld) & ~(adjacent & moving) & ~excluded
    allowed[model.pair_geom1, model.pair_geom2] = True
    allowed[model.pair_geom2, model.pair_geom1] = True
    return allowed


def forbidden_contacts(model: mujoco.MjModel, layout: Layout) -> np.ndarray:
    """Pairs of geoms that a motion of the arm must keep apart.

    The arm carries at least one of the two, and moves them against each other. Geoms on the same
    link, such as the fingers of a gripper, are left to the gripper.

    Returns:
        `[geom, geom]` symmetric, True where a pair must be kept apart.
    """
    links = geom_links(model, layout)
    relative_motion = (links[:, None] != links) & ((links[:, None] >= 0) | (links >= 0))
    return contact_filter(model) & relative_motion


def overlaps(
    model: mujoco.MjModel, data: mujoco.MjData, forbidden: np.ndarray, within: float = 0.0
) -> dict[tuple[int, int], float]:
    """Pairs of geoms that must be kept apart and overlap at `data.qpos`, and how deep [m].

    Args:
        model, data: the cell in C MuJoCo.
        forbidden: `[geom, geom]` from `forbidden_contacts`.
        within: pairs that are less than this apart count too [m], if the margins of the model
            are large enough to report them. Their depth is negative.

    Returns:
        Depth [m] by pair of geoms, the lower number first.
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

    Args:
        model, data: the cell in C MuJoCo.
        forbidden: `[geom, geom]` from `forbidden_contacts`.

    Returns:
        Geoms (capsule, box) of each pair.
    """
    capsules, boxes = (np.flatnonzero(model.geom_type == kind) for kind in PIERCEABLE)
    return [
        (int(capsules[a]), int(boxes[b]))
        for a, b in np.argwhere(forbidden[np.ix_(capsules, boxes)])
        if pierces(model, data, int(capsules[a]), int(boxes[b]))
    ]


def home_overlaps(model: mujoco.MjModel, layout: Layout) -> list[str]:
    """Overlaps of the robot in its home configuration, one sentence each."""
    data, forbidden = mujoco.MjData(model), forbidden_contacts(model, layout)
    data.qpos[:] = home_qpos(model)
    problems = {
        pair: f"overlap by {1e3 * depth:.1f} mm"
        for pair, depth in overlaps(model, data, forbidden).items()
    }
    for a, b in pierced(model, data, forbidden):
        low, high = sorted((a, b))
        problems.setdefault((low, high), "overlap: one runs right through the other")
    return [
        f"the home configuration collides: {geom_label(model, a)} and {geom_label(model, b)} "
        f"{problem}; change the keyframe 'home'"
        for (a, b), problem in problems.items()
    ]


def _cover(table: np.ndarray, boxes: list[bool]) -> list[int]:
    """Rows that together contain every pair of a symmetric table `[row, row]`, chosen greedily.

    `boxes[row]` tells the boxes, which go first among rows with as many pairs.
    """
    uncovered, cover = table.copy(), []
    while uncovered.any():
        row = max(range(len(uncovered)), key=lambda i: (uncovered[i].sum(), boxes[i]))
        cover.append(row)
        uncovered[row] = uncovered[:, row] = 0
    return cover


def _own_table(rows: list[Primitive | None], links: np.ndarray, last: int, forbidden) -> np.ndarray:
    """`[row, row]` 1 where a pair of primitives counts; None in `rows` is a slot of the payload."""
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
    """Tables of pairs in the order of the kernels (`kernels.collision.rounded_boxes.join`).

    Args:
        robot, fixtures, objects: primitives, kind by kind.
        slots: primitives of each kind that a payload may have.
        links: `[geom]` link of each geom, from `geom_links`.
        last_link: the link that carries the gripper.
        forbidden: `[geom, geom]` from `forbidden_contacts`.

    Returns:
        Tables `[row, column]` and `[row, cover]`, see `ContactPairs`.
    """

    counts = counts_of(robot)
    rows = [robot[i] if i < len(robot) else None for i in joined_order(counts, slots)]
    as_boxes = set(rows_as_boxes([a + b for a, b in zip(counts, slots, strict=True)]))
    boxes = [i in as_boxes for i in range(len(rows))]
    columns = fixtures + objects
    world = [[p is None or forbidden[p.geom, c.geom] for c in columns] for p in rows]
    table = _own_table(rows, links, last_link, forbidden)
    cover = _cover(table, boxes)
    self_pairs = table[:, cover]
    for k in range(len(cover)):
        # a pair of two rows of the cover counts once, in the column of the first
        self_pairs[cover[:k], k] = 0
    return ContactPairs(
        world=np.array(world, np.float32).reshape(len(rows), len(columns)),
        own=self_pairs,
        payload=np.array([p is None for p in rows], np.float32),
        cover=np.array(cover, np.int32),
    )
