# SPDX-License-Identifier: MIT
"""Who touches whom in a simulated cell: the arm, its fingers and every object, against the rest."""

import warnings
from dataclasses import dataclass

import mujoco
import numpy as np

from hybrid_jax.errors import WorkcellError
from hybrid_jax.quiet import engine_messages
from hybrid_jax.skills.handling import object_in_tool
from hybrid_jax.skills.scenes import require_task_data
from hybrid_jax.types import Workcell
from hybrid_jax.workcell.layout import Layout
from hybrid_jax.workcell.load import read_spec

ARM, FINGERS, OBJECTS = 0, 1, 2
"""Rows of the movers: the arm, its fingers, then one for each object."""

_PIVOT, _TORQUE_SCALE = (0.0, 0.0, 0.0), 1.0
_FOUND = 1 << int(mujoco.mjtConDataField.mjCONDATA_FOUND)


@dataclass(frozen=True)
class Pair:
    """One sensor: the body, or all bodies from it on, that touches a body."""

    first: str
    tree: bool
    """Do all bodies count that hang on `first`?"""
    second: str


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
    """`[sensor, mover * thing]` what each sensor adds to each pair."""

    @property
    def layout(self) -> Layout:
        """Where things stand in the model; the same as in the cell's."""
        return self.cell.source.layout

    def touching(self, counts: np.ndarray) -> np.ndarray:
        """`[..., mover, thing]` True where two touch, from contacts of each sensor `[..., sensor]`.

        A finger that touches a fixture counts as arm.
        """
        shape = (*counts.shape[:-1], len(self.movers), len(self.things))
        return (counts @ self.weights > 0).reshape(shape)

    def geoms(self) -> tuple[np.ndarray, np.ndarray]:
        """`[sensor, geom]` True for the geoms on either side of each sensor."""
        model = self.model
        sides = np.zeros((2, len(self.pairs), model.ngeom), bool)
        for s, pair in enumerate(self.pairs):
            for side, name, tree in ((0, pair.first, pair.tree), (1, pair.second, False)):
                body = model.body(name).id
                for g, of in enumerate(model.geom_bodyid):
                    while tree and of and of != body:
                        of = model.body_parentid[of]
                    sides[side, s, g] = of == body
        return sides[0], sides[1]


def _fixtures(model: mujoco.MjModel) -> tuple[str, ...]:
    """Bodies with geoms that nothing moves: the robot's base is one of them."""
    return tuple(
        model.body(b).name
        for b in range(model.nbody)
        if model.body_weldid[b] == 0 and model.body_geomnum[b] > 0
    )


def _pairs(model: mujoco.MjModel, layout: Layout) -> tuple[tuple[Pair, ...], tuple, np.ndarray]:
    """The sensors, the things, and the weights.

    Where there is no gripper no object is carried, and objects are not asked what they touch.
    """
    objects, fixtures = layout.object_names, _fixtures(model)
    fingers = sorted({model.body(model.jnt_bodyid[j]).name for j in layout.fingers})
    things = (*objects, *fixtures)
    rows = OBJECTS + len(objects)
    pairs, weights = [], []

    def sense(first: str, tree: bool, second: str, *entries: tuple[int, float, str]) -> None:
        pairs.append(Pair(first, tree, second))
        table = np.zeros((rows, len(things)))
        for row, value, thing in entries:
            table[row, things.index(thing)] = value
        weights.append(table.ravel())

    root = model.body(model.jnt_bodyid[layout.joints[0]]).name
    for thing in things:
        sense(root, True, thing, (ARM, 1, thing))
    for thing in objects:
        for finger in fingers:
            sense(finger, False, thing, (FINGERS, 1, thing), (ARM, -1, thing))
    for k, first in enumerate(objects if fingers else ()):
        for second in (*objects[k + 1 :], *fixtures):
            both = [(OBJECTS + k, 1, second)]
            if second in objects:
                both.append((OBJECTS + objects.index(second), 1, first))
            sense(first, False, second, *both)
    return tuple(pairs), things, np.stack(weights)


def _add_welds(spec: mujoco.MjSpec, cell: Workcell) -> None:
    """Equalities that hold each object in the tool as it was gripped; none is active."""
    model, layout, data = cell.model, cell.source.layout, cell.source.task
    if data.gripper is None:
        return
    hand = int(model.site_bodyid[layout.tool_site])
    for name in layout.object_names:
        held = object_in_tool(data.object(name))
        position, quat = np.empty(3), np.empty(4)
        site = model.site_pos[layout.tool_site], model.site_quat[layout.tool_site]
        mujoco.mju_mulPose(position, quat, *site, held[:3], held[3:])
        spec.add_equality(
            type=mujoco.mjtEq.mjEQ_WELD, objtype=mujoco.mjtObj.mjOBJ_BODY, active=False,
            name=f"weld {name}", name1=model.body(hand).name, name2=name,
            data=[*_PIVOT, *position, *quat, _TORQUE_SCALE, 0],
        )  # fmt: skip


def sense_cell(cell: Workcell) -> SensedCell:
    """A cell whose contacts can be told apart in either engine.

    Raises:
        WorkcellError: no task data, or the cell was not read from an MJCF file with named bodies.
    """
    require_task_data(cell)
    path, layout = cell.source.path, cell.source.layout
    if path is None or path.suffix.lower() != ".xml":
        raise WorkcellError(f"{cell.source.name}: only cells of MJCF files can be executed")
    pairs, things, weights = _pairs(cell.model, layout)
    if not all(things) or not all(pair.first for pair in pairs):
        raise WorkcellError(f"{cell.source.name}: a body with geoms has no name; give it one")
    with warnings.catch_warnings(), engine_messages(cell.source.name):
        warnings.simplefilter("ignore", UserWarning)
        spec = read_spec(path, cell.source.tool)
        for pair in pairs:
            sensor = spec.add_sensor(
                type=mujoco.mjtSensor.mjSENS_CONTACT,
                objtype=mujoco.mjtObj.mjOBJ_XBODY if pair.tree else mujoco.mjtObj.mjOBJ_BODY,
                objname=pair.first, reftype=mujoco.mjtObj.mjOBJ_BODY, refname=pair.second,
            )  # fmt: skip
            sensor.intprm[:3] = [_FOUND, 0, 1]
        _add_welds(spec, cell)
        model = spec.compile()
    movers = ("arm", "fingers", *layout.object_names)
    return SensedCell(cell, model, pairs, movers, things, weights)
