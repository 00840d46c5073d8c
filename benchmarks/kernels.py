# SPDX-License-Identifier: MIT
"""Kernels on the handling cell, beside C MuJoCo, MJX and PyBullet in the same run."""

import functools
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import tyro

from benchmarks import rivals
from benchmarks.mjx_rival import CELL, MJX_FLAGS, mjx_in_its_process
from benchmarks.report import metric, race, rate, write
from hybrid_jax.ik import solve_ik
from hybrid_jax.kernels.batching import CPU_CHUNK, by_backend
from hybrid_jax.kernels.collision import clearance as clearance_kernel
from hybrid_jax.kernels.collision.clearance import clearance
from hybrid_jax.kernels.kinematics import tool_pose
from hybrid_jax.kernels.rays import sense
from hybrid_jax.runtime.devices import Spread, use_all_cores
from hybrid_jax.workcell.allowed_collisions import forbidden_contacts
from hybrid_jax.workcell.load import load_workcell


@dataclass(frozen=True)
class Sizes:
    """How much is measured."""

    batch: int = 65536
    ik: int = 1024
    """Poses of IK, and ..."""
    mjx: int = 512
    """... configurations of MJX: slow on a CPU; 16 times as many on an accelerator."""
    signs: int = 100_000
    """Configurations whose signs are compared."""
    swept: int = 5000
    """Configurations of a rival's turn."""


TINY = Sizes(batch=512, ik=16, mjx=4, signs=200, swept=50)
BAND = 1e-4
"""Clearances nearer to zero than this are left out of the comparison of signs [m]."""


def configurations(cell, count: int, seed: int = 0) -> np.ndarray:
    """Random configurations within the limits."""
    low, high = np.asarray(cell.joint_limits).T
    rng = np.random.default_rng(seed)
    return rng.uniform(low, high, (count, len(low))).astype(np.float32)


def arithmetic_peak() -> float:
    """Floating point operations per second of a large product of matrices, all cores."""
    n = 2048
    a = jnp.ones((n, n), jnp.float32)
    product = jax.jit(lambda a: a @ a)
    return race({"product": (lambda: product(a), 1)})["product"] * 2 * n**3


def operations(cell) -> float:
    """Floating point operations of one clearance: bounds of all pairs, exact for the nearest."""
    batch = jax.tree.map(lambda a: jnp.asarray(a)[None], cell)
    kernel = functools.partial(
        clearance_kernel._kernel, against="all", measured=clearance_kernel._MEASURED
    )
    q = jnp.zeros((CPU_CHUNK, cell.home.size))
    cost = jax.jit(lambda q: kernel(batch, q).distance).lower(q).compile().cost_analysis()
    return cost["flops"] / CPU_CHUNK


FIRST_CALL = """
import time
began = time.perf_counter()
import jax
jax.config.update("jax_compilation_cache_dir", {folder!r})
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
import hybrid_jax
cell = hybrid_jax.load_workcell("gen3_handling")
loaded = time.perf_counter()
hybrid_jax.clearance(cell, cell.home).block_until_ready()
print(time.perf_counter() - loaded)
"""


def first_calls() -> list[float]:
    """Seconds of the first call of `clearance` in a new process: empty cache, then filled."""
    with tempfile.TemporaryDirectory() as folder:
        code = FIRST_CALL.format(folder=folder)
        runs = [
            subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
            for _ in range(2)
        ]
    return [float(run.stdout.split()[-1]) for run in runs]


def axis_crosses(model, data, a: int, b: int) -> bool:
    """Does the axis of a capsule run through a box? Densely sampled, float64."""
    kinds = {int(model.geom_type[g]): g for g in (a, b)}
    box, capsule = (int(g) for g in (mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CAPSULE))
    if box not in kinds or capsule not in kinds:
        return False
    c, x = kinds[capsule], kinds[box]
    axis = data.geom_xmat[c].reshape(3, 3)[:, 2] * model.geom_size[c, 1]
    along = data.geom_xpos[c] + np.linspace(-1, 1, 2001)[:, None] * axis
    local = (along - data.geom_xpos[x]) @ data.geom_xmat[x].reshape(3, 3)
    return bool(np.any(np.all(np.abs(local) <= model.geom_size[x], axis=1)))


def crossed(engine, q) -> bool:
    """Does a capsule of the robot run right through a box that it must not touch?"""
    model, data = engine.model, engine.data
    engine.place(q)
    forbidden = forbidden_contacts(model, engine.layout)
    return any(
        axis_crosses(model, data, a, b)
        for a in range(model.ngeom)
        for b in range(a + 1, model.ngeom)
        if forbidden[a, b]
    )


def sign_agreement(cell, clear, count: int) -> tuple[float, float, int]:
    """Share of equal signs, the same once geometry has decided the rest, and how many differ."""
    engine = rivals.Engine(cell)
    q = configurations(cell, count, seed=1)
    ours = clear(q)
    judged = np.flatnonzero(np.abs(ours) > BAND)
    theirs = np.array([engine.deepest(row) for row in q[judged]])
    differ = judged[(ours[judged] < 0) != (theirs < -0.0)]
    wrong = [i for i in differ if not (ours[i] < 0 and crossed(engine, q[i]))]
    total = len(judged)
    return 1 - len(differ) / total, 1 - len(wrong) / total, len(differ)


def contest(cell, q: np.ndarray, ours, swept: int) -> dict[str, float]:
    """Configurations per second of `ours`, of a plain jit(vmap) and of the engines, in turns."""
    engine, bullet = rivals.Engine(cell), rivals.bullet(cell)
    alone = jax.jit(jax.vmap(clearance, (None, 0)))
    runs = {
        "ours": (ours, len(q)),
        "one device": (lambda: alone(cell, q), len(q)),
        "mujoco": (lambda: engine.sweep(q[:swept]), swept),
        "rollout": (rivals.mujoco_rollout(cell, q[:swept]), swept),
    }
    if bullet:
        runs["pybullet"] = (lambda: bullet.sweep(q[:swept]), swept)
    for run, _ in runs.values():
        jax.block_until_ready(run())
    return race(runs)


def main(json: Path | None = None, mjx: bool = True, tiny: bool = False) -> None:
    """Measure and print; write JSON if asked to.

    Args:
        json: file for the figures.
        mjx: measure MJX too; it compiles for about a minute.
        tiny: as little of everything as shows that it runs.
    """
    use_all_cores()
    sizes = TINY if tiny else Sizes()
    began = time.perf_counter()
    cold, warm = first_calls()
    cell = load_workcell(CELL)
    spread = Spread()
    shared, q = spread.share(cell), configurations(cell, sizes.batch)
    items = spread.split(q)
    clear = spread.over(clearance, 1)
    fk, rays = spread.over(tool_pose, 1), spread.over(sense, 1)
    solve = spread.over(lambda cell, pose, key: solve_ik(cell, pose, key=key), 2)
    poses = fk(shared, items)
    began_first = time.perf_counter()
    jax.block_until_ready(clear(shared, items))
    first = time.perf_counter() - began_first
    speed = contest(cell, q, lambda: clear(shared, items), sizes.swept)
    ours, native = speed["ours"], speed["mujoco"]
    count_ik, count_mjx = (by_backend(n, 16 * n) for n in (sizes.ik, sizes.mjx))
    keys = jax.random.split(jax.random.key(0), count_ik)
    some = spread.split(np.asarray(poses)[:count_ik]), spread.split(keys)
    found = float(jnp.mean(solve(shared, *some).found))
    flops, peak = operations(cell), arithmetic_peak()
    count = -(-sizes.signs // len(spread.devices)) * len(spread.devices)

    def clear_many(many):
        padded = np.concatenate([many, many[: count - len(many)]])
        return np.asarray(clear(shared, spread.split(padded)))[: len(many)]

    whole = rivals.mujoco_all_cores(cell, q)
    agree, decided, differ = sign_agreement(cell, clear_many, sizes.signs)
    figures = [
        metric("kernels.first_call_cold", cold, "s", "lower", "clearance, empty compile cache"),
        metric("kernels.first_call_warm", warm, "s", "lower", "the same, compile cache filled"),
        metric("kernels.batch_compile", first, "s", "lower", f"batch of {sizes.batch}"),
        metric("kernels.clearance", ours, "1/s", "higher", f"{len(spread.devices)} devices"),
        metric(
            "kernels.clearance_one_device", speed["one device"], "1/s", "higher", "plain jit(vmap)"
        ),
        metric("kernels.mujoco_one_thread", native, "1/s", "higher", "C MuJoCo, objects welded"),
        metric(
            "kernels.mujoco_rollout",
            speed["rollout"],
            "1/s",
            "higher",
            "C MuJoCo's own threads on all cores, a step each",
        ),
        metric(
            "kernels.mujoco_all_cores",
            whole,
            "1/s",
            "higher",
            "a Python loop in a process for each core",
        ),
        metric(
            "kernels.clearance_vs_mujoco_all_cores",
            ours / max(whole, speed["rollout"]),
            "1",
            "higher",
            "both on all cores, the faster of its two ways",
        ),
        metric(
            "kernels.clearance_vs_mujoco",
            speed["one device"] / native,
            "1",
            "higher",
            "both on one core",
        ),
        metric(
            "kernels.clearance_peak_share",
            ours * flops / peak,
            "1",
            "higher",
            f"{flops / 1e3:.0f} kflop each, peak {peak / 1e9:.0f} Gflop/s",
        ),
        metric(
            "kernels.clearance_sign_agreement",
            agree,
            "1",
            "higher",
            f"{differ} of {sizes.signs} differ",
        ),
        metric(
            "kernels.clearance_sign_right",
            decided,
            "1",
            "higher",
            "after geometry has decided where they differ",
        ),
        metric("kernels.fk", rate(lambda: fk(shared, items), sizes.batch)[0], "1/s", "higher"),
        metric(
            "kernels.rays",
            rate(lambda: rays(shared, poses), sizes.batch)[0],
            "1/s",
            "higher",
            "25 each",
        ),
        metric(
            "kernels.ik",
            rate(lambda: solve(shared, *some), count_ik)[0],
            "1/s",
            "higher",
            f"batch of {count_ik}, 16 seeds, {found:.4f} found",
        ),
    ]
    if "pybullet" in speed:
        slow = speed["pybullet"]
        figures.append(metric("kernels.pybullet", slow, "1/s", "higher"))
        figures.append(metric("kernels.clearance_vs_pybullet", ours / slow, "1", "higher"))
    if mjx:
        usual, best = (mjx_in_its_process(count_mjx, flags) for flags in ("", MJX_FLAGS))
        figures += [
            metric(
                "kernels.mjx",
                best,
                "1/s",
                "higher",
                f"batch of {count_mjx}; XLA_FLAGS={MJX_FLAGS or 'none'}",
            ),
            metric("kernels.mjx_as_it_comes", usual, "1/s", "higher", "the same without flags"),
            metric(
                "kernels.clearance_vs_mjx",
                ours / max(best, usual),
                "1",
                "higher",
                "the faster of the two",
            ),
        ]
    write(figures, json)
    print(f"{time.perf_counter() - began:.0f} s")


if __name__ == "__main__":
    tyro.cli(main)
