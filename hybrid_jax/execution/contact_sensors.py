# SPDX-License-Identifier: MIT
"""Who touches whom in a simulated cell: the arm, its fingers and every object, against the rest."""

import warnings
from dataclasses import dataclass

import mujoco
import numpy as np

from hybrid_jax.errors import WorkcellError
from hybrid_jax.runtime.quiet import engine_messages
from hybrid_jax.tasks.scene_sampling import require_task_data
from hybrid_jax.types import Workcell
from hybrid_jax.workcell.layout import Layout
from hybrid_jax.workcell.load import read_spec

ARM, FINGERS, OBJECTS = 0, 1, 2
"""Rows of a table of contacts: the arm, its fingers, then one for each object."""

_PIVOT, _TORQUE_SCALE = (0.0, 0.0, 0.0), 1.0
_FOUND = 1 << int(mujoco.mjtConDataField.mjCONDATA_FOUND)


@dataclass(frozen=True)
class Pair:
    """One contact sensor: a body, alone or with all that hang on it, against a second body."""

    first: str
    """Name of a body."""
    tree: bool
    """Do all bodies count that hang on `first`?"""
    second: str
    """Name of the body that it touches."""


@dataclass(frozen=True)
class SensedCell:
    """A cell's model with a sensor for every pair that must be told apart."""

    cell: Workcell
    model: mujoco.MjModel
    """The cell's model, the sensors, and an inactive weld to the tool for each object."""
    pairs: tuple[Pair, ...]
    """What each sensor looks at."""
    movers: tuple[str, ...]
    """Rows: "arm", "fingers", and the objects."""
    things: tuple[str, ...]
    """Columns: the objects, then the fixtures."""
    weights: np.ndarray
    """`[sensor, mover * thing]` what one contact of each sensor adds to each pair."""

    @property
    def layout(self) -> Layout:
        """Indices into the model; they are the same as in the cell's own model."""
        return self.cell.source.layout

    def touching(self, counts: np.ndarray) -> np.ndarray:
        """Which pairs touch. A finger that touches a fixture counts as arm.

        Args:
            counts: `[..., sensor]` number of contacts that each sensor sees.

        Returns:
            `[..., mover, thing]` True where the two touch.
        """
        shape = (*counts.shape[:-1], len(self.movers), len(self.things))
        return (counts @ self.weights > 0).reshape(shape)

    def geoms(self) -> tuple[np.ndarray, np.ndarray]:
        """Geoms of the first and of the second body of each sensor, as two masks `[sensor, geom]`.

        MJX has no contact sensors: `DeviceEngine` counts contacts with these masks.
        """
        model = self.model
        sides = np.zeros((2, len(self.pairs), model.ngeom), bool)
        for s, pair in enumerate(self.pairs):
            for side, name, tree in ((0, pair.first, pair.tree), (1, pair.second, False)):
                body = model.body(name).id
                for g, ancestor in enumerate(model.geom_bodyid):
                    while tree and ancestor and ancestor != body:
                        ancestor = model.body_parentid[ancestor]
                    sides[side, s, g] = ancestor == body
        return sides[0], sides[1]


def _fixtures(model: mujoco.MjModel) -> tuple[str, ...]:
    """Bodies with geoms that are welded to the world; the robot's base is one of them."""
    return tuple(
        model.body(b).name
        for b in range(model.nbody)
        if model.body_weldid[b] == 0 and model.body_geomnum[b] > 0
    )


def _pairs(model: mujoco.MjModel, layout: Layout) -> tuple[tuple[Pair, ...], tuple, np.ndarray]:
    """The sensors, the names of the columns, and the weights `[sensor, mover * thing]`.

    Without a gripper no object is carried, so objects need no sensors of their own.
    """
    objects, fixtures = layout.object_names, _fixtures(model)
    fingers = sorted({model.body(model.jnt_bodyid[j]).name for j in layout.fingers})
    touched = (*objects, *fixtures)
    rows = OBJECTS + len(objects)
    pairs, weights = [], []

    def sense(first: str, tree: bool, second: str, *entries: tuple[int, float, str]) -> None:
        pairs.append(Pair(first, tree, second))
        table = np.zeros((rows, len(touched)))
        for row, value, body in entries:
            table[row, touched.index(body)] = value
        weights.append(table.ravel())

    root = model.body(model.jnt_bodyid[layout.joints[0]]).name
    for body in touched:
        sense(root, True, body, (ARM, 1, body))
    for body in objects:
        for finger in fingers:
            # the sensor of the arm's tree counts its fingers too: take their contacts off again
            sense(finger, False, body, (FINGERS, 1, body), (ARM, -1, body))
    for k, first in enumerate(objects if fingers else ()):
        for second in (*objects[k + 1 :], *fixtures):
            contacts = [(OBJECTS + k, 1, second)]
            if second in objects:
                contacts.append((OBJECTS + objects.index(second), 1, first))
            sense(first, False, second, *contacts)
    return tuple(pairs), touched, np.stack(weights)


def _add_welds(spec: mujoco.MjSpec, cell: Workcell) -> None:
    """Add an inactive weld for each object, which can hold it in the tool at its first grasp."""
    model, layout, data = cell.model, cell.source.layout, require_task_data(cell)
    hand = int(model.site_bodyid[layout.tool_site])
    for name in layout.object_names:
        held = data.held_in_tool(name)
        if held is None:
            continue
        position, quat = np.empty(3), np.empty(4)
        site = model.site_pos[layout.tool_site], model.site_quat[layout.tool_site]
        mujoco.mju_mulPose(position, quat, *site, held[:3], held[3:])
        # data of a weld: anchor, relative pose (position, quaternion), torque scale, unused
        spec.add_equality(
            type=mujoco.mjtEq.mjEQ_WELD,
            objtype=mujoco.mjtObj.mjOBJ_BODY,
            active=False,
            name=f"weld {name}",
            name1=model.body(hand).name,
            name2=name,
            data=[*_PIVOT, *position, *quat, _TORQUE_SCALE, 0],
        )


def sense_cell(cell: Workcell) -> SensedCell:
    """Add contact sensors to a cell, so that its contacts can be told apart in either engine.

    Args:
        cell: with task data, read from an MJCF file.

    Returns:
        The cell with its sensors; `weights` are `[sensor, mover * thing]`.

    Raises:
        WorkcellError: no task data, or the cell was not read from an MJCF file with named bodies.
    """
    require_task_data(cell)
    path, layout = cell.source.path, cell.source.layout
    if path is None or path.suffix.lower() != ".xml":
        raise WorkcellError(f"{cell.source.name}: only cells of MJCF files can be executed")
    pairs, columns, weights = _pairs(cell.model, layout)
    if not all(columns) or not all(pair.first for pair in pairs):
        raise WorkcellError(f"{cell.source.name}: a body with geoms has no name; give it one")
    with warnings.catch_warnings(), engine_messages(cell.source.name):
        warnings.simplefilter("ignore", UserWarning)
        spec = read_spec(path, cell.source.tool)
        for pair in pairs:
            sensor = spec.add_sensor(
                type=mujoco.mjtSensor.mjSENS_CONTACT,
                objtype=mujoco.mjtObj.mjOBJ_XBODY if pair.tree else mujoco.mjtObj.mjOBJ_BODY,
                objname=pair.first,
                reftype=mujoco.mjtObj.mjOBJ_BODY,
                refname=pair.second,
            )
            # data fields, kind of reduction, number of slots: `found` is the number of contacts
            sensor.intprm[:3] = [_FOUND, 0, 1]
        _add_welds(spec, cell)
        model = spec.compile()
    movers = ("arm", "fingers", *layout.object_names)
    return SensedCell(cell, model, pairs, movers, columns, weights)
