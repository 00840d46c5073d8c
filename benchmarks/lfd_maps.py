# SPDX-License-Identifier: MIT
"""Carry each real demonstration to the ends of every other one of its task: how far off is it?"""

import itertools
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.report import metric
from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels.pose_paths import resample
from hybrid_jax.skills.mapping import MAPS

POINTS = 101
WEIGHTS = 50
"""Basis functions of the DMP for each dimension."""

Demos = dict[str, np.ndarray]
"""Dual quaternions `[demo, 101, 8]` by task."""

_spaced = jax.jit(jax.vmap(lambda poses: resample(poses, POINTS)))


def load_demonstrations(folder: Path) -> Demos:
    """The demonstrations of every task, evenly spaced by arc length."""
    tasks = {}
    for file in sorted(folder.glob("*.npz")):
        raw = jnp.asarray(np.load(file)["poses"])
        tasks[file.stem] = np.asarray(_spaced(dq.from_parts(raw[..., :3], raw[..., 3:])))
    return tasks


def rows(poses: np.ndarray) -> np.ndarray:
    """Positions and quaternions `[.., 7]` of dual quaternions."""
    return np.concatenate([np.asarray(dq.position(jnp.asarray(poses))), poses[..., :4]], axis=-1)


def errors(found: np.ndarray, wanted: np.ndarray) -> tuple[float, float]:
    """Mean distance [cm] and angle [deg] of two paths `[point, 7]`."""
    gap = np.linalg.norm(found[:, :3] - wanted[:, :3], axis=1)
    a, b = (Rotation.from_quat(path[:, 3:], scalar_first=True) for path in (found, wanted))
    return 100 * float(gap.mean()), float(np.rad2deg((a * b.inv()).magnitude().mean()))


def dmp_path(demo: np.ndarray, start: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """What CartesianDMP, trained on one demonstration `[101, 7]`, makes of new ends."""
    from movement_primitives.dmp import CartesianDMP

    dmp = CartesianDMP(
        execution_time=1.0, dt=1 / (POINTS - 1), n_weights_per_dim=WEIGHTS, smooth_scaling=True
    )
    dmp.imitate(np.linspace(0, 1, POINTS), demo)
    dmp.configure(start_y=start, goal_y=goal)
    return dmp.open_loop()[1]


def dmp_errors(demos: np.ndarray, pairs: list[tuple[int, int]]) -> np.ndarray:
    """Errors `[pair, 2]` of the DMP, its paths spaced by arc length as the others."""
    seven = rows(demos).astype(float)
    paths = np.stack([dmp_path(seven[i], seven[j, 0], seven[j, -1]) for i, j in pairs])
    dual = dq.from_parts(jnp.asarray(paths[..., :3]), jnp.asarray(paths[..., 3:]))
    spaced = rows(np.asarray(_spaced(dual.astype(jnp.float32))))
    return np.array([errors(p, seven[j]) for p, (_, j) in zip(spaced, pairs, strict=True)])


def map_errors(name: str, demos: np.ndarray, pairs: list[tuple[int, int]]) -> np.ndarray:
    """Errors `[pair, 2]` of one of our maps."""
    first, second = (jnp.asarray(demos[list(column)]) for column in zip(*pairs, strict=True))
    mapped = jax.jit(jax.vmap(MAPS[name]))(first, second[:, 0], second[:, -1])
    spaced, seven = rows(np.asarray(_spaced(mapped))), rows(demos)
    return np.array([errors(p, seven[j]) for p, (_, j) in zip(spaced, pairs, strict=True)])


def figures(demos: Demos) -> list[dict]:
    """Mean errors over all ordered pairs of all tasks, ours and the DMP's."""
    found: dict[str, list] = {name: [] for name in (*MAPS, "dmp")}
    for paths in demos.values():
        pairs = list(itertools.permutations(range(len(paths)), 2))
        for name in MAPS:
            found[name].append(map_errors(name, paths, pairs))
        found["dmp"].append(dmp_errors(paths, pairs))
    mean = {name: np.concatenate(parts).mean(axis=0) for name, parts in found.items()}
    pairs = sum(len(part) for part in found["dmp"])
    out = []
    for axis, (what, unit) in enumerate((("position", "cm"), ("rotation", "deg"))):
        out += [
            metric(f"lfd.{what}_error_{name}", float(value[axis]), unit, "lower", f"{pairs} pairs")
            for name, value in mean.items()
        ]
        ratio = float(mean["aligned"][axis] / mean["dmp"][axis])
        out.append(metric(f"lfd.{what}_error_vs_dmp", ratio, "1", "lower", "aligned over the DMP"))
    return out
