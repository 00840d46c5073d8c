# SPDX-License-Identifier: MIT
"""The skill library: demonstrations, filtered and stacked, and the settings for using them."""

import hashlib
from dataclasses import dataclass

import jax
import numpy as np
from flax import struct
from jax import Array

from hybrid_jax.demonstrations.demonstration import Demonstration
from hybrid_jax.demonstrations.filtering import clean
from hybrid_jax.demonstrations.splitting import at_gripper_events
from hybrid_jax.errors import DemonstrationError, InputError, UnknownNameError
from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.runtime.program_files import kept_array
from hybrid_jax.skills.feature_distance import BETAS
from hybrid_jax.skills.mapping import MAPS
from hybrid_jax.types import Record, pytree

MAX_SKILLS = 32
"""Largest number of skills in a library (`h_max`)."""


@dataclass(frozen=True)
class SkillConfig:
    """Settings by which skills are chosen and mapped."""

    map: str = "late_exact"
    """Map to a new start and goal, a key of `mapping.MAPS`."""
    distance: str = "screw"
    """Distance of features, a key of `feature_distance.BETAS`."""
    tolerance: float = 0.30
    """`Delta_beta`: a skill further away than this never moves the robot [m]."""

    def __post_init__(self):
        for kind, name, options in (("map", self.map, MAPS), ("distance", self.distance, BETAS)):
            if name not in options:
                raise UnknownNameError(f"skill {kind}", name, options)
        if not self.tolerance > 0:
            raise InputError(f"tolerance must be positive, got {self.tolerance}")


@pytree
class SkillLibrary(Record):
    """Filtered demonstrations, padded to `MAX_SKILLS`."""

    poses: Array
    """`[skill, point, 8]` unit dual quaternions, evenly spaced by arc length."""
    valid: Array
    """`[skill]` True for a slot that holds a skill."""
    closed: Array
    """`[skill]` True where the gripper holds an object."""
    names: tuple[str, ...] = struct.field(pytree_node=False)
    """`[skill]` names of the skills, without the padding."""

    def for_programs(self) -> "SkillLibrary":
        """The library without names, for programs that all libraries share (`kept`)."""
        return self.replace(names=())


def build_library(demos: list[Demonstration]) -> SkillLibrary:
    """Filter demonstrations and stack them; where the gripper acts, one skill ends.

    Args:
        demos: recordings with poses `[sample, 7]`: position [m], quaternion.

    Returns:
        Skills of evenly spaced poses `[skill, point, 8]`, padded to `MAX_SKILLS`.

    Raises:
        DemonstrationError: no demonstration, or more than `MAX_SKILLS` skills in them.
    """
    demos = [part for demo in demos for part in at_gripper_events(demo)]
    if not 0 < len(demos) <= MAX_SKILLS:
        raise DemonstrationError(f"a library holds 1 to {MAX_SKILLS} skills, got {len(demos)}")
    poses = kept_array(
        "skills", (_digest(demos),), lambda: np.stack([clean(demo) for demo in demos])
    )
    free_slots = MAX_SKILLS - len(demos)
    filler = np.broadcast_to(np.array(dq.IDENTITY, np.float32), (free_slots, *poses.shape[1:]))
    return SkillLibrary(
        poses=jax.device_put(np.concatenate([poses, filler]).astype(np.float32)),
        valid=jax.device_put(np.arange(MAX_SKILLS) < len(demos)),
        closed=jax.device_put(np.array([d.closed for d in demos] + [False] * free_slots)),
        names=tuple(d.name for d in demos),
    )


def _digest(demos: list[Demonstration]) -> str:
    """Hash of all that skills are made of."""
    digest = hashlib.sha256()
    for demo in demos:
        for values in (demo.times, demo.poses, demo.gripper):
            digest.update(repr(np.shape(values)).encode())
            digest.update(np.ascontiguousarray(values, np.float64).tobytes())
    return digest.hexdigest()


def without(library: SkillLibrary, names: set[str]) -> SkillLibrary:
    """The library without the skills of some names; their slots become invalid."""
    # the names keep their places: the number of a skill is its slot
    keep = np.array(
        [i >= len(library.names) or library.names[i] not in names for i in range(MAX_SKILLS)]
    )
    return library.replace(valid=library.valid & keep)
