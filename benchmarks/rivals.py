# SPDX-License-Identifier: MIT
"""What else a user might take, on the same cell: C MuJoCo, PyBullet, mink.

The optional extra `bench` installs PyBullet; without it its rows are left out, saying so.
"""

import multiprocessing
import time
import warnings

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from hybrid_jax.kernels.collision.primitive_kinds import KINDS, kinds_of
from hybrid_jax.kernels.collision.rounded_boxes import local_shapes, row_links
from hybrid_jax.runtime.devices import usable_cores
from hybrid_jax.runtime.quiet import engine_messages
from hybrid_jax.types import Workcell
from hybrid_jax.workcell.assets import find_workcell
from hybrid_jax.workcell.layout import home_qpos

_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS
_IDLE = int(
    mujoco.mjtDisableBit.mjDSBL_LIMIT
    | mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS
    | mujoco.mjtDisableBit.mjDSBL_GRAVITY
    | mujoco.mjtDisableBit.mjDSBL_ACTUATION
    | mujoco.mjtDisableBit.mjDSBL_SENSOR
    | mujoco.mjtDisableBit.mjDSBL_WARMSTART
)
"""Parts of a step that have nothing to do with collisions."""


def welded_model(name: str) -> mujoco.MjModel:
    """The cell with its objects welded: the engine then skips their contacts with the world."""
    with engine_messages(name):
        spec = mujoco.MjSpec.from_file(str(find_workcell(name)))
        for joint in list(spec.joints):
            if joint.type == mujoco.mjtJoint.mjJNT_FREE:
                spec.delete(joint)
        for key in list(spec.keys):
            spec.delete(key)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the same message, once more by Python's means
            return spec.compile()


class Engine:
    """Kinematics and collision of C MuJoCo, configuration after configuration."""

    def __init__(self, cell: Workcell):
        self.model = welded_model(cell.source.name)
        self.data = mujoco.MjData(self.model)
        self.layout = layout = cell.source.layout
        home = home_qpos(cell.model)
        names = [self.model.joint(j).name for j in range(self.model.njnt)]
        for name in names:
            here = self.model.joint(name).qposadr[0]
            self.data.qpos[here] = home[cell.model.joint(name).qposadr[0]]
        self.address = [int(self.model.joint(n).qposadr[0]) for n in layout.joint_names]
        self.site = self.model.site(cell.model.site(layout.tool_site).name).id

    def place(self, q) -> None:
        self.data.qpos[self.address] = q
        mujoco.mj_kinematics(self.model, self.data)

    def deepest(self, q) -> float:
        """Smallest contact distance; 0 where nothing touches [m]."""
        self.place(q)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_collision(self.model, self.data)
        return float(self.data.contact.dist.min()) if self.data.ncon else 0.0

    def sweep(self, configurations) -> int:
        """How many configurations touch something."""
        model, data, address = self.model, self.data, self.address
        hits = 0
        for q in configurations:
            data.qpos[address] = q
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_collision(model, data)
            hits += data.ncon > 0
        return hits


def _sweep_part(job) -> float:
    name, q = job
    from hybrid_jax.workcell.load import load_workcell

    engine = Engine(load_workcell(name))
    engine.sweep(q[:100])
    began = time.perf_counter()
    engine.sweep(q)
    return time.perf_counter() - began


def mujoco_all_cores(cell: Workcell, q: np.ndarray) -> float:
    """Configurations per second of one engine per core, each in a process of its own."""
    cores = usable_cores()
    jobs = [(cell.source.name, part) for part in np.array_split(q, cores)]
    with multiprocessing.get_context("spawn").Pool(cores) as pool:
        return len(q) / max(pool.map(_sweep_part, jobs, chunksize=1))


def mujoco_rollout(cell: Workcell, q: np.ndarray):
    """A function that lets C MuJoCo's own threads look at configurations: no Python in between.

    `mujoco.rollout` makes a whole step of each, of which kinematics and collisions are a part; what
    else can be switched off is.
    """
    from mujoco import rollout

    engine, cores = Engine(cell), usable_cores()
    model, states = engine.model, []
    model.opt.iterations = model.opt.ls_iterations = 1
    model.opt.disableflags |= _IDLE
    for row in q:
        engine.data.qpos[engine.address] = row
        state = np.empty(mujoco.mj_stateSize(model, _STATE))
        mujoco.mj_getState(model, engine.data, state, _STATE)
        states.append(state)
    pool = rollout.Rollout(nthread=cores if cores > 1 else 0)
    data, rows = [mujoco.MjData(model) for _ in range(cores)], np.stack(states)
    return lambda: pool.rollout(model, data, rows, nstep=1)


class Bullet:
    """The cell in PyBullet, with our primitives; the paper's simulator."""

    def __init__(self, cell: Workcell):
        import pybullet

        self.bullet, self.cell = pybullet, cell
        pybullet.connect(pybullet.DIRECT)
        world = _primitives(cell.fixtures) + _primitives(cell.scene.objects)
        fixed = {
            column: pybullet.createMultiBody(0, self._shapes([one]))
            for column, one in enumerate(world)
            if one
        }
        self.robot = self._robot(cell)
        self._filter(fixed)
        self.joints = cell.chain.axis.shape[0]
        self.limits = np.asarray(cell.joint_limits, float)

    def _filter(self, fixed: dict[int, int]) -> None:
        """Switch off what may touch, as our tables do; `fixed` holds the bodies by column."""
        pairs, links = self.cell.pairs, np.array(row_links(self.cell))
        world, own = np.asarray(pairs.world), np.asarray(pairs.own)
        switch = self.bullet.setCollisionFilterPair
        for link in set(links):
            for column, body in fixed.items():
                if not world[links == link, column].any():
                    switch(self.robot, body, int(link), -1, 0)
            for other in set(links):
                columns = links[np.asarray(pairs.cover)] == other
                back = links[np.asarray(pairs.cover)] == link
                if not (own[links == link][:, columns].any() or own[links == other][:, back].any()):
                    switch(self.robot, self.robot, int(link), int(other), 0)

    def _shapes(self, ones) -> int:
        p = self.bullet
        if not ones:
            return -1
        kinds = {"capsule": p.GEOM_CAPSULE, "box": p.GEOM_BOX, "sphere": p.GEOM_SPHERE}
        kind, radius, length, half, position, orientation = zip(*ones, strict=True)
        return p.createCollisionShapeArray(
            shapeTypes=[kinds[k] for k in kind],
            radii=list(radius),
            lengths=list(length),
            halfExtents=[list(h) for h in half],
            collisionFramePositions=[list(x) for x in position],
            collisionFrameOrientations=[list(x) for x in orientation],
        )

    def _robot(self, cell: Workcell) -> int:
        p, chain = self.bullet, cell.chain
        links = np.asarray(row_links(cell)).tolist()
        ones = _primitives(local_shapes(cell))
        offset, tool = np.asarray(chain.offset, float), np.asarray(chain.tool, float)
        count = len(offset)
        shapes = [
            self._shapes([s for s, k in zip(ones, links, strict=True) if k == link and s])
            for link in range(count)
        ]
        frames = [*offset, tool]
        return p.createMultiBody(
            baseMass=0,
            basePosition=np.asarray(chain.base[:3], float).tolist(),
            baseOrientation=_xyzw(chain.base[3:]),
            linkMasses=[1.0] * (count + 1),
            linkCollisionShapeIndices=[*shapes, -1],
            linkVisualShapeIndices=[-1] * (count + 1),
            linkPositions=[f[:3].tolist() for f in frames],
            linkOrientations=[_xyzw(f[3:]) for f in frames],
            linkInertialFramePositions=[[0, 0, 0]] * (count + 1),
            linkInertialFrameOrientations=[[0, 0, 0, 1]] * (count + 1),
            linkParentIndices=list(range(count + 1)),
            linkJointTypes=[p.JOINT_REVOLUTE] * count + [p.JOINT_FIXED],
            linkJointAxis=[*np.asarray(chain.axis, float).tolist(), [0, 0, 1]],
            flags=p.URDF_USE_SELF_COLLISION | p.URDF_USE_SELF_COLLISION_EXCLUDE_PARENT,
        )

    def place(self, q) -> None:
        for joint in range(self.joints):
            self.bullet.resetJointState(self.robot, joint, q[joint])

    def touches(self) -> bool:
        self.bullet.performCollisionDetection()
        return len(self.bullet.getContactPoints(bodyA=self.robot)) > 0

    def tool(self):
        state = self.bullet.getLinkState(self.robot, self.joints, computeForwardKinematics=1)
        return np.array(state[4]), np.array(state[5])

    def sweep(self, configurations) -> int:
        """How many configurations touch something."""
        hits = 0
        for q in configurations:
            self.place(q)
            hits += self.touches()
        return hits

    def judge(self, position, quat_xyzw) -> tuple[bool, bool]:
        """Inverse kinematics from home, limits and collision: (solved, feasible)."""
        p = self.bullet
        self.place(np.asarray(self.cell.home, float))
        q = p.calculateInverseKinematics(
            self.robot,
            self.joints,
            position,
            quat_xyzw,
            maxNumIterations=100,
            residualThreshold=1e-5,
        )
        self.place(q)
        place, turn = self.tool()
        angle = (Rotation.from_quat(turn) * Rotation.from_quat(quat_xyzw).inv()).magnitude()
        near = np.linalg.norm(place - position) < 1e-3 and angle < np.deg2rad(0.5)
        inside = all(a <= v <= b for v, (a, b) in zip(q, self.limits, strict=True))
        touches = self.touches()
        return near and inside, near and inside and not touches


def _xyzw(quat) -> list[float]:
    w, x, y, z = np.asarray(quat, float)
    return [x, y, z, w]


def _primitives(shapes) -> list:
    """(kind, radius, length, half extents, position, orientation) of each; None of empty slots."""
    found, kinds = [], [KINDS[kind].name for kind in kinds_of(shapes.counts)]
    for i in range(shapes.count):
        pose, half = np.asarray(shapes.pose[i], float), np.asarray(shapes.half_extents[i], float)
        radius = float(shapes.radius[i])
        kind = "box" if kinds[i] != "capsule" else "capsule" if half[2] > 0 else "sphere"
        one = (kind, radius, 2 * half[2], half, pose[:3], _xyzw(pose[3:]))
        found.append(one if float(shapes.active[i]) > 0 else None)
    return found


def bullet(cell: Workcell) -> Bullet | None:
    """The cell in PyBullet, or None where it is not installed."""
    try:
        return Bullet(cell)
    except ImportError:
        print("PyBullet is not installed: its rows are left out (pip install 'hybrid_jax[bench]')")
        return None


def mink_solves(cell: Workcell, positions, quats, iterations: int = 100) -> tuple[float, float]:
    """Share of poses that mink solves from home, and poses per second."""
    import mink

    engine = Engine(cell)
    model, solved = engine.model, 0
    configuration = mink.Configuration(model)
    site = model.site(engine.site).name
    task = mink.FrameTask(site, "site", position_cost=1.0, orientation_cost=0.5, lm_damping=1e-3)
    limits = [mink.ConfigurationLimit(model)]
    began = time.perf_counter()
    for position, quat in zip(positions, quats, strict=True):
        configuration.update(engine.data.qpos.copy())
        target = mink.SE3.from_rotation_and_translation(mink.SO3(quat.astype(float)), position)
        task.set_target(target)
        for _ in range(iterations):
            velocity = mink.solve_ik(
                configuration, [task], 1.0, "daqp", damping=1e-4, limits=limits
            )
            configuration.integrate_inplace(velocity, 1.0)
            error = task.compute_error(configuration)
            if np.linalg.norm(error[:3]) < 1e-3 and np.linalg.norm(error[3:]) < np.deg2rad(0.5):
                solved += 1
                break
    return solved / len(positions), len(positions) / (time.perf_counter() - began)
