# SPDX-License-Identifier: MIT
"""Recordings for tests."""

import dataclasses

import numpy as np
from scipy.spatial.transform import Rotation

from hybrid_jax.demonstrations.demonstration import (
    Demonstration,
)


def recording(name="lift", count=60, gripper=0.0) -> Demonstration:
    """A smooth motion up, forward and about the vertical."""
    s = np.linspace(0, 1, count)
    position = np.stack([0.4 + 0.1 * s, 0.02 * np.sin(3 * s), 0.1 + 0.3 * s**2], axis=1)
    turn = Rotation.from_rotvec(0.8 * s[:, None] * [0, 0, 1]) * Rotation.from_euler("x", np.pi)
    poses = np.concatenate([position, turn.as_quat(scalar_first=True)], axis=1)
    return Demonstration(name, 2.0 * s, poses, np.full(count, gripper), robot="test arm")


def broken(**changes) -> Demonstration:
    """The recording with single values replaced: field=(index, value)."""
    demo = recording()
    for field, (index, value) in changes.items():
        array = np.array(getattr(demo, field))
        array[index] = value
        demo = dataclasses.replace(demo, **{field: array})
    return demo
