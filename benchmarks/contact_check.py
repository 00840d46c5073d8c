# SPDX-License-Identifier: MIT
"""Free or not, by C MuJoCo's own collisions: what the rivals ask, and what judges all paths."""

import mujoco
import numpy as np

from hybrid_jax.types import Workcell
from hybrid_jax.workcell.allowed_collisions import forbidden_contacts
from hybrid_jax.workcell.layout import home_qpos


class ContactCheck:
    """Is a configuration free, as C MuJoCo sees it?"""

    def __init__(self, cell: Workcell):
        self.model, self.data = cell.model, mujoco.MjData(cell.model)
        self._forbidden = forbidden_contacts(cell.model, cell.source.layout)
        self._joints = list(cell.source.layout.qpos)
        self.data.qpos[:] = home_qpos(cell.model)

    def __call__(self, q: np.ndarray) -> bool:
        """Whether the arm may be at `q` `[joint]` [rad or m], all else as at home."""
        self.data.qpos[self._joints] = q
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_collision(self.model, self.data)
        contacts = self.data.contact
        if not self.data.ncon:
            return True
        overlapping = contacts.geom[contacts.dist < 0]
        return not self._forbidden[overlapping[:, 0], overlapping[:, 1]].any()
