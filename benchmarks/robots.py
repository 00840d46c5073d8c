# SPDX-License-Identifier: MIT
"""Public robots, adopted as they are: what becomes of them, beside `coal` and on the same hulls.

python -m benchmarks.robots --models FOLDER --json docs/figures/robots.json
"""

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import jax
import mujoco
import numpy as np
import tyro

from benchmarks.hull_oracle import HullOracle, links_outside
from benchmarks.report import metric, race, write
from benchmarks.robot_models import models as found_models
from hybrid_jax.adopt.adoption import adopt
from hybrid_jax.ik import solve_ik
from hybrid_jax.kernels.collision.clearance import clearance
from hybrid_jax.kernels.kinematics import tool_pose
from hybrid_jax.runtime.devices import use_all_cores
from hybrid_jax.workcell.load import load_workcell


@dataclass(frozen=True)
class Sizes:
    """How much is measured of each robot."""

    configurations: int = 1000
    """Whose clearance is compared with the oracle's."""
    points: int = 100_000
    """Of each link's hull."""
    poses: int = 200
    """Of inverse kinematics."""
    batch: int = 8192
    """Clearances of a turn."""
    robots: int = 100
    """Models at most."""


TINY = Sizes(configurations=20, points=500, poses=4, batch=256, robots=1)
BAND = 1e-5
"""Distances nearer to zero count as neither [m]."""
ALLOWED = 1e-4
"""How far a point of a mesh may be left out [m]."""


def configurations(cell, count: int, seed: int = 0) -> np.ndarray:
    """Random configurations within the limits; a hinge without limits turns once."""
    low, high = np.asarray(cell.joint_limits).T
    low, high = np.maximum(low, -np.pi * 2), np.minimum(high, np.pi * 2)
    return np.random.default_rng(seed).uniform(low, high, (count, len(low))).astype(np.float32)


def measured(cell, sizes: Sizes) -> dict[str, float]:
    """What one robot's model leaves out, and where its answers differ from the oracle's."""
    q = configurations(cell, sizes.configurations)
    ours = np.asarray(jax.jit(jax.vmap(clearance, (None, 0)))(cell, q))
    oracle = HullOracle(cell)
    true = np.array([oracle.distance(row) for row in q])
    goals = configurations(cell, sizes.poses, 1)
    poses = jax.vmap(tool_pose, (None, 0))(cell, goals)
    keys = jax.random.split(jax.random.key(0), len(goals))
    solve = jax.vmap(lambda cell, pose, key: solve_ik(cell, pose, key=key), (None, 0, 0))
    found = jax.jit(solve)(cell, poses, keys)
    outside = links_outside(cell, sizes.points)
    return {
        "uncovered": float(np.sum(outside > ALLOWED)),
        "free": int(np.sum(true > BAND)),
        "colliding": int(np.sum(true < -BAND)),
        "false": int(np.sum((true > BAND) & (ours <= 0))),
        "missed": int(np.sum((true < -BAND) & (ours > 0))),
        "excess": 1e3 * float(np.median((true - ours)[true > BAND])) if (true > BAND).any() else 0,
        "ik": float(np.mean(found.found)),
    }


def hull_speed(sizes: Sizes) -> float:
    """Clearances per second of an arm of 8 hulls over those of the same arm of capsules."""
    q, runs = None, {}
    with tempfile.TemporaryDirectory() as folder:
        for kind in ("hulls", "capsules"):
            path = Path(folder) / f"{kind}.xml"
            path.write_text(arm(kind == "hulls"))
            cell = load_workcell(path)
            q = configurations(cell, sizes.batch) if q is None else q
            run = jax.jit(jax.vmap(clearance, (None, 0)))
            runs[kind] = (lambda run=run, cell=cell, q=q: run(cell, q), len(q))
            jax.block_until_ready(runs[kind][0]())
    rates = race(runs)
    return rates["hulls"] / rates["capsules"]


def arm(hulls: bool) -> str:
    """MJCF of an arm of eight links among twenty boxes: capsules, or prisms of 64 corners."""
    angle = np.arange(32) * np.pi / 16
    ring = 0.06 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    prism = np.vstack([np.c_[0.9 * ring, np.zeros(32)], np.c_[ring, np.full(32, 0.22)]])
    numbers = " ".join(f"{v:.5f}" for v in prism.ravel())
    asset = f'<asset><mesh name="link" vertex="{numbers}"/></asset>' if hulls else ""
    geom = (
        '<geom type="mesh" mesh="link"/>'
        if hulls
        else '<geom type="capsule" size=".06" fromto="0 0 .04 0 0 .18"/>'
    )
    links, ends = "", ""
    for i in range(7):
        axis = "0 0 1" if i % 2 == 0 else "0 1 0"
        links += f'<body name="l{i}" pos="0 0 .25"><joint axis="{axis}" range="-2.5 2.5"/>{geom}'
        ends += "</body>"
    rng = np.random.default_rng(0)
    boxes = ""
    for _ in range(20):
        turn, reach = rng.uniform(0, 2 * np.pi), rng.uniform(0.5, 1.2)
        place = reach * np.cos(turn), reach * np.sin(turn), rng.uniform(0, 1.4)
        size = rng.uniform(0.03, 0.12, 3)
        boxes += '<geom type="box" pos="{:.3f} {:.3f} {:.3f}" size="{:.3f} {:.3f} {:.3f}"/>'.format(
            *place, *size
        )
    return (
        f'<mujoco><compiler angle="radian"/>{asset}<worldbody>{boxes}<body name="base">{geom}'
        f'{links}<site name="tool" pos="0 0 .25"/>{ends}</body></worldbody>'
        '<contact><exclude body1="base" body2="l0"/></contact></mujoco>'
    )


def main(models: Path = Path("models"), json: Path | None = None, tiny: bool = False) -> None:
    """Adopt every model that is here, and measure it.

    Args:
        models: folder of public models.
        json: file to write the figures to.
        tiny: run to the end on as little as there is.
    """
    use_all_cores()
    sizes = TINY if tiny else Sizes()
    seconds, fit, rows = [], [], []
    with tempfile.TemporaryDirectory() as folder:
        for model, path in found_models(models)[: sizes.robots]:
            began = time.perf_counter()
            adopted = adopt(path, Path(folder) / model.name, model.options)
            seconds.append(time.perf_counter() - began)
            fit.append(adopted.fit)
            if not adopted.fit:
                reasons = [f.text for f in adopted.findings if f.level == "wrong"]
                print(f"{model.name}: {reasons[0][:200]}", flush=True)
                continue
            rows.append({"name": model.name, **measured(load_workcell(adopted.path), sizes)})
            print(rows[-1], flush=True)
            jax.clear_caches()
    write([*figures(rows, fit, seconds), speed(sizes)], json)


def figures(rows: list[dict], fit: list[bool], seconds: list[float]) -> list[dict]:
    """The figures of all robots together."""
    total = lambda key: sum(row[key] for row in rows)  # noqa: E731
    worst = lambda key: max((row[key] for row in rows), default=0)  # noqa: E731
    asked = f"{len(fit)} models, MuJoCo {mujoco.__version__}"
    found = float(np.mean([row["ik"] for row in rows])) if rows else 0.0
    return [
        metric("robots.adopted", float(np.mean(fit)) if fit else 0.0, "", "higher", asked),
        metric("robots.uncovered", total("uncovered"), "", "lower", "points left out by 0.1 mm"),
        metric(
            "robots.false_collisions",
            total("false") / max(total("free"), 1),
            "",
            "lower",
            f"of {total('free')} free configurations",
        ),
        metric(
            "robots.missed_collisions",
            total("missed"),
            "",
            "lower",
            f"of {total('colliding')} colliding configurations",
        ),
        metric("robots.excess", worst("excess"), "mm", "lower", "median of the worst robot"),
        metric("robots.ik_found", found, "", "higher", "reachable poses, without clearance"),
        metric(
            "robots.adopt_seconds",
            float(np.median(seconds)) if seconds else 0.0,
            "s",
            "lower",
            f"with the check; the longest {max(seconds, default=0):.1f} s",
        ),
    ]


def speed(sizes: Sizes) -> dict:
    """The figure of how fast hulls are."""
    return metric("robots.hull_speed", hull_speed(sizes), "", "higher", "over the capsule arm")


if __name__ == "__main__":
    tyro.cli(main)
