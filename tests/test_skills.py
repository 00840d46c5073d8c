# SPDX-License-Identifier: MIT
"""Maps, feature distances, segmentation and demonstrations."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation, Slerp

from hybrid_jax.demonstrations.filtering import POINTS
from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels import pose_paths
from hybrid_jax.runs.load_planner import read_library
from hybrid_jax.skills import mapping
from hybrid_jax.skills.costs import MAX_KEY_POSES, pad_task, segment_costs
from hybrid_jax.skills.feature_distance import beta, features
from hybrid_jax.skills.library import SkillConfig, without
from hybrid_jax.skills.matching import cut_segment, map_pieces
from hybrid_jax.skills.task_segmentation import best_plans, missing_skills, optimal_plan
from hybrid_jax.tasks.registry import random_task


@pytest.fixture(scope="module")
def library():
    return read_library()


@pytest.fixture(scope="module")
def costs(library):
    config = SkillConfig()
    return jax.jit(lambda lib, p, c, n: segment_costs(lib, p, c, n, config))


def random_pose(rng, spread=0.5, turn=1.0):
    return dq.exp(
        jnp.asarray(
            np.concatenate([rng.normal(scale=spread, size=3), rng.normal(scale=turn, size=3)]),
            jnp.float32,
        )
    )


def same(a, b, atol=2e-5):
    np.testing.assert_allclose(dq.to_matrix(a), dq.to_matrix(b), atol=atol)


BOTH = pytest.mark.parametrize("name", ["aligned", "late_exact"])
"""The maps that meet both ends."""


def double(poses):
    """Unit dual quaternions in double precision."""
    return dq.normalize(jnp.asarray(poses, jnp.float64))


@BOTH
def test_both_maps_meet_new_ends_and_keep_their_own(library, name):
    with jax.enable_x64(True):
        rng, apply = np.random.default_rng(0), jax.jit(mapping.MAPS[name])
        for demo in double(library.poses[:8]):
            start, goal = double(random_pose(rng)), double(random_pose(rng))
            mapped = apply(demo, start, goal)
            same(mapped[0], start, atol=1e-9)
            same(mapped[-1], goal, atol=1e-9)
            same(apply(demo, demo[0], demo[-1]), demo, atol=1e-9)
            same(apply(demo, -demo[0], demo[-1]), demo, atol=1e-9)


@BOTH
def test_both_maps_move_with_a_rigid_motion_of_both_ends(library, name):
    with jax.enable_x64(True):
        rng, apply = np.random.default_rng(1), jax.jit(mapping.MAPS[name])
        for demo in double(library.poses[:8]):
            start, goal, move = (double(random_pose(rng)) for _ in range(3))
            moved = apply(demo, dq.mul(move, start), dq.mul(move, goal))
            wanted = dq.mul(jnp.broadcast_to(move, demo.shape), apply(demo, start, goal))
            same(moved, wanted, atol=1e-9)


def test_the_last_quarter_of_late_exact_is_the_demonstration_seen_from_the_goal(library):
    with jax.enable_x64(True):
        rng, apply = np.random.default_rng(6), jax.jit(mapping.late_exact)
        for demo in double(library.poses[:8]):
            start, goal = double(random_pose(rng)), double(random_pose(rng))
            late = np.asarray(pose_paths.arc_phase(demo)) >= mapping.LATE
            wanted = mapping.ugp_goal(demo, start, goal)
            same(apply(demo, start, goal)[late], wanted[late], atol=1e-9)
            assert 10 < late.sum() < 50


@BOTH
def test_in_single_precision_a_micrometre_is_lost_at_most(library, name):
    rng, apply = np.random.default_rng(2), jax.jit(mapping.MAPS[name])
    for demo in library.poses[:8]:
        start, goal = random_pose(rng), random_pose(rng)
        mapped = apply(demo, start, goal)
        same(mapped[0], start, atol=3e-6)
        same(mapped[-1], goal, atol=3e-6)


def by_scipy(demo, start, goal):
    """`aligned` as its docstring says it, on SciPy's poses; `[point, 4, 4]`."""
    demo, start, goal = (
        RigidTransform.from_dual_quat(np.asarray(p, float), scalar_first=True)
        for p in (demo, start, goal)
    )
    ends = (start * demo[0].inv(), goal * demo[-1].inv())
    half = RigidTransform.from_exp_coords(0.5 * (ends[0].inv() * ends[1]).as_exp_coords())
    moved = ends[0] * half * demo
    step = (demo[:-1].inv() * demo[1:]).as_exp_coords()
    # SciPy puts the rotation first
    length = np.hypot(*(np.linalg.norm(part, axis=1) for part in (step[:, :3], step[:, 3:] / 0.1)))
    s = np.concatenate([[0], np.cumsum(length)])
    s /= s[-1]
    rest = [moved[i].rotation.inv() * end.rotation for i, end in ((0, start), (-1, goal))]
    turn = Slerp([0, 1], Rotation.concatenate(rest))(s)
    shift = [end.translation - moved[i].translation for i, end in ((0, start), (-1, goal))]
    position = moved.translation + (1 - s)[:, None] * shift[0] + s[:, None] * shift[1]
    return RigidTransform.from_components(position, moved.rotation * turn).as_matrix()


def test_aligned_is_what_its_docstring_says(library):
    with jax.enable_x64(True):
        rng, apply = np.random.default_rng(5), jax.jit(mapping.aligned)
        for demo in double(library.poses[:6]):
            ends = [double(random_pose(rng)) for _ in range(2)]
            found = dq.to_matrix(apply(demo, *ends))
            np.testing.assert_allclose(found, by_scipy(demo, *ends), atol=1e-7)


def test_all_skills_are_mapped_to_all_segments_at_once(library):
    rng = np.random.default_rng(6)
    skills, starts, goals = (
        library.poses[:3],
        *(jnp.stack([random_pose(rng) for _ in range(4)]) for _ in range(2)),
    )
    for name, one in mapping.MAPS.items():
        mapped = jax.jit(lambda *a, name=name: mapping.map_skills(*a, name))(skills, starts, goals)
        assert mapped.shape == (3, 4, POINTS, 8)
        same(mapped[2, 3], one(skills[2], starts[3], goals[3]))


def test_literal_map_enforces_the_feature(library):
    rng = np.random.default_rng(2)
    demo, goal = library.poses[3], random_pose(rng)
    mapped = mapping.ugp_goal(demo, random_pose(rng), goal)
    same(features(mapped), features(demo), atol=1e-4)
    blended = mapping.ugp_blend(demo, start := random_pose(rng), goal)
    same(blended[0], start)
    same(blended[-1], goal)


def test_beta_is_symmetric_invariant_and_in_metres():
    rng = np.random.default_rng(3)
    a, b, g = (random_pose(rng, 0.1, 0.3) for _ in range(3))
    assert beta(dq.mul(g, a), dq.mul(g, b)) == pytest.approx(float(beta(a, b)), abs=1e-5)
    assert beta(a, b) == pytest.approx(float(beta(b, -a)), abs=1e-5)
    shifted = dq.mul(a, dq.from_parts(jnp.array([0.2, 0, 0]), jnp.array([1.0, 0, 0, 0])))
    assert beta(a, shifted) == pytest.approx(0.2, abs=1e-5)


def test_beta_is_the_size_of_the_screw():
    """Small turns and large ones, against the logarithm in double precision."""
    rng = np.random.default_rng(4)
    with jax.enable_x64(True):
        for turn in (0.0, 1e-6, 1e-3, 0.3, 1.0, 2.0):
            a, b = (double(random_pose(rng, 0.3, turn)) for _ in range(2))
            screw = dq.log(dq.mul(dq.conj(a), b))
            wanted = np.sqrt(np.sum(screw[:3] ** 2) + 0.3**2 * np.sum(screw[3:] ** 2))
            assert beta(a, b) == pytest.approx(wanted, rel=1e-6)
            low = (jnp.asarray(pose, jnp.float32) for pose in (a, b))
            assert beta(*low) == pytest.approx(wanted, rel=1e-4)


def brute_force(cost, count):
    """Cheapest plan over all segmentations and skills."""
    best = np.inf
    for cuts in itertools.product([False, True], repeat=count - 2):
        at = [0] + [i + 1 for i, cut in enumerate(cuts) if cut] + [count - 1]
        best = min(best, sum(cost[a, b].min() for a, b in itertools.pairwise(at)))
    return best


def test_shortest_path_equals_brute_force():
    rng = np.random.default_rng(4)
    for _ in range(100):
        cost = rng.uniform(0, 1, (6, 6, 3))
        cost[rng.uniform(size=cost.shape) < 0.7] = np.inf
        plan, total = optimal_plan(cost, 6)
        assert total == pytest.approx(brute_force(cost, 6))
        if plan:
            assert sum(cost[a, b, k] for a, b, k in plan) == pytest.approx(total)
            assert [p[0] for p in plan][1:] == [p[1] for p in plan][:-1]


def test_unit_segment_cost_is_the_distance_of_start_to_goal_features(cell, library, costs):
    poses, carrying, count = pad_task(random_task(cell, 1))
    found = costs(library, poses, carrying, count)
    skill = library.names.index("lift")
    demo, task = library.poses[skill], jnp.asarray(poses)
    wanted = beta(dq.mul(dq.conj(demo[0]), demo[-1]), dq.mul(dq.conj(task[1]), task[2]))
    assert found.nearest[1, 2, skill] == pytest.approx(float(wanted), abs=1e-5)
    assert np.isinf(np.asarray(found.cost)[0, 1, skill]), (
        "the gripper is open on the way to the grasp"
    )
    assert np.isinf(np.asarray(found.cost)[count:]).all()


def test_random_tasks_are_covered_and_missing_demonstrations_are_named(cell, library, costs):
    tolerance = SkillConfig().tolerance
    transfers = {n for n in library.names if n.startswith(("transfer", "carry"))}
    for seed in range(5):
        poses, carrying, count = pad_task(random_task(cell, seed))
        found = jax.device_get(costs(library, poses, carrying, count))
        assert optimal_plan(found.cost, count)[0]
        less = jax.device_get(costs(without(library, transfers), poses, carrying, count))
        assert optimal_plan(less.cost, count)[0] == []
        missing = missing_skills(less.cost, less.nearest, count, library.names, tolerance)
        assert [(m.start, m.end) for m in missing] == [(2, 3)]
        assert missing[0].distance > tolerance


def test_best_plans_are_those_of_brute_force():
    rng = np.random.default_rng(0)
    for count in (2, 3, 5):
        cost = rng.uniform(0, 1, (count, count, 3))
        cost[rng.uniform(size=cost.shape) < 0.4] = np.inf
        every = []
        for cuts in itertools.product((False, True), repeat=count - 2):
            stops = [0, *(i + 1 for i, cut in enumerate(cuts) if cut), count - 1]
            spans = list(zip(stops[:-1], stops[1:], strict=True))
            for skills in itertools.product(range(3), repeat=len(spans)):
                total = sum(cost[a, b, k] for (a, b), k in zip(spans, skills, strict=True))
                if np.isfinite(total):
                    every.append(total)
        found = best_plans(cost, count, 4)
        totals = [sum(cost[step] for step in plan) for plan in found]
        np.testing.assert_allclose(totals, sorted(every)[:4])
        if found:
            assert found[0] == optimal_plan(cost, count)[0]


def test_a_skill_over_several_segments_meets_each_key_pose(cell, library):
    task = random_task(cell, 3)
    poses, _, _ = pad_task(task)
    skill = library.names.index("carry_block")
    pieces = cut_segment(library, poses, 1, 4, skill, SkillConfig())
    mapped = map_pieces(library, pieces, SkillConfig(), 50)
    assert mapped.shape == (3, 50, 8)
    mapped = mapped.reshape(150, 8)
    for point, pose in ((0, 1), (49, 2), (99, 3), (149, 4)):
        same(jnp.asarray(mapped[point]), jnp.asarray(poses[pose]), atol=1e-4)


def test_paper_map_on_real_demonstrations(shared):
    """Held-out error of the maps on real kinesthetic demonstrations, as measured before."""
    apply = {name: jax.jit(jax.vmap(mapping.MAPS[name])) for name in ("aligned", "ugp_blend")}
    errors = {name: [] for name in apply}
    folder = shared / "data" / "robotasks"
    if not folder.is_dir():
        pytest.skip("real demonstrations are absent")
    spaced = jax.jit(pose_paths.resample, static_argnames="count")
    for file in sorted(folder.glob("*.npz")):
        raw = jnp.asarray(np.load(file)["poses"])
        demos = jnp.stack([spaced(dq.from_parts(p[:, :3], p[:, 3:]), 101) for p in raw])
        pairs = np.array(list(itertools.permutations(range(len(demos)), 2)))
        for name, run in apply.items():
            wanted = demos[pairs[:, 1]]
            mapped = run(demos[pairs[:, 0]], wanted[:, 0], wanted[:, -1])
            gap = jnp.linalg.norm(dq.position(mapped) - dq.position(wanted), axis=-1)
            errors[name].append(float(gap.mean()))
    assert np.mean(errors["aligned"]) < 0.03
    assert np.mean(errors["aligned"]) < np.mean(errors["ugp_blend"])


def test_library_padding(library):
    assert int(library.valid.sum()) == len(library.names) <= 32
    assert library.poses.shape[1:] == (POINTS, 8) and MAX_KEY_POSES == 8
