# SPDX-License-Identifier: MIT
"""Where an arm waits for objects: its tool points down, over and before them."""

import mink
import mujoco
import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from hybrid_jax.workcell.layout import Layout

PLACES = (0.25, 0.4), (0.15, 0.4), (0.05, 0.4), (0.15, 0.5), (0.15, 0.3)
"""How far the tool is before the middle of the objects, towards the base, and above it [m]: the
first that the arm need not fold itself up for. The shipped demonstrations begin about the first."""
SEEDS, STEPS = 24, 80
"""Configurations that the search starts from, and steps of each."""
PRECISION = 1e-3
"""Error at which a configuration counts as found [m and rad]."""


def ready_pose(
    base: np.ndarray, objects: np.ndarray, before: float, above: float
) -> RigidTransform:
    """Pose of the tool, its z axis down and its x axis away from the base.

    Args:
        base: `[3]` position of the arm's first joint [m].
        objects: `[n, 3]` positions of the objects [m].
        before: distance from their middle towards the base [m].
        above: height above their middle [m].
    """
    middle = objects.mean(axis=0)
    ahead = np.append((middle - base)[:2], 0.0)
    distance = np.linalg.norm(ahead)
    ahead = ahead / distance if distance > 1e-6 else np.array([1.0, 0.0, 0.0])
    down = np.array([0.0, 0.0, -1.0])
    axes = np.stack([ahead, np.cross(down, ahead), down], axis=1)
    # not behind the base
    position = middle - min(before, 0.5 * distance) * ahead + [0, 0, above]
    return RigidTransform.from_components(position, Rotation.from_matrix(axes))


def configurations_at(
    model: mujoco.MjModel, layout: Layout, pose: RigidTransform, stated: np.ndarray
) -> np.ndarray:
    """Configurations `[n, joint]` whose tool is at a pose, nearest the joints' middles first.

    Args:
        model: of the cell.
        layout: of its arm.
        pose: of the tool.
        stated: `[nq]` where all else is, and what the search begins with.
    """
    joints, address = list(layout.joints), list(layout.qpos)
    limited = model.jnt_limited[joints].astype(bool)[:, None]
    low, high = np.where(limited, model.jnt_range[joints], [-np.pi, np.pi]).T
    hinges = np.array([unit == "rad" for unit in layout.joint_units])
    middle, rng, found = (low + high) / 2, np.random.default_rng(0), []
    solver = _Solver(model, layout, pose)
    for seed in range(SEEDS):
        start = stated.copy()
        if seed:
            start[address] = rng.uniform(low, high)
        start[address] = np.clip(start[address], low, high)
        q = solver.solve(start)
        if q is not None:
            turns = np.round((q[address] - middle) / (2 * np.pi))
            found.append(q[address] - np.where(hinges, 2 * np.pi * turns, 0.0))
    found.sort(key=lambda q: np.abs((q - middle) / (high - low)).max())
    return np.array(found).reshape(-1, len(joints))


class _Solver:
    """mink's differential inverse kinematics, step by step, of the arm alone."""

    def __init__(self, model: mujoco.MjModel, layout: Layout, pose: RigidTransform):
        self._model = model
        self._task = mink.FrameTask(
            model.site(layout.tool_site).name,
            "site",
            position_cost=1.0,
            orientation_cost=0.5,
            lm_damping=1e-3,
        )
        self._task.set_target(mink.SE3.from_matrix(pose.as_matrix()))
        self._limits = [mink.ConfigurationLimit(model)]
        others = sorted(set(range(model.nv)) - set(layout.dofs))
        self._still = [mink.DofFreezingTask(model, others)] if others else []

    def solve(self, start: np.ndarray) -> np.ndarray | None:
        """`[nq]` with the tool at the pose, from a start `[nq]`; None if it does not get there."""
        state = mink.Configuration(self._model, start)
        for _ in range(STEPS):
            if np.abs(self._task.compute_error(state)).max() < PRECISION:
                return state.q.copy()
            velocity = mink.solve_ik(
                state,
                [self._task],
                1.0,
                "daqp",
                damping=1e-4,
                limits=self._limits,
                constraints=self._still,
            )
            state.integrate_inplace(velocity, 1.0)
        return None
