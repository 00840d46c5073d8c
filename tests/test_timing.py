# SPDX-License-Identifier: MIT
"""Speeds along a path against the reference implementation of TOPP-RA, and against the limits."""

import numpy as np
import pytest
import toppra
import toppra.algorithm
import toppra.constraint

from hybrid_jax.errors import InputError
from hybrid_jax.planner.path_parameterization import BLOCK, fastest_speeds
from hybrid_jax.planner.timing import TimingConfig, time_parameterize

toppra.setup_logging("ERROR")
POINTS = 120


def random_path(seed: int, joints: int = 4) -> toppra.SplineInterpolator:
    """A spline through a few random configurations; some joints rest on some stretches."""
    rng = np.random.default_rng(seed)
    way = rng.normal(0, 1, (6, joints))
    way[2:4, 0] = way[2, 0]
    knots = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1))])
    return toppra.SplineInterpolator(knots, way)


def duration(grid: np.ndarray, squared: np.ndarray) -> float:
    speed = np.sqrt(squared)
    return float(np.sum(2 * np.diff(grid) / (speed[1:] + speed[:-1])))


@pytest.mark.parametrize("points", [POINTS, 3 * BLOCK])  # within a block, and over several
@pytest.mark.parametrize("seed", range(6))
def test_speeds_are_those_of_toppra(seed, points):
    path, rng = random_path(seed), np.random.default_rng(100 + seed)
    speed, rate = rng.uniform(0.5, 2, 4), rng.uniform(0.5, 5, 4)
    grid = np.linspace(0, path.duration, points)
    limits = [
        toppra.constraint.JointVelocityConstraint(np.stack([-speed, speed], 1)),
        toppra.constraint.JointAccelerationConstraint(np.stack([-rate, rate], 1)),
    ]
    wanted = toppra.algorithm.TOPPRA(limits, path, gridpoints=grid).compute_parameterization(0, 0)
    padded = np.concatenate([grid, grid[-1:].repeat(8)])
    rows = (
        path(padded, 1),
        path(padded, 2),
        np.diff(padded, append=padded[-1]),
        *(np.tile(limit, (len(padded), 1)) for limit in (speed, rate)),
        np.full(len(padded), 1e9),
    )
    found = fastest_speeds(*(a[None].astype(np.float32) for a in rows))[0].astype(float)
    assert found.shape == padded.shape and (found[points - 1 :] == 0).all(), "ends at rest"
    found = found[:points]
    push = np.diff(found) / (2 * np.diff(grid))
    for at in (slice(0, -1), slice(1, None)):
        both = path(grid[at], 1) * push[:, None] + path(grid[at], 2) * found[at, None]
        assert (np.abs(both) <= rate * 1.001).all()
    assert (np.abs(path(grid, 1)) * np.sqrt(found)[:, None] <= speed * 1.001).all()
    ratio = duration(grid, found) / duration(grid, np.asarray(wanted[1]) ** 2)
    # the solver of toppra stops a little short of the optimum where limits meet
    assert 0.99 < ratio < 1.002


def test_paths_of_any_length_are_timed_together(cell):
    rng, home = np.random.default_rng(0), np.asarray(cell.home, float)
    config = TimingConfig()
    paths = []
    for count in (2, 3, 40, 300):
        q = home + np.cumsum(rng.normal(0, 0.01, (count, home.size)), axis=0)
        paths.append((q, np.arange(count) % 3))
    found = time_parameterize(cell, paths, config)
    assert found[0] is None, "two points make no smooth motion from rest to rest"
    speed = config.speed * np.asarray(cell.velocity_limits)
    rate = config.acceleration * np.asarray(cell.chain.acceleration_limits)
    for (q, _), motion in zip(paths[1:], found[1:], strict=True):
        assert np.allclose(motion.positions[[0, -1]], q[[0, -1]], atol=1e-6)
        assert np.allclose(motion.velocities[[0, -1]], 0, atol=1e-5)
        assert (np.abs(motion.velocities) <= speed * 1.0001).all()
        assert (np.abs(motion.accelerations) <= rate * 1.0001).all()
        alone = time_parameterize(cell, [(q, np.zeros(len(q)))], config)[0]
        assert np.isclose(alone.times[-1], motion.times[-1], rtol=1e-5)


def jerk_of(motion) -> float:
    """Largest jerk of a motion, from rest to rest, by differences of its points."""
    q = np.pad(motion.positions, [(3, 3), (0, 0)], mode="edge")
    return float(np.abs(np.diff(q, 3, axis=0)).max() / (motion.times[1] - motion.times[0]) ** 3)


@pytest.mark.parametrize("jerk", [10.0, 15.0])
def test_a_limit_of_the_jerk_is_kept_at_little_cost(cell, jerk):
    home = np.asarray(cell.home, float)
    share = np.linspace(0, 1, 80)[:, None]
    q = home + 0.4 * np.sin(4 * share + np.arange(home.size)) - 0.4 * np.sin(np.arange(home.size))
    free, kept = (
        time_parameterize(cell, [(q, np.zeros(80, int))], TimingConfig(jerk=limit))[0]
        for limit in (None, jerk)
    )
    before, found = jerk_of(free), jerk_of(kept)
    assert found <= jerk * 1.1
    assert before > 3 * jerk, "the limit asks for something"
    # a motion that is only slowed down lasts the cube root of the excess times as long
    slowed = free.times[-1] * np.cbrt(before / jerk)
    assert free.times[-1] < kept.times[-1] < 0.8 * slowed
    assert np.allclose(kept.positions[[0, -1]], q[[0, -1]], atol=1e-6)
    # the path itself is not left
    for point in kept.positions[:: len(kept.positions) // 10]:
        assert np.abs(q - point).max(axis=1).min() < 0.03


@pytest.mark.parametrize("seed", range(4))
def test_motions_are_slowed_where_it_is_needed_only(cell, seed):
    """Through few random points: at most a hundredth longer than the optimum on a fine grid."""
    q = np.random.default_rng(seed).uniform(-2, 2, (5, 7))
    chain = cell.chain.replace(velocity_limits=np.ones(7), acceleration_limits=5 * np.ones(7))
    whole = TimingConfig(speed=1.0, acceleration=1.0)
    motion = time_parameterize(cell.replace(chain=chain), [(q, np.zeros(5, int))], whole)[0]
    knots = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(q, axis=0), axis=1))])
    limits = [
        kind(np.stack([-np.full(7, most), np.full(7, most)], 1))
        for kind, most in (
            (toppra.constraint.JointVelocityConstraint, 1.0),
            (toppra.constraint.JointAccelerationConstraint, 5.0),
        )
    ]
    path, grid = toppra.SplineInterpolator(knots, q), np.linspace(0, knots[-1], 3000)
    best = toppra.algorithm.TOPPRA(limits, path, gridpoints=grid).compute_parameterization(0, 0)
    assert 0.999 < motion.times[-1] / duration(grid, np.asarray(best[1]) ** 2) < 1.01
    for p in q:  # and its shape is that of the path
        assert np.abs(motion.positions - p).max(axis=1).min() < 0.01


def test_both_ends_are_at_rest_and_few_samples_keep_the_shape(cell):
    q = np.asarray(cell.home) + np.linspace(0, 1, 12)[:, None] ** 2 * np.sin(np.arange(7))
    for period in (0.002, 0.01, 10.0):
        config = TimingConfig(sample_time=period)
        motion = time_parameterize(cell, [(q, np.zeros(12, int))], config)[0]
        assert len(motion.times) >= 12 and np.diff(motion.times).max() <= period + 1e-9
        assert not motion.velocities[[0, -1]].any() and not motion.accelerations[[0, -1]].any()
        assert np.isclose(1e3 * motion.times[-1], np.round(1e3 * motion.times[-1]))


def test_limits_that_make_a_motion_last_for_years_are_named(cell):
    chain = cell.chain.replace(velocity_limits=np.full(7, 1e-8))
    q = np.asarray(cell.home) + np.linspace(0, 1, 12)[:, None] * np.ones(7)
    with pytest.raises(InputError, match="would last .* limits of a joint are too small"):
        time_parameterize(cell.replace(chain=chain), [(q, np.zeros(12, int))], TimingConfig())
