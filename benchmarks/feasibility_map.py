# SPDX-License-Identifier: MIT
"""The feasibility map of the handling cell: speed, what it finds, and against an exhaustive oracle.

The oracle solves each pose from 64 random seeds; C MuJoCo checks pose, limits and contacts of
every solution. The same engine checks the configurations that the map calls feasible.
"""

import time
from dataclasses import dataclass, replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from scipy.spatial.transform import Rotation

from benchmarks import rivals
from benchmarks.kernels import CELL, configurations
from benchmarks.report import metric, rate, write
from hybrid_jax.feasibility.building import FeasibilityMap, build_feasibility_map
from hybrid_jax.feasibility.evaluation import Reason
from hybrid_jax.feasibility.grid import MapConfig, poses_at
from hybrid_jax.feasibility.lookup import query
from hybrid_jax.ik import IkConfig, solve_ik
from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels.kinematics import manipulability, tool_pose
from hybrid_jax.reports.map_picture import draw_map
from hybrid_jax.runtime.devices import Spread, use_all_cores
from hybrid_jax.runtime.progress import Progress
from hybrid_jax.workcell.load import load_workcell

GRID = MapConfig(lower=(0.0, -0.6, 0.0), upper=(0.95, 0.55, 0.75), spacing=0.05, orientations=521)
"""The paper's task range, 1.0 x 1.2 x 0.8 m: 20 x 24 x 16 voxels, 4,001,280 poses."""
ORACLE = IkConfig(seeds=64, iterations=60)


@dataclass(frozen=True)
class Sizes:
    """How much is measured."""

    grid: MapConfig = GRID
    oracle: int = 2000
    """Poses that the oracle judges, ..."""
    reachable: int = 2000
    """... that IK must find, ..."""
    bullet: int = 5000
    """... that PyBullet solves ..."""
    mink: int = 300
    """... and mink."""


TINY = Sizes(replace(GRID, spacing=0.4, orientations=2), 10, 10, 10, 5)
DEEPEST = -1e-4
"""A contact less deep than this is none: float32 and the engine differ by as much [m]."""


class Checker:
    """C MuJoCo's verdict on a configuration."""

    def __init__(self, cell):
        self.engine = rivals.Engine(cell)
        self.limits = np.asarray(cell.joint_limits, float)

    def reaches(self, q, position, quat) -> bool:
        """Within 1 mm and 0.5 deg, and within the limits."""
        engine = self.engine
        engine.place(q)
        site = engine.data.site_xmat[engine.site].reshape(3, 3)
        turn = Rotation.from_matrix(site) * Rotation.from_quat(quat, scalar_first=True).inv()
        near = np.linalg.norm(engine.data.site_xpos[engine.site] - position) <= 1e-3
        inside = np.all((q >= self.limits[:, 0] - 1e-6) & (q <= self.limits[:, 1] + 1e-6))
        return bool(near and inside and turn.magnitude() <= np.deg2rad(0.5))

    def free(self, q) -> bool:
        return self.engine.deepest(q) > DEEPEST


def oracle_best(cell, spread, check: Checker, positions, quats) -> np.ndarray:
    """Largest manipulability of free configurations that many random seeds lead to; 0 for none."""
    poses = dq.from_parts(jnp.asarray(positions), jnp.asarray(quats))
    keys = jax.random.split(jax.random.key(7), len(poses))

    def branches(cell, pose, key):
        found = solve_ik(cell, pose, config=ORACLE, key=key)
        man = jax.vmap(manipulability, (None, 0))(cell, found.branches)
        return found.branches, jnp.where(found.branch_found, man, 0.0)

    solve = spread.over(branches, 2)
    shared, best = spread.share(cell), []
    for start in range(0, len(poses), 200):
        some = slice(start, start + 200)
        q, man = solve(shared, spread.split(poses[some]), spread.split(keys[some]))
        rows = zip(np.asarray(q, float), np.asarray(man), positions[some], quats[some], strict=True)
        for ends, worth, p, r in rows:
            # the most manipulable first: the first that is good is the best
            ranked = (i for i in np.argsort(-worth) if worth[i] > 0)
            good = (i for i in ranked if check.reaches(ends[i], p, r) and check.free(ends[i]))
            best.append(next((float(worth[i]) for i in good), 0.0))
    return np.array(best)


def against_oracle(cell, spread, fmap: FeasibilityMap, sizes: Sizes) -> dict[str, float]:
    """Agreement with the oracle on random poses of the grid, and the feasible ones that fail."""
    rng = np.random.default_rng(11)
    grid = sizes.grid
    index = rng.choice(grid.size, sizes.oracle, replace=False)
    positions, quats = poses_at(grid, index)
    ours = np.asarray(fmap.reason).ravel()[index] == Reason.FEASIBLE
    q = np.asarray(fmap.configuration).reshape(grid.size, -1)[index].astype(float)
    check = Checker(cell)
    fea = np.asarray(fmap.feasibility).ravel()[index]
    best = oracle_best(cell, spread, check, positions, quats) / float(fmap.manipulability_scale)
    oracle = best >= grid.least_manipulability
    both = ours & oracle
    verified = np.array(
        [
            bool(mine and check.reaches(x, p, r) and check.free(x))
            for mine, x, p, r in zip(ours, q, positions, quats, strict=True)
        ]
    )
    return {
        "agreement": float(np.mean(ours == oracle)),
        "false": float(np.mean(ours & ~verified)),
        "missed": float(np.mean(~ours & oracle)),
        "beyond": float(np.mean(verified & ~oracle)),
        "feasible": float(np.mean(ours)),
        "fea": float(fea[both].sum() / np.clip(best[both], 0, 1).sum()) if both.any() else 1.0,
    }


def reachable_found(cell, spread, count: int) -> tuple[float, float]:
    """Share of provably reachable, collision-free poses that IK solves free; and its rate."""
    check = Checker(cell)
    q = configurations(cell, 4 * count, seed=5)
    q = np.array([row for row in q if check.free(row)])[:count]
    poses = np.asarray(jax.vmap(tool_pose, (None, 0))(cell, jnp.asarray(q)))
    config = IkConfig(seeds=32, iterations=50, clearance=1e-4)
    solve = spread.over(lambda cell, pose, key: solve_ik(cell, pose, config=config, key=key), 2)
    keys = jax.random.split(jax.random.key(3), len(q))
    shared = spread.share(cell)
    items = spread.split(poses), spread.split(keys)
    speed, _ = rate(lambda: solve(shared, *items).q, len(q))
    answers = np.asarray(solve(shared, *items).q, float)
    places, turns = np.asarray(dq.position(jnp.asarray(poses))), poses[:, :4]
    good = [
        check.reaches(x, p, r) and check.free(x)
        for x, p, r in zip(answers, places, turns, strict=True)
    ]
    return float(np.mean(good)), speed


def bullet_rate(cell, sizes: Sizes) -> tuple[float, ...] | None:
    """Poses per second of IK and collision in PyBullet, with the shares solved and feasible."""
    bullet = rivals.bullet(cell)
    if not bullet:
        return None
    index = np.random.default_rng(2).choice(sizes.grid.size, sizes.bullet, replace=False)
    positions, quats = poses_at(sizes.grid, index)
    turns = quats[:, [1, 2, 3, 0]].astype(float)
    began = time.perf_counter()
    verdicts = [bullet.judge(p, r) for p, r in zip(positions.astype(float), turns, strict=True)]
    seconds = time.perf_counter() - began
    return len(index) / seconds, *np.mean(verdicts, axis=0)


def main(json: Path | None = None, picture: Path | None = None, tiny: bool = False) -> None:
    """Measure and print; write JSON and the map's picture if asked to.

    Args:
        json: file for the figures.
        picture: PNG for the map.
        tiny: as little of everything as shows that it runs.
    """
    use_all_cores()
    sizes = TINY if tiny else Sizes()
    grid = sizes.grid
    cell, spread = load_workcell(CELL), Spread()
    began = time.perf_counter()
    build_feasibility_map(cell, MapConfig(spacing=0.4, orientations=2))
    compiled = time.perf_counter() - began
    rival = bullet_rate(cell, sizes)
    began = time.perf_counter()
    fmap = build_feasibility_map(cell, grid, progress=Progress("map", "poses"))
    seconds = time.perf_counter() - began
    if picture:
        draw_map(picture, cell, fmap)
    usual = MapConfig(spacing=0.4) if tiny else MapConfig()
    began = time.perf_counter()
    build_feasibility_map(cell, usual)
    cell_seconds = time.perf_counter() - began
    speed, scale = grid.size / seconds, 4e6 / grid.size
    result = against_oracle(cell, spread, fmap, sizes)
    found, ik_rate = reachable_found(cell, spread, sizes.reachable)
    poses = jnp.asarray(
        np.asarray(jax.vmap(tool_pose, (None, 0))(cell, configurations(cell, 4096)))
    )
    ask = jax.jit(jax.vmap(query, (None, 0)))
    asked, _ = rate(lambda: ask(fmap, poses), len(poses))
    figures = [
        metric("map.compile", compiled, "s", "lower", "a map of a few poses, all programs"),
        metric("map.cell_seconds", cell_seconds, "s", "lower", f"{usual.size} poses, default"),
        metric("map.seconds_4m", seconds * scale, "s", "lower", f"{grid.size} poses"),
        metric("map.poses", speed, "1/s", "higher", f"{len(spread.devices)} devices"),
        metric("map.feasible_share", result["feasible"], "1", "higher", "of the oracle's poses"),
        metric(
            "map.oracle_agreement",
            result["agreement"],
            "1",
            "higher",
            f"{sizes.oracle} poses, 64 seeds",
        ),
        metric("map.false_feasible", result["false"], "1", "lower", "C MuJoCo refuses it"),
        metric("map.missed", result["missed"], "1", "lower", "the oracle found a way"),
        metric(
            "map.beyond_oracle",
            result["beyond"],
            "1",
            "higher",
            "verified, and the oracle found none",
        ),
        metric(
            "map.ik_found", found, "1", "higher", f"of {sizes.reachable} poses, {ik_rate:.0f}/s"
        ),
        metric("map.fea_of_oracle", result["fea"], "1", "higher", "of the best of its solutions"),
        metric("map.query", 1e6 / asked, "us", "lower", "each, in a batch of 4096"),
    ]
    if rival:
        # before and after: a slow minute is not the rival's
        rival = max(rival, bullet_rate(cell, sizes))
        note = f"one seed; solves {rival[1]:.3f}, calls {rival[2]:.3f} feasible"
        figures.append(metric("map.pybullet", rival[0], "1/s", "higher", note))
        figures.append(metric("map.poses_vs_pybullet", speed / rival[0], "1", "higher"))
    index = np.random.default_rng(2).choice(grid.size, sizes.mink, replace=False)
    positions, quats = poses_at(grid, index)
    solved, mink_speed = rivals.mink_solves(cell, positions, quats)
    figures.append(
        metric("map.mink", mink_speed, "1/s", "higher", f"IK alone, one seed; solves {solved:.3f}")
    )
    write(figures, json)


if __name__ == "__main__":
    tyro.cli(main)
