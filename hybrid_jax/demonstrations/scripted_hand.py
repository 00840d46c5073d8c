# SPDX-License-Identifier: MIT
"""Scripts of the shipped demonstrations: the tool poses that the hand intends to pass.

Twelve skills handle objects (reach, lift, carry, put down, go back), eight inspect with a brush
(hover over a tray, reach for a part, stroke along it straight, twisting or turning). All of them
are shown on one arm. Only their relative motions are used, which serve any other arm.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from hybrid_jax.tasks.handling import make_task, require_handling
from hybrid_jax.tasks.task import home_pose
from hybrid_jax.types import Workcell
from hybrid_jax.workcell.layout import home_qpos

_DOWN = Rotation.from_euler("x", np.pi)


@dataclass(frozen=True)
class Script:
    """One motion to be shown."""

    name: str
    """Name of the demonstration."""
    closed: bool
    """Is the gripper closed?"""
    points: list[RigidTransform]
    """Tool poses that it leads through."""
    note: str
    """What is shown, in words."""


def shifted(pose: RigidTransform, x=0.0, y=0.0, z=0.0) -> RigidTransform:
    """The pose moved along the axes of the base by `x`, `y`, `z` [m]."""
    return RigidTransform.from_components(pose.translation + [x, y, z], pose.rotation)


def _key_poses(cell: Workcell, name: str) -> list[RigidTransform]:
    """Key poses of sorting one object that lies in the middle of its region."""
    data, layout = require_handling(cell), cell.source.layout
    spec, home = data.object(name), home_qpos(cell.model)
    poses = np.stack([home[a : a + 7] for a in layout.object_qpos])
    row = layout.object_names.index(name)
    poses[row, [0, 1]] = spec.spawn[:2]
    poses[row, 3:] = [1.0, 0.0, 0.0, 0.0]
    return [
        RigidTransform.from_dual_quat(pose.astype(float), scalar_first=True)
        for pose in make_task(cell, name, poses).key_poses
    ]


def handling_scripts(cell: Workcell) -> Iterator[Script]:
    """Scripts of the skills that sort objects, for each kind of object and each tray."""
    data = require_handling(cell)
    kinds = {spec.kind: spec for spec in reversed(data.objects)}
    trays = {spec.tray: spec for spec in kinds.values()}
    for kind, spec in kinds.items():
        start, grasp, lifted, above, placed, end = _key_poses(cell, spec.name)
        pregrasp = shifted(grasp, z=0.16)
        aside = shifted(pregrasp, x=-0.03, z=0.02)
        middle = (lifted.translation + above.translation) / 2 + [0, 0, 0.05]
        midway = RigidTransform.from_components(middle, above.rotation)
        down = [pregrasp, shifted(grasp, z=0.06), grasp]
        yield Script(f"pick_{kind}", False, [start, aside, *down], f"reach for a {kind}")
        yield Script(
            f"transfer_{kind}", True, [lifted, midway, above], f"carry a {kind} over its tray"
        )
        if spec is trays[spec.tray]:
            low, back = shifted(grasp, z=data.lift / 2), shifted(placed, z=data.hover / 2)
            homeward = shifted(end, y=0.4 * placed.translation[1], z=0.02)
            yield Script(
                f"carry_{kind}",
                True,
                [grasp, lifted, midway, above, placed],
                f"take a {kind} from where it lies to its place",
            )
            yield Script(
                f"retreat_{spec.tray}",
                False,
                [placed, shifted(placed, z=0.12), homeward, end],
                f"go home from {spec.tray}",
            )
    # `trays` keeps the last kind of each tray: the last turn of the loop has set all that is used
    yield Script("lift", True, [grasp, low, lifted], "lift an object straight up")
    yield Script("place", True, [above, back, placed], "put an object down")


HOVER = RigidTransform.from_components([0.45, 0.33, 0.30], _DOWN)
"""Above the middle of the part tray that the inspection skills are shown on: aside of home."""


def on_part(x: float, y: float, tilt: float = 0.0, roll: float = 0.0) -> RigidTransform:
    """Tool pose with the brush on a part, 0.22 m below the hover pose.

    Args:
        x, y: where it touches, from the tray's middle [m].
        tilt: angle of the brush about the base's y axis [rad].
        roll: angle of the brush about the base's x axis [rad].
    """
    rotation = Rotation.from_euler("xy", [roll, tilt]) * _DOWN
    return RigidTransform.from_components(HOVER.translation + [x, y, -0.22], rotation)


def inspection_scripts(cell: Workcell) -> Iterator[Script]:
    """Scripts of the skills that brush parts on a tray, as in the paper's industrial case study."""
    home = RigidTransform.from_dual_quat(np.asarray(home_pose(cell), float), scalar_first=True)
    approach = shifted(HOVER, z=0.06)
    yield Script("hover", False, [home, approach, HOVER], "go from home over the tray's middle")
    for side, sign in (("left", 1.0), ("right", -1.0)):
        part = on_part(0.0, 0.09 * sign)
        yield Script(
            f"reach_{side}",
            False,
            [HOVER, shifted(part, x=-0.01, z=0.10), part],
            f"from over the tray down to a part on the {side}",
        )
    start, middle, end = on_part(-0.06, 0.0), on_part(0.0, 0.0), on_part(0.06, 0.0)
    yield Script("stroke_straight", False, [start, middle, end], "brush along a flat part")
    for side, sign in (("left", 1.0), ("right", -1.0)):
        twist = [on_part(-0.06 + 0.06 * i, 0.0, roll=0.25 * sign * (i - 1)) for i in range(3)]
        note = f"brush along a part that is twisted to the {side}"
        yield Script(f"stroke_twist_{side}", False, twist, note)
    turning = [
        shifted(on_part(-0.06 + 0.06 * i, 0.0, tilt=0.3 * (i - 1)), z=0.012 * (i % 2))
        for i in range(3)
    ]
    yield Script(
        "stroke_turn", False, turning, "brush over a curved part, turning with its surface"
    )
    yield Script(
        "sweep",
        False,
        [HOVER, shifted(start, z=0.10), start, middle, end],
        "from over the tray down to a part and along it",
    )
