# SPDX-License-Identifier: MIT
"""Cut a demonstration into skills where the gripper acts, or where the screw changes."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from hybrid_jax.demonstrations.demonstration import MIN_SAMPLES, Demonstration, moves

SCREW_POSITION = 0.015
"""How far a pose may lie from a constant screw [m] (Mahalingam and Chakraborty, 2023)."""
SCREW_ROTATION = 0.15
"""How far a pose may be turned from a constant screw, as distance of unit quaternions."""
_ALONG = 101
"""Number of poses of the screw with which a recorded pose is compared."""


def _part(demo: Demonstration, number: int, low: int, high: int) -> Demonstration:
    """The samples `low` up to but not including `high`, as a demonstration of its own."""
    span = slice(low, high)
    return dataclasses.replace(
        demo,
        name=f"{demo.name}.{number}",
        times=demo.times[span],
        poses=demo.poses[span],
        gripper=demo.gripper[span],
    )


def _cut(demo: Demonstration, at: Sequence[int]) -> list[Demonstration]:
    """Parts between the samples `at`, each of which ends one part and begins the next."""
    if not at:
        return [demo]
    edges = [0, *at, len(demo.times) - 1]
    spans = [(a, b + 1) for a, b in zip(edges[:-1], edges[1:], strict=True)]
    # parts in which the tool rests are left out: there the gripper acts
    moving = [(a, b) for a, b in spans if b - a >= MIN_SAMPLES and moves(demo.poses[a:b])]
    return [_part(demo, i + 1, a, b) for i, (a, b) in enumerate(moving)]


def at_gripper_events(demo: Demonstration) -> list[Demonstration]:
    """Parts with the gripper either open or closed throughout, named `NAME.1`, `NAME.2`, ...

    A demonstration without an event is returned as it is.

    Args:
        demo: with poses `[sample, 7]` and gripper `[sample]`.
    """
    closed = demo.gripper > 0.5
    return _cut(demo, [int(i) + 1 for i in np.flatnonzero(closed[1:] != closed[:-1])])


def _on_screw(path: RigidTransform, low: int, high: int) -> bool:
    """Do the poses between two samples lie on the constant screw that joins the two?"""
    start, end = path[low], path[high]
    share = np.linspace(0, 1, _ALONG)[:, None]
    screw = start * RigidTransform.from_exp_coords(share * (start.inv() * end).as_exp_coords())
    between = path[low + 1 : high]
    gap = np.linalg.norm(between.translation[:, None] - screw.translation[None], axis=-1)
    dot = between.rotation.as_quat() @ screw.rotation.as_quat().T
    chord = np.sqrt(np.maximum(2 - 2 * np.abs(dot), 0))
    nearest = np.argmin(gap / SCREW_POSITION + chord / SCREW_ROTATION, axis=1)
    index = np.arange(len(nearest))
    position_fits = gap[index, nearest] <= SCREW_POSITION
    return bool(np.all(position_fits & (chord[index, nearest] <= SCREW_ROTATION)))


def screw_cuts(poses: np.ndarray) -> list[int]:
    """Samples at which one constant screw ends and the next begins.

    Args:
        poses: `[sample, 7]` position [m] and quaternion, of a smooth path.

    Returns:
        Numbers of the samples, in order; both ends of the path are left out.
    """
    turn = Rotation.from_quat(poses[:, 3:], scalar_first=True)
    path = RigidTransform.from_components(poses[:, :3], turn)
    # greedy: each screw is prolonged as far as its poses fit (Mahalingam and Chakraborty, 2023)
    cuts, low, last = [], 0, len(poses) - 1
    while low < last:
        high = low + 1
        while high < last and _on_screw(path, low, high + 1):
            high += 1
        if high < last:
            cuts.append(high)
        low = high
    return cuts


def at_screws(demo: Demonstration, samples: int = 100) -> list[Demonstration]:
    """Parts that each follow one constant screw, named `NAME.1`, `NAME.2`, ...

    Args:
        demo: with poses `[sample, 7]`; remove its tremor first where there is any.
        samples: how many samples, evenly taken, are compared with screws.
    """
    subset = np.unique(np.linspace(0, len(demo.times) - 1, samples).astype(int))
    return _cut(demo, [int(subset[i]) for i in screw_cuts(demo.poses[subset])])
