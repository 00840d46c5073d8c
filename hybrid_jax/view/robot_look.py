# SPDX-License-Identifier: MIT
"""Another model's meshes in place of the arm's primitives, in the picture only."""

from pathlib import Path

import mujoco
import numpy as np
import viser

from hybrid_jax.errors import WorkcellError
from hybrid_jax.types import Workcell
from hybrid_jax.web.scene import WebScene
from hybrid_jax.workcell.load import read_model
from hybrid_jax.workcell.poses import as_row, pose_of

_HINGE = int(mujoco.mjtJoint.mjJNT_HINGE)
_ROOT = "/look"


def arm_bodies(cell: Workcell) -> set[int]:
    """Bodies of the arm: the parent of its first joint's body, and each body with a joint."""
    bodies = [int(cell.model.jnt_bodyid[j]) for j in cell.source.layout.joints]
    return {int(cell.model.body_parentid[bodies[0]]), *bodies} - {0}


class RobotLook:
    """A model with the same kinematics, drawn in place of the cell's arm."""

    def __init__(self, server: viser.ViserServer, cell: Workcell, path: Path):
        """Draw the model.

        Args:
            server: of the scene.
            cell: whose arm it is.
            path: MJCF of the arm alone, its joints in the same order.

        Raises:
            WorkcellError: MuJoCo cannot read it, or it has other joints than the cell's arm.
        """
        self._model, self._cell = read_model(path), cell
        joints = [j for j in range(self._model.njnt) if self._model.jnt_type[j] == _HINGE]
        count = len(cell.joint_names)
        if len(joints) < count:
            raise WorkcellError(
                f"{path.name} has {len(joints)} hinge joints, the arm of cell "
                f"{cell.source.name!r} has {count}: give the model of the same arm"
            )
        self._joints = joints[:count]
        self._qpos = self._model.jnt_qposadr[self._joints]
        self._scene = WebScene(server, self._model, _ROOT)
        self._stand()

    def _stand(self) -> None:
        """Place the model so that its base is at the arm's base."""
        model_base = _base_pose(self._model, self._joints[0])
        arm_base = _base_pose(self._cell.model, self._cell.source.layout.joints[0])
        row = as_row(arm_base * model_base.inv())
        self._scene.root.position, self._scene.root.wxyz = row[:3], row[3:]

    def show(self, qpos: np.ndarray) -> None:
        """Move the model as the arm in a configuration `[nq]` of the cell."""
        model_qpos = self._model.qpos0.copy()
        model_qpos[self._qpos] = qpos[list(self._cell.source.layout.qpos)]
        self._scene.show(model_qpos)


def _base_pose(model: mujoco.MjModel, joint: int):
    """World pose of the parent of a joint's body, at the reference configuration."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    base = int(model.body_parentid[model.jnt_bodyid[joint]])
    return pose_of(data.xpos[base], data.xquat[base])
