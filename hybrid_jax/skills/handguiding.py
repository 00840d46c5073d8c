# SPDX-License-Identifier: MIT
"""Record demonstrations by a scripted hand that guides the simulated arm.

The hand is no ruler: it bends its way through via points, speeds up and slows down, drifts and
trembles. mink makes the arm follow within its limits, and the arm's own tool poses are recorded.
The guiding happens in free space, without the cell's walls: what a demonstrator who stands beside
the bare robot would do.

    python -m hybrid_jax.skills.handguiding --workcell gen3_handling
"""

from collections.abc import Iterator
from dataclasses import dataclass

import mink
import mujoco
import numpy as np
import tyro
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import RigidTransform, Rotation, Slerp

from hybrid_jax.skills import task as tasks
from hybrid_jax.skills.demonstration import Demonstration, save_demonstrations
from hybrid_jax.types import Workcell
from hybrid_jax.workcell.assets import demonstrations_file
from hybrid_jax.workcell.geometry import as_row, matrix_pose
from hybrid_jax.workcell.layout import home_qpos
from hybrid_jax.workcell.load import load_workcell


@dataclass(frozen=True)
class HandConfig:
    """How a human hand guides."""

    rate: float = 50.0
    """Samples per second."""
    speed: float = 0.25
    """Mean speed of the hand [m/s]."""
    drift: float = 0.004
    """Slow deviation from the intended path [m]; ten times as many radians per metre."""
    tremor: float = 0.0003
    """Trembling at about 8 Hz [m]."""
    via_error: float = 0.012
    """How exactly via points are met [m]."""


def _intended(points: list[RigidTransform], config: HandConfig, rng) -> tuple[np.ndarray, list]:
    """Times and poses of the intended motion: a spline through the points, uneven speed."""
    positions = np.array([p.translation for p in points])
    positions[1:-1] += rng.normal(scale=config.via_error, size=positions[1:-1].shape)
    knots = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(positions, axis=0), axis=1))])
    knots /= knots[-1]
    path = CubicSpline(knots, positions, bc_type="natural")
    turn = Slerp(knots, Rotation.concatenate([p.rotation for p in points]))
    length = np.linalg.norm(np.diff(path(np.linspace(0, 1, 200)), axis=0), axis=1).sum()
    seconds = max(1.2, length / config.speed)
    t = np.arange(0, seconds, 1 / config.rate)
    x = t / t[-1]
    phase = 10 * x**3 - 15 * x**4 + 6 * x**5  # minimum jerk
    phase += 0.03 * np.sin(2 * np.pi * x) * np.sin(np.pi * x) ** 2 * rng.normal()
    phase = np.clip(phase, 0, 1)
    poses = [RigidTransform.from_components(path(s), turn(s)) for s in phase]
    return t, poses


def _shaken(times: np.ndarray, poses: list, config: HandConfig, rng) -> list:
    """Add drift and tremor, fading towards both ends, where the hand takes care."""
    fade = np.sin(np.pi * times / times[-1])[:, None] ** 2
    waves = [(rng.uniform(0.2, 0.7), rng.uniform(0, 6.3), rng.normal(size=6)) for _ in range(3)]
    drift = sum(np.sin(2 * np.pi * f * times + p)[:, None] * a for f, p, a in waves) / np.sqrt(3)
    fast = np.sin(2 * np.pi * 8 * times + rng.uniform(0, 6.3))[:, None] * rng.normal(size=3)
    shift = fade * (config.drift * drift[:, :3] + config.tremor * fast)
    turns = fade * 10 * config.drift * drift[:, 3:]
    return [
        RigidTransform.from_components(p.translation + d, Rotation.from_rotvec(r) * p.rotation)
        for p, d, r in zip(poses, shift, turns, strict=True)
    ]


def guide(
    cell: Workcell,
    name: str,
    points: list[RigidTransform],
    closed: bool,
    config: HandConfig,
    rng: np.random.Generator,
) -> Demonstration:
    """Guide the arm through tool poses and record where its tool was."""
    times, intended = _intended(points, config, rng)
    hand = _shaken(times, intended, config, rng)
    model = cell.model
    configuration = mink.Configuration(model, home_qpos(model))
    site = model.site(cell.source.layout.tool_site).name
    follow = mink.FrameTask(site, "site", position_cost=1.0, orientation_cost=0.5, lm_damping=1e-3)
    limits = [mink.ConfigurationLimit(model)]

    def step(target: RigidTransform) -> None:
        follow.set_target(mink.SE3.from_matrix(target.as_matrix()))
        velocity = mink.solve_ik(
            configuration, [follow], 1 / config.rate, solver="daqp", damping=1e-6, limits=limits
        )
        configuration.integrate_inplace(velocity, 1 / config.rate)

    for _ in range(150):  # bring the tool to the first pose
        step(points[0])
    recorded = []
    for target in hand:
        step(target)
        data = configuration.data
        index = cell.source.layout.tool_site
        recorded.append(as_row(matrix_pose(data.site_xpos[index], data.site_xmat[index])))
    return Demonstration(name, robot_name(model), closed, times, _to_dual(np.array(recorded)))


def robot_name(model: mujoco.MjModel) -> str:
    """What the recording calls the robot: the root body of the arm."""
    return model.body(1).name


def _to_dual(rows: np.ndarray) -> np.ndarray:
    """`[n, 7]` poses to unit dual quaternions `[n, 8]`."""
    real = rows[:, 3:]
    w, v, t = real[:, :1], real[:, 1:], rows[:, :3]
    dual = 0.5 * np.concatenate([-np.sum(t * v, 1, keepdims=True), w * t + np.cross(t, v)], 1)
    return np.concatenate([real, dual], axis=1)


def _pose(row: np.ndarray) -> RigidTransform:
    """SciPy pose of a unit dual quaternion `[8]`."""
    return RigidTransform.from_dual_quat(row, scalar_first=True)


def _shifted(pose: RigidTransform, x=0.0, y=0.0, z=0.0) -> RigidTransform:
    return RigidTransform.from_components(pose.translation + [x, y, z], pose.rotation)


def scripted_motions(cell: Workcell, yaw: float) -> Iterator[tuple[str, bool, list]]:
    """Name, gripper and intended tool poses of every skill, for each kind of object."""
    data, layout = tasks.require_handling(cell), cell.source.layout
    home = home_qpos(cell.model)
    kinds = {spec.kind: spec for spec in reversed(data.objects)}
    for kind, spec in kinds.items():
        poses = np.stack([home[a : a + 7] for a in layout.object_qpos])
        poses[layout.object_names.index(spec.name), [0, 1]] = spec.spawn[:2]
        poses[layout.object_names.index(spec.name), 3:] = [np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)]
        start, grasp, lifted, above, placed, end = (
            _pose(p.astype(float)) for p in tasks.handling_task(cell, spec.name, poses).key_poses
        )
        middle = RigidTransform.from_components(
            (lifted.translation + above.translation) / 2 + [0, 0, 0.05], above.rotation
        )
        before = _shifted(grasp, z=0.16)
        yield f"pick_{kind}", False, [start, _shifted(before, x=-0.03, z=0.02), before, grasp]
        yield f"lift_{kind}", True, [grasp, _shifted(grasp, z=data.lift / 2), lifted]
        yield f"transfer_{kind}", True, [lifted, middle, above]
        yield f"place_{kind}", True, [above, _shifted(placed, z=data.hover / 2), placed]
        yield f"carry_{kind}", True, [grasp, lifted, middle, above, placed]
        yield (
            f"retreat_{kind}",
            False,
            [
                placed,
                _shifted(placed, z=0.12),
                _shifted(end, y=0.4 * placed.translation[1], z=0.02),
                end,
            ],
        )


def record(cell: Workcell, config: HandConfig = HandConfig(), seed: int = 0) -> list[Demonstration]:
    """Guide the arm through every skill once; transfers and picks at two more headings."""
    rng = np.random.default_rng(seed)
    demos = []
    for suffix, yaw in (("", 0.0), ("_left", 0.22), ("_right", -0.22)):
        for name, closed, points in scripted_motions(cell, yaw):
            if not suffix or name.startswith(("transfer", "pick")):
                demos.append(guide(cell, name + suffix, points, closed, config, rng))
                print(f"recorded {demos[-1].name}: {demos[-1].times[-1]:.1f} s")
    return demos


def main(workcell: str = "gen3_handling", seed: int = 0) -> None:
    """Record the demonstrations of a cell and store them beside its robot."""
    cell = load_workcell(workcell)
    save_demonstrations(demonstrations_file(cell.source.name), record(cell, seed=seed))


if __name__ == "__main__":
    tyro.cli(main)
