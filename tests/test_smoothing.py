# SPDX-License-Identifier: MIT
"""Shortcuts and smoothing of many paths at once, among discs in the plane instead of a cell."""

import numpy as np
import pytest

from hybrid_jax.kernels.collision.motion_validation import measure_some
from hybrid_jax.planner.shortcutting import shortcut_paths
from hybrid_jax.planner.smoothing import SmoothingConfig, smooth_paths

DISCS = np.array([[0.5, 0.5, 0.3], [0.2, 0.9, 0.15], [5.0, 5.0, 0.1]])
"""Centre and radius of the one disc in the world of each path."""
CONFIG = SmoothingConfig(shortcut_rounds=4)
MARGIN = CONFIG.margin


def clearances(path, q, enough):
    """Of points `[n, 2]`, each in the world of its path; in single precision, as kernels answer."""
    disc = DISCS[path]
    gaps = np.linalg.norm(q - disc[:, :2], axis=1) - disc[:, 2]
    return np.minimum(gaps.astype(np.float32), np.float32(enough))


def corner():
    """Around the first disc from one corner of the unit square to another."""
    return np.array([[0.0, 0.0], [0.0, 1.1], [1.0, 1.1], [1.0, 0.9]])


@pytest.fixture
def paths():
    zigzag = np.stack([np.linspace(0, 2, 9), 0.3 * (np.arange(9) % 2)], axis=1)
    return [corner(), corner() + [0.4, 0.0], zigzag]


def way(q):
    return np.linalg.norm(np.diff(q, axis=0), axis=1).sum()


def test_shortcuts_are_shorter_and_keep_the_margin(paths):
    short = shortcut_paths(clearances, paths, MARGIN, CONFIG)
    for number, (before, after) in enumerate(zip(paths, short, strict=True)):
        np.testing.assert_array_equal(after[[0, -1]], before[[0, -1]])
        assert way(after) < 0.9 * way(before)
        steps = np.linspace(0, len(after) - 1, 400)
        low = np.minimum(steps.astype(int), len(after) - 2)
        fine = after[low] + (steps - low)[:, None] * (after[low + 1] - after[low])
        assert clearances(np.full(400, number), fine, 1.0).min() > 0


def test_the_edge_that_saves_most_of_those_that_are_free_is_taken(paths):
    """Against one that looks at every point of every edge."""
    config = SmoothingConfig(shortcut_rounds=1)
    asked = []

    def counted(path, q, enough):
        asked.append(len(q))
        return clearances(path, q, enough)

    ours = shortcut_paths(counted, paths, MARGIN, config)
    for number, q in enumerate(paths):
        best = brute_force(number, q, config)
        np.testing.assert_allclose(way(ours[number]), best, atol=1e-9)
    assert sum(asked) < len(paths) * config.checked * config.fine / 2


def brute_force(number, q, config):
    """Length of the path after the same draws, by a check of all edges at all points."""
    q = shortcut_paths(clearances, [q], MARGIN, SmoothingConfig(shortcut_rounds=0))[0]
    pairs = np.sort(np.random.default_rng(0).integers(0, len(q), (config.shortcuts, 2)), axis=1)
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(q, axis=0), axis=1))])
    gains = []
    for a, b in pairs:
        share = np.arange(1, config.fine + 1)[:, None] / config.fine
        points = q[a] + share * (q[b] - q[a])
        gain = length[b] - length[a] - np.linalg.norm(q[b] - q[a])
        free = (clearances(np.full(len(points), number), points, 1.0) >= MARGIN).all()
        gains.append((gain, free))
    tried = sorted(gains, key=lambda one: -one[0])[: config.checked]
    return length[-1] - max([gain for gain, free in tried if free], default=0.0)


def test_paths_together_are_treated_as_each_alone(paths):
    marks = [np.ones(len(q), np.uint8) for q in paths]
    short = shortcut_paths(clearances, paths, MARGIN, CONFIG)
    smooth = smooth_paths(clearances, list(zip(paths, marks, strict=True)), CONFIG)
    for number, (q, mark) in enumerate(zip(paths, marks, strict=True)):
        own = measure_some(clearances, np.array([number]))
        np.testing.assert_array_equal(short[number], shortcut_paths(own, [q], MARGIN, CONFIG)[0])
        alone, together = smooth_paths(own, [(q, mark)], CONFIG)[0], smooth[number]
        assert alone is not None and together is not None
        np.testing.assert_array_equal(together[0], alone[0])
        np.testing.assert_array_equal(together[0][[0, -1]], q[[0, -1]])


def test_what_keeps_no_margin_is_not_smoothed():
    through = np.array([[0.0, 0.0], [0.5, 0.5], [1.0, 1.0]])
    beside = through + [5.0, 0.0]
    marks = np.ones(3, np.uint8)
    blocked, free = smooth_paths(
        lambda path, q, enough: clearances(np.zeros_like(path), q, enough),
        [(through, marks), (beside, marks)],
        CONFIG,
    )
    assert blocked is None and free is not None


@pytest.mark.parametrize("fine", [1, 2, 3])
def test_few_points_of_an_edge_are_enough_to_ask_for(paths, fine):
    config = SmoothingConfig(fine=fine)
    assert len(shortcut_paths(clearances, paths, MARGIN, config)) == len(paths)


@pytest.mark.parametrize("margin", [0.002, 0.005, 0.01, 0.02, 0.04])
def test_every_margin_can_be_kept(margin):
    """Single precision rounds some margins down, and clearances end at the margin."""
    far = np.array([[3.0, 0.0], [4.0, 0.5], [4.0, 1.5]])
    config = SmoothingConfig(margin=margin)
    assert smooth_paths(clearances, [(far, np.zeros(3, np.uint8))], config)[0] is not None


def test_a_way_point_beside_a_bridge_is_still_met():
    """As a key pose is: widely rounded, the path would miss it; smoothness and ends stay."""
    far = np.array([[3.0, 0.0], [4.0, 0.0], [4.0, 1.0], [3.0, 1.0]])
    marks, elsewhere = np.ones(4, np.uint8), np.array([[9.0, 9.0]])
    missed, met, same = (
        smooth_paths(clearances, [(far, marks)], CONFIG, through)[0][0]
        for through in ((), [far[1:3]], [elsewhere])
    )
    apart = lambda path: np.linalg.norm(path[:, None] - far[1:3], axis=2).min(axis=0)  # noqa: E731
    assert apart(missed).min() > 0.05 and apart(met).max() < 0.005
    np.testing.assert_array_equal(same, missed)
    np.testing.assert_array_equal(met[[0, -1]], far[[0, -1]])
    bend = lambda path: np.linalg.norm(np.diff(path, n=2, axis=0), axis=1).max()  # noqa: E731
    sharp = smooth_paths(clearances, [(far, marks)], SmoothingConfig(widths=(0.0,)))[0][0]
    assert bend(met) < 0.5 * bend(sharp)
