# SPDX-License-Identifier: MIT
"""Adopted robots plan between random configurations, beside OMPL on the same hulls.

    python -m benchmarks.robot_planning --models FOLDER --json docs/figures/robot_planning.json

Each public robot is adopted with a table and a shelf, sized by its reach. Both planners get the
same pairs of free configurations. C MuJoCo is OMPL's checker. It judges every path of both, and
`coal` decides which configurations are free.
"""

import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import jax
import mujoco
import numpy as np
import tyro

from benchmarks.contact_check import ContactCheck
from benchmarks.hull_oracle import HullOracle
from benchmarks.report import metric, write
from benchmarks.robot_models import RobotModel
from benchmarks.robot_models import models as found_models
from benchmarks.robots import configurations
from hybrid_jax.adopt.adoption import adopt
from hybrid_jax.baselines.ompl_paths import OmplPlanner
from hybrid_jax.planner.point_to_point import plan_joint_motion
from hybrid_jax.planner.smoothing import densify
from hybrid_jax.runtime.devices import use_all_cores
from hybrid_jax.types import Status, Workcell
from hybrid_jax.workcell.load import load_workcell

SECONDS = 10.0
"""Time that OMPL may take for a pair."""
FINE = 0.01
"""Distance of the configurations of a path that are checked again [rad or m]."""
SAMPLED = 4000
"""Random configurations among which free ones are looked for."""


@dataclass(frozen=True)
class Row:
    """One pair of configurations by both planners."""

    robot: str
    ours: bool
    """Did we answer with a trajectory that touches nothing? False where we were not asked."""
    reason: str
    """Status and sentence of our answer."""
    our_seconds: float
    ompl: bool
    """Did OMPL find a path that touches nothing?"""
    ompl_seconds: float


def surroundings(cell: Workcell) -> str:
    """TOML of a table before the robot and a shelf beside it, sized by its reach.

    Args:
        cell: of the robot alone.
    """
    model, layout = cell.model, cell.source.layout
    data, reaches = mujoco.MjData(model), []
    for q in configurations(cell, 200):
        data.qpos[list(layout.qpos)] = q
        mujoco.mj_kinematics(model, data)
        base = data.xanchor[layout.joints[0]]
        reaches.append(np.linalg.norm(data.site_xpos[layout.tool_site] - base))
    reach = float(np.quantile(reaches, 0.9))
    x, y, z = base
    boards = [
        ("table", (x + 0.75 * reach, y, z - 0.35 * reach), (0.3, 0.5, 0.02)),
        ("shelf_low", (x + 0.2 * reach, y + 0.8 * reach, z), (0.35, 0.15, 0.015)),
        ("shelf_high", (x + 0.2 * reach, y + 0.8 * reach, z + 0.45 * reach), (0.35, 0.15, 0.015)),
        ("shelf_back", (x + 0.2 * reach, y + 0.96 * reach, z + 0.2 * reach), (0.35, 0.01, 0.4)),
    ]
    text = ""
    for name, place, size in boards:
        half = [round(reach * s, 4) for s in size]
        position = [round(float(v), 4) for v in place]
        text += f'[[fixtures]]\nname = "{name}"\nbox = {half}\nposition = {position}\n'
    return text


def free_pairs(cell: Workcell, count: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Pairs of random configurations that `coal` and C MuJoCo both call free."""
    oracle, is_free, free = HullOracle(cell), ContactCheck(cell), []
    for q in configurations(cell, SAMPLED, seed=5):
        if is_free(q) and oracle.distance(q) > 0:
            free.append(q.astype(float))
        if len(free) == 2 * count:
            break
    return list(zip(free[::2], free[1::2], strict=False))


def _is_clear(is_free: ContactCheck, path: np.ndarray) -> bool:
    return all(map(is_free, densify(np.asarray(path, float), FINE)))


def compared(robot: str, cell: Workcell, count: int) -> list[Row]:
    """Both planners on every pair of one robot; the first pair is planned once before.

    Pairs that OMPL does not plan are not put to us: most lie in parts of joint space that no path
    joins.
    """
    is_free, rows = ContactCheck(cell), []
    low, high = np.asarray(cell.joint_limits, float).T
    rival = OmplPlanner(np.maximum(low, -2 * np.pi), np.minimum(high, 2 * np.pi))
    pairs = free_pairs(cell, count)
    for start, goal in pairs[:1]:
        plan_joint_motion(cell, start, goal, key=jax.random.key(0))
    for number, (start, goal) in enumerate(pairs):
        path, rival_seconds = rival.solve(is_free, start, goal, SECONDS)
        if path is None or not _is_clear(is_free, path):
            rows.append(Row(robot, False, "not asked", 0.0, False, rival_seconds))
            continue
        began = time.perf_counter()
        result = plan_joint_motion(cell, start, goal, key=jax.random.key(number))
        seconds = time.perf_counter() - began
        ok = result.status is Status.OK and all(
            _is_clear(is_free, phase.positions) for phase in result.phases
        )
        reason = f"{result.status.name}: {result.detail}"
        rows.append(Row(robot, ok, reason, seconds, True, rival_seconds))
    return rows


def adopted_cell(model: RobotModel, path: Path, folder: Path) -> Workcell | None:
    """A robot with its surroundings as a cell; None where it cannot be planned in."""
    alone = adopt(path, folder / f"{model.name}_alone", model.options)
    if not alone.fit or alone.path is None:
        return None
    file = folder / f"{model.name}.toml"
    file.write_text(surroundings(load_workcell(alone.path)))
    whole = adopt(path, folder / model.name, replace(model.options, fixtures=(file,)))
    return load_workcell(whole.path) if whole.fit and whole.path else None


def main(
    models: Path = Path("models"),
    json: Path | None = None,
    pairs: int = 20,
    tiny: bool = False,
) -> None:
    """Plan with every model that is here.

    Args:
        models: folder of public models.
        json: file to write the figures to.
        pairs: of configurations for each robot.
        tiny: run to the end on as little as there is.
    """
    use_all_cores()
    listed, rows = found_models(models), []
    with tempfile.TemporaryDirectory() as folder:
        for model, path in listed[:1] if tiny else listed:
            cell = adopted_cell(model, path, Path(folder))
            if cell is None:
                print(f"{model.name}: not adopted", flush=True)
                continue
            new = compared(model.name, cell, 1 if tiny else pairs)
            rows += new
            failed = sorted({row.reason for row in new if row.ompl and not row.ours})
            both = sum(row.ompl for row in new)
            planned = sum(row.ours for row in new)
            print(f"{model.name}: {planned} of {both} of {len(new)} {failed}", flush=True)
            jax.clear_caches()
    write(figures(rows), json)


def figures(rows: list[Row]) -> list[dict]:
    """The figures of all robots together."""
    both = [row for row in rows if row.ompl]
    robots = len({row.robot for row in rows})
    share = float(np.mean([row.ours for row in both])) if both else 0.0
    ours = [row.our_seconds for row in both]
    theirs = [row.ompl_seconds for row in both]
    return [
        metric(
            "robots.planned_vs_ompl",
            share,
            "",
            "higher",
            f"of {len(both)} pairs of {robots} robots that OMPL plans in {SECONDS:g} s, of "
            f"{len(rows)} pairs",
        ),
        metric(
            "robots.plan_seconds",
            float(np.median(ours)) if ours else 0.0,
            "s",
            "lower",
            f"median, the whole layer; OMPL's first path {np.median(theirs):.3f}"
            if theirs
            else "nothing planned",
        ),
    ]


if __name__ == "__main__":
    tyro.cli(main)
