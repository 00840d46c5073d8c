# SPDX-License-Identifier: MIT
"""The skill library: demonstrations, cleaned and stacked, and how they are judged and mapped."""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from flax import struct
from jax import Array

from hybrid_jax.errors import DemonstrationError, InputError, UnknownNameError
from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.skills.cleaning import clean
from hybrid_jax.skills.cutting import at_gripper_events
from hybrid_jax.skills.demonstration import Demonstration
from hybrid_jax.skills.distance import BETAS
from hybrid_jax.skills.mapping import MAPS
from hybrid_jax.types import pytree

MAX_SKILLS = 32
"""Skills that a library may hold (`h_max`)."""


@dataclass(frozen=True)
class SkillConfig:
    """How skills are judged and mapped."""

    map: str = "late_exact"
    """Map to new ends, a key of `mapping.MAPS`."""
    distance: str = "screw"
    """Distance of features, a key of `mapping.BETAS`."""
    tolerance: float = 0.30
    """`Delta_beta`: a skill further away than this never moves the robot [m]."""

    def __post_init__(self):
        for kind, name, known in (("map", self.map, MAPS), ("distance", self.distance, BETAS)):
            if name not in known:
                raise UnknownNameError(f"skill {kind}", name, known)
        if not self.tolerance > 0:
            raise InputError(f"tolerance must be positive, got {self.tolerance}")


@pytree
class SkillLibrary:
    """Cleaned demonstrations, padded to `MAX_SKILLS`."""

    poses: Array
    """`[skill, point, 8]`."""
    valid: Array
    """`[skill]` True for a slot that holds a skill."""
    closed: Array
    """`[skill]` True where the gripper holds an object."""
    names: tuple[str, ...] = struct.field(pytree_node=False)
    """`[skill]` names of the skills in use."""


def build_library(demos: list[Demonstration]) -> SkillLibrary:
    """Clean demonstrations and stack them; where the gripper acts, one skill ends.

    Args:
        demos: recordings with poses `[sample, 7]` [m, quaternion].

    Returns:
        Skills of equally spaced poses `[skill, point, 8]`.

    Raises:
        DemonstrationError: no demonstration, or more than `MAX_SKILLS` skills in them.
    """
    demos = [part for demo in demos for part in at_gripper_events(demo)]
    if not 0 < len(demos) <= MAX_SKILLS:
        raise DemonstrationError(f"a library holds 1 to {MAX_SKILLS} skills, got {len(demos)}")
    poses = np.stack([clean(d) for d in demos])
    empty = MAX_SKILLS - len(demos)
    filler = np.broadcast_to(np.array(dq.IDENTITY, np.float32), (empty, *poses.shape[1:]))
    return SkillLibrary(
        poses=jnp.asarray(np.concatenate([poses, filler]), jnp.float32),
        valid=jnp.arange(MAX_SKILLS) < len(demos),
        closed=jnp.array([d.closed for d in demos] + [False] * empty),
        names=tuple(d.name for d in demos),
    )


def without(library: SkillLibrary, names: set[str]) -> SkillLibrary:
    """The library with some skills taken out."""
    keep = jnp.array(
        [i >= len(library.names) or library.names[i] not in names for i in range(MAX_SKILLS)]
    )
    return library.replace(valid=library.valid & keep)
