# SPDX-License-Identifier: MIT
"""Pairs of bodies that a robot's own construction lets touch."""

import mujoco

from hybrid_jax.workcell.always_touching import touching_pairs
from hybrid_jax.workcell.geometry import body_label
from hybrid_jax.workcell.layout import Layout, geom_links

OFTEN = 0.95
"""Share of random configurations from which on a pair counts as touching always, as in MoveIt."""


def exclude_pairs(spec: mujoco.MjSpec, pairs) -> list[str]:
    """Exclude pairs of links by their names, as an SRDF lists them; those that exist, once."""
    bodies = {body.name for body in spec.bodies if body.name}
    known = {frozenset((e.bodyname1, e.bodyname2)) for e in spec.excludes}
    added = []
    for a, b in pairs:
        if a in bodies and b in bodies and a != b and frozenset((a, b)) not in known:
            spec.add_exclude(bodyname1=a, bodyname2=b)
            known.add(frozenset((a, b)))
            added.append((a, b))
    return [f"{a!r} and {b!r} may touch: the SRDF says so" for a, b in added]


def exclude_touching(spec: mujoco.MjSpec, model: mujoco.MjModel, layout: Layout) -> list[str]:
    """Exclude links that touch, or nearly, in almost every configuration.

    Only links of the arm and what carries it count: a fixture that the arm always touches is in
    its way.

    Returns:
        A sentence for each pair.
    """
    links, notes, known = geom_links(model, layout), [], set()
    carrier = int(model.body_rootid[model.jnt_bodyid[layout.joints[0]]])
    for found in touching_pairs(model, layout):
        bodies = [int(model.geom_bodyid[g]) for g in found.geoms]
        is_robot = all(
            links[g] >= 0 or model.body_rootid[b] == carrier or b == 0
            for g, b in zip(found.geoms, bodies, strict=True)
        )
        names = [body_label(model, b) for b in bodies]
        if found.share < OFTEN or not is_robot or 0 in bodies or frozenset(names) in known:
            continue
        known.add(frozenset(names))
        spec.add_exclude(bodyname1=names[0], bodyname2=names[1])
        notes.append(
            f"{names[0]!r} and {names[1]!r} may touch: they do in {100 * found.share:.0f} % of all "
            "configurations"
        )
    return notes
