# SPDX-License-Identifier: MIT
"""`MjModel` to `Workcell`: the only place where MJCF turns into the kernels' arrays."""

import hashlib
from pathlib import Path

import jax
import mujoco
import numpy as np

from hybrid_jax.errors import WorkcellError
from hybrid_jax.types import RobotShapes, Scene, Workcell
from hybrid_jax.workcell import geometry
from hybrid_jax.workcell.allowed_collisions import contact_pairs, forbidden_contacts
from hybrid_jax.workcell.chain import joint_frames, kinematic_chain, reference_data
from hybrid_jax.workcell.convex_hulls import MESH_TOLERANCE, hull_tables
from hybrid_jax.workcell.description import TaskData
from hybrid_jax.workcell.layout import (
    Layout,
    body_joints,
    body_path,
    find_layout,
    geom_links,
    home_qpos,
)
from hybrid_jax.workcell.poses import matrix_pose, pose_of
from hybrid_jax.workcell.shape_padding import fill_up
from hybrid_jax.workcell.source import WorkcellSource


def _stroke(model, data, layout, geom: int, frame) -> np.ndarray:
    """`[3]` displacement of a geom per metre of gripper opening, in its link's frame."""
    stroke = np.zeros(3)
    for body in body_path(model, int(model.geom_bodyid[geom])):
        for j in body_joints(model, body):
            if j in layout.fingers:
                stroke += frame.rotation.inv().apply(data.xaxis[j])
    return stroke


def _object_of(model, layout, geom: int) -> int:
    """Index of the movable object that a geom belongs to; -1 where it belongs to none."""
    path = body_path(model, int(model.geom_bodyid[geom]))
    return layout.object_bodies.index(path[0]) if path and path[0] in layout.object_bodies else -1


def _robot(model, data, geoms, frames, links, tolerance):
    """Primitives that the arm moves, by link within each kind."""
    return geometry.in_order(
        [
            p
            for g in sorted(geoms, key=lambda g: links[g])
            for p in geometry.primitives(model, data, g, frames[links[g]], tolerance)
        ]
    )


def _robot_record(model, data, layout, primitives, frames, links, hulls) -> RobotShapes:
    """Record of the primitives that the arm moves."""
    strokes = [_stroke(model, data, layout, p.geom, frames[links[p.geom]]) for p in primitives]
    return RobotShapes(
        shapes=geometry.to_shapes(primitives, hulls=hulls),
        stroke=np.array(strokes, np.float32).reshape(-1, 3),
        link=np.array([links[p.geom] for p in primitives], np.int32),
    )


def _sorted_geoms(model, layout, links) -> tuple[list[int], list[int], list[int]]:
    """Collision geoms of the arm, of movable objects, and of what is welded to the world."""
    geoms = geometry.collision_geoms(model)
    arm = [g for g in geoms if links[g] >= 0]
    objects = [g for g in geoms if _object_of(model, layout, g) >= 0]
    return arm, objects, [g for g in geoms if links[g] < 0 and g not in objects]


def _fixtures(model, data, geoms, tolerance):
    """Primitives of what is welded to the world."""
    world = pose_of([0, 0, 0], [1, 0, 0, 0])
    return geometry.in_order(
        [p for g in geoms for p in geometry.primitives(model, data, g, world, tolerance)]
    )


def _scene(task: TaskData | None, objects, slots: tuple[int, ...], fixtures: int, hulls) -> Scene:
    """The scene in which nothing is held, its objects still in their bodies' frames."""
    gripper = task.gripper if task else None
    return Scene(
        objects=geometry.to_shapes(objects, hulls=hulls),
        payload=geometry.to_shapes([], slots),
        opening=np.float32(gripper.open if gripper else 0.0),
        support_on=np.ones(fixtures, np.float32),
    )


def _objects(model, data, layout, geoms, tolerance):
    """Primitives of the movable objects in their bodies' frames."""
    primitives = []
    for g in geoms:
        body = layout.object_bodies[_object_of(model, layout, g)]
        frame = matrix_pose(data.xpos[body], data.xmat[body])
        primitives += geometry.primitives(model, data, g, frame, tolerance)
    return geometry.in_order(primitives)


def _payload_slots(task: TaskData | None, owners: list[int], objects) -> tuple[int, ...]:
    """Primitives of each kind that a payload needs: the most that any object has."""
    # without task data any object may be held
    if task and all(task.held_in_tool(spec.name) is None for spec in task.objects):
        return geometry.counts_of([])
    # whichever object is held, the arrays keep their shapes, so no new trace is needed
    pairs = list(zip(owners, objects, strict=True))
    counts = [geometry.counts_of([p for o, p in pairs if o == k]) for k in set(owners)]
    return tuple(map(max, zip(geometry.counts_of([]), *counts, strict=True)))


def _digest(arrays, names, task) -> str:
    """Hash of what the kernels read, rounded so that it does not depend on the last bit."""
    digest = hashlib.sha256(repr((names, task)).encode())
    for leaf in jax.tree.leaves(arrays):
        rounded = np.round(np.asarray(leaf, np.float64), 5) + 0.0  # no negative zeros
        digest.update(rounded.astype(np.float32).tobytes())
    return digest.hexdigest()


def require_geometry(model: mujoco.MjModel, layout: Layout) -> None:
    """Refuse an arm without collision geoms: every motion would seem free.

    Raises:
        WorkcellError: no geom of the arm can touch anything.
    """
    links = geom_links(model, layout)
    if not any(links[g] >= 0 for g in geometry.touching_geoms(model)):
        body = model.body(int(model.site_bodyid[layout.tool_site])).name
        raise WorkcellError(
            f"no geom of the arm (joints {', '.join(layout.joint_names)}; tool on {body!r}) can "
            "touch anything: its collision geoms are missing, or their contype and conaffinity "
            "are 0"
        )


def compile_workcell(
    model: mujoco.MjModel,
    name: str,
    task: TaskData | None,
    mesh_tolerance: float = MESH_TOLERANCE,
    path: Path | None = None,
    tool: str = "",
    spec: mujoco.MjSpec | None = None,
) -> Workcell:
    """Turn a compiled model into the pytree that the kernels read.

    Args:
        model: of the whole cell.
        name: of the cell.
        task: its data, if it has any.
        mesh_tolerance: how far the polytope of a mesh may stand out of its convex hull [m].
        path: of the file that the model was read from.
        tool: site that is the tool; as the task data say, or a usual name, if empty.
        spec: what the model was compiled from, if that is known.

    Returns:
        The cell with its objects in their bodies' frames: place them by `place_objects`. Its lists
        of primitives are filled up (`shape_padding`).

    Raises:
        WorkcellError: a geom that the kernels cannot represent, an arm without collision geoms,
            no serial arm, a slide without a range, or limits that are no numbers.
    """
    layout = find_layout(model, task, tool)
    require_geometry(model, layout)
    data = reference_data(model, layout)
    frames = joint_frames(model, data, layout)
    links = geom_links(model, layout)
    arm_geoms, object_geoms, fixed_geoms = _sorted_geoms(model, layout, links)
    robot = _robot(model, data, arm_geoms, frames, links, mesh_tolerance)
    fixtures = _fixtures(model, data, fixed_geoms, mesh_tolerance)
    objects = _objects(model, data, layout, object_geoms, mesh_tolerance)
    hulls = geometry.hulls_of([*robot, *fixtures, *objects])
    owners = [_object_of(model, layout, p.geom) for p in objects]
    slots = _payload_slots(task, owners, objects)
    forbidden, last_link = forbidden_contacts(model, layout), len(layout.joints) - 1
    pairs = contact_pairs(robot, slots, fixtures, objects, links, last_link, forbidden)
    scene = _scene(task, objects, slots, len(fixtures), hulls)
    arrays = {
        "chain": kinematic_chain(model, data, layout),
        "hulls": hull_tables(hulls),
        "robot": _robot_record(model, data, layout, robot, frames, links, hulls),
        "fixtures": geometry.to_shapes(fixtures, hulls=hulls),
        "objects": scene.objects,
        "pairs": pairs,
        "home": home_qpos(model)[list(layout.qpos)].astype(np.float32),
    }
    bodies = tuple(model.body(model.geom_bodyid[p.geom]).name for p in fixtures)
    source = WorkcellSource(
        name=name,
        digest=_digest(arrays, (layout.joint_names, layout.object_names, owners), task),
        model=model,
        layout=layout,
        task=task,
        owners=tuple(owners),
        fixture_bodies=bodies,
        path=path,
        tool=tool,
        spec=spec,
    )
    cell = Workcell(**arrays, owners=np.array(owners, np.int32), scene=scene, source=source)
    cell = fill_up(cell)
    cell.source.arrays = cell.for_programs()
    # made on the host and moved together: each operation on the device would be compiled
    return jax.device_put(cell)
