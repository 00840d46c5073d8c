# SPDX-License-Identifier: MIT
"""The kinds of collision primitives: their order, the distance of each pair, and their rays.

A list of primitives (`types.Shapes`) holds them kind by kind, in the order of `KINDS`; `counts`
says how many there are of each. Nothing outside this module relies on their order. A new kind is a
module with its distances, and its entries in `KINDS` and `PAIRS`.
"""

from collections.abc import Callable, Sequence
from itertools import accumulate, pairwise
from typing import Any, NamedTuple

import jax.numpy as jnp

from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels.collision import distance
from hybrid_jax.kernels.collision.ray_lengths import ray_box, ray_capsule, ray_polytope


class PrimitiveKind(NamedTuple):
    """What the kernels need to know about one kind of primitive."""

    name: str
    is_one: Callable[[Any], bool]
    """From half extents `[3]` [m]: is a primitive with these of this kind, if it is no hull?"""
    as_box: bool
    """Does its distance read a robot's primitive as `RoundedBoxes`, or as `Rows` alone?"""
    ray: Callable
    """Length of rays until they meet it, from origin, direction and its operands."""
    ray_operands: Callable
    """From poses `[n, 7]`, half extents `[n, 3]`, radii `[n]` and the faces `[n, face, 4]` of hulls
    to what `ray` reads, by rows."""


def _axis_ends(pose, half_extents, radius, faces):
    """Ends `[n, 2, 3]` of the axes of capsules [m], and their radii `[n]` [m]."""
    axis = dq.quat_rotate(pose[:, 3:], half_extents * jnp.array([[0.0, 0.0, 1.0]]))
    return jnp.stack([pose[:, :3] - axis, pose[:, :3] + axis], axis=1), radius


POLYTOPE = "polytope"
"""Name of the kind that is a convex hull swept by a ball."""
KINDS = (
    PrimitiveKind(
        "capsule",  # and sphere, a capsule without length
        is_one=lambda half_extents: half_extents[0] == 0.0 and half_extents[1] == 0.0,
        as_box=False,
        ray=ray_capsule,
        ray_operands=_axis_ends,
    ),
    PrimitiveKind(
        "rounded box",
        is_one=lambda half_extents: True,
        as_box=True,
        ray=ray_box,
        ray_operands=lambda pose, half_extents, radius, faces: (pose, half_extents),
    ),
    PrimitiveKind(
        POLYTOPE,
        is_one=lambda half_extents: False,
        as_box=True,
        ray=ray_polytope,
        ray_operands=lambda pose, half_extents, radius, faces: (pose, radius, faces),
    ),
)
"""All kinds, in the order in which a list holds them; a primitive is of the first that fits."""

PAIRS: dict[tuple[str, str], Callable] = {
    # capsules apart from boxes: their distance needs no test of twelve edges
    ("capsule", "rounded box"): lambda rows, row_boxes, block: distance.capsule_rounded_box(
        rows.centre, rows.axis, rows.radius, block
    ),
    ("rounded box", "rounded box"): lambda rows, row_boxes, block: distance.rounded_box_rounded_box(
        row_boxes, block
    ),
    # of a robot that is made of balls alone
    ("ball", "ball"): lambda rows, row_boxes, block: distance.sphere_sphere(
        rows.centre, rows.radius, block
    ),
    ("ball", "rounded box"): lambda rows, row_boxes, block: distance.sphere_rounded_box(
        rows.centre, rows.radius, block
    ),
}
"""Exact signed distance of a robot's primitive and an obstacle [m], by their kinds.

From the robot's `Rows`, the same as `RoundedBoxes` where its kind is read so (else None), and
the obstacle as `RoundedBoxes`; components broadcast. Every obstacle is a rounded box, too: where
there are polytopes, `gjk.convex_distance` measures every pair."""


def kind_of(half_extents: Sequence[float], is_hull: bool = False) -> int:
    """Number in `KINDS` of a primitive with half extents `[3]` [m]."""
    if is_hull:
        return next(i for i, kind in enumerate(KINDS) if kind.name == POLYTOPE)
    return next(i for i, kind in enumerate(KINDS) if kind.is_one(half_extents))


def spans(counts: Sequence[int]) -> list[slice]:
    """Where the primitives of each kind stand in a list with so many of each."""
    return [slice(first, last) for first, last in pairwise(accumulate(counts, initial=0))]


def kinds_of(counts: Sequence[int]) -> list[int]:
    """Kind of each primitive of a list with so many of each."""
    return [kind for kind, count in enumerate(counts) for _ in range(count)]


def joined_order(first: Sequence[int], second: Sequence[int]) -> list[int]:
    """Where the primitives of two joined lists come from; the second list counts on.

    Args:
        first, second: how many there are of each kind in either list.

    Returns:
        Number of each primitive of `rounded_boxes.join` in the two lists, one after the other.
    """
    offset, order = sum(first), []
    for a, b in zip(spans(first), spans(second), strict=True):
        order += [*range(a.start, a.stop), *range(offset + b.start, offset + b.stop)]
    return order


def rows_as_boxes(counts: Sequence[int]) -> list[int]:
    """Numbers of the primitives that are read as `RoundedBoxes`."""
    return [i for i, kind in enumerate(kinds_of(counts)) if KINDS[kind].as_box]
