# SPDX-License-Identifier: MIT
"""Record the shipped demonstrations by a scripted hand that guides the simulated arm.

The hand is no ruler: it bends its way through via points, speeds up and slows down, drifts and
trembles. The arm follows within its limits, and the arm's own tool poses are recorded. The guiding
happens in free space, without the cell's walls: what a demonstrator who stands beside the bare
robot would do.

    python -m hybrid_jax.demonstrations.hand_guiding --workcell CELL --robot "its name"
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import RigidTransform, Rotation, Slerp

from hybrid_jax.demonstrations.demonstration import Demonstration, save_demonstration
from hybrid_jax.demonstrations.scripted_hand import Script, handling_scripts, inspection_scripts
from hybrid_jax.demonstrations.teleop import Follower
from hybrid_jax.types import Workcell
from hybrid_jax.workcell.assets import demonstrations_folder
from hybrid_jax.workcell.load import load_workcell


@dataclass(frozen=True)
class HandConfig:
    """Settings of the hand that guides."""

    rate: float = 50.0
    """Samples per second."""
    speed: float = 0.25
    """Mean speed of the hand [m/s]."""
    drift: float = 0.004
    """Size of the slow deviation from the intended path [m]; ten times the number in radians."""
    tremor: float = 0.0003
    """Size of the trembling at 8 Hz [m]."""
    via_error: float = 0.012
    """Standard deviation of the via points in each coordinate [m], if `care` allows as much."""
    care: float = 0.06
    """The same as a share of the distance to the nearer end; the smaller of the two counts."""


def _intended(points: list[RigidTransform], config: HandConfig, rng) -> tuple[np.ndarray, list]:
    """Times `[sample]` and poses of the intended motion: a spline, passed at an uneven speed."""
    positions = np.array([p.translation for p in points])
    end_distances = np.linalg.norm(positions[1:-1, None] - positions[[0, -1]], axis=2).min(axis=1)
    error = np.minimum(config.via_error, config.care * end_distances)[:, None]
    positions[1:-1] += error * rng.normal(size=positions[1:-1].shape)
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
    """Poses with drift and tremor, which fade towards both ends, where the hand takes care."""
    fade = np.sin(np.pi * times / times[-1])[:, None] ** 2
    waves = [(rng.uniform(0.2, 0.7), rng.uniform(0, 6.3), rng.normal(size=6)) for _ in range(3)]
    drift = sum(np.sin(2 * np.pi * f * times + p)[:, None] * a for f, p, a in waves) / np.sqrt(3)
    tremor = np.sin(2 * np.pi * 8 * times + rng.uniform(0, 6.3))[:, None] * rng.normal(size=3)
    shift = fade * (config.drift * drift[:, :3] + config.tremor * tremor)
    turns = fade * 10 * config.drift * drift[:, 3:]
    return [
        RigidTransform.from_components(p.translation + d, Rotation.from_rotvec(r) * p.rotation)
        for p, d, r in zip(poses, shift, turns, strict=True)
    ]


def guide(
    cell: Workcell, script: Script, config: HandConfig, rng: np.random.Generator, robot: str
) -> Demonstration:
    """Guide the arm through a script and record its tool.

    Args:
        cell: whose arm is guided.
        script: tool poses that the hand intends to pass.
        config: how the hand moves.
        rng: source of its noise.
        robot: kind of robot, as the recording is to say.

    Returns:
        The recording, with poses `[sample, 7]` that the arm reached, not those of the hand.
    """
    times, intended = _intended(script.points, config, rng)
    hand = _shaken(times, intended, config, rng)
    follower = Follower(cell, config.rate)
    for _ in range(200):  # bring the tool to the first pose
        follower.follow(script.points[0])
    poses = np.array([follower.follow(target) for target in hand])
    gripper = np.full(len(times), float(script.closed))
    return Demonstration(script.name, times, poses, gripper, robot=robot, note=script.note)


def record(
    cell: Workcell, robot: str, config: HandConfig = HandConfig(), seed: int = 0
) -> list[Demonstration]:
    """Guide the arm through every script once, with one recording of each."""
    rng = np.random.default_rng(seed)
    scripts = [*handling_scripts(cell), *inspection_scripts(cell)]
    return [guide(cell, script, config, rng, robot) for script in scripts]


def main(
    workcell: str,
    robot: str,
    seed: int = 0,
    out: Path | None = None,
    names: tuple[str, ...] = (),
) -> None:
    """Record the shipped demonstrations anew.

    Args:
        workcell: cell whose arm is guided and whose task the handling skills show.
        robot: kind of robot, as the recordings are to say.
        seed: seed of the hand's noise.
        out: folder to write to; the shipped one if none is given.
        names: demonstrations to write; all if none is named.
    """
    folder = out or demonstrations_folder()
    for demo in record(load_workcell(workcell), robot, seed=seed):
        if names and demo.name not in names:
            continue
        path = save_demonstration(folder, demo, replace=True)
        print(f"{demo.name}: {demo.times[-1]:.1f} s, {path}")


if __name__ == "__main__":
    tyro.cli(main)
