# SPDX-License-Identifier: MIT
"""traj_comb: the skill's and the joint agent's motion on one grid, and the choice between them"""

import jax
import jax.numpy as jnp
import numpy as np

from hybrid_jax.agents.switching import STEPS, Combined
from hybrid_jax.kernels.kinematics import manipulability
from hybrid_jax.planner.harvest import bridge_ends, phase_options
from hybrid_jax.planner.labelling import Bridge
from hybrid_jax.planner.lfd import skill_path
from hybrid_jax.skills.task import Task
from hybrid_jax.types import Workcell

_manipulability = jax.jit(jax.vmap(manipulability, (None, 0)))


def resample_path(path: np.ndarray, points: int) -> np.ndarray:
    """`points` configurations evenly spaced along a polyline `[n, joint]`."""
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    at = np.linspace(0, max(length[-1], 1e-9), points)
    return np.stack([np.interp(at, length, column) for column in path.T], axis=1)


def _grid(bridge: Bridge, drl: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Skill point (fractional) at each grid point, and share of the joint agent's motion there.

    The share is NaN where the joint agent has no motion. Its window takes as many grid points as
    its length asks for beside the skill's.
    """
    n = len(bridge.q)
    if drl is None:
        return np.linspace(0, n - 1, STEPS), np.full(STEPS, np.nan)
    first, last = bridge_ends(bridge)
    lengths = [
        np.abs(np.diff(part, axis=0)).sum() if len(part) > 1 else 0.0
        for part in (bridge.q[: first + 1], drl, bridge.q[last:])
    ]
    share = np.array(lengths) + 1e-6
    inside = int(np.clip(round(STEPS * share[1] / share.sum()), 20, STEPS - 40))
    before = int(
        np.clip(round((STEPS - inside) * share[0] / (share[0] + share[2])), 1, STEPS - inside - 1)
    )
    skill = np.concatenate(
        [
            np.linspace(0, first, before, endpoint=False),
            np.linspace(first, last, inside, endpoint=False),
            np.linspace(last, n - 1, STEPS - before - inside),
        ]
    )
    phase = np.full(STEPS, np.nan)
    phase[before : before + inside + 1] = np.linspace(0, 1, inside + 1)
    return skill, phase


def combine(cell: Workcell, bridge: Bridge, drl: np.ndarray | None, scale: float) -> Combined:
    """Both motions of a phase on the grid of the switching agent.

    Args:
        cell: for manipulability.
        bridge: the skill's joint path and its infeasible part.
        drl: way points of the joint agent from one end of the bridge to the other, or None.
        scale: manipulability that counts as 1.
    """
    skill, phase = _grid(bridge, drl)
    points = np.arange(len(bridge.q))
    q_skill = np.stack([np.interp(skill, points, column) for column in bridge.q.T], axis=1)
    bad = (
        ~bridge.feasible[np.floor(skill).astype(int)] | ~bridge.feasible[np.ceil(skill).astype(int)]
    )
    available = ~np.isnan(phase)
    q_drl = q_skill.copy()
    if drl is not None:
        fine = resample_path(drl, 400)
        at = np.clip(np.nan_to_num(phase) * 399, 0, 399)
        moving = np.stack([np.interp(at, np.arange(400), column) for column in fine.T], axis=1)
        q_drl[available] = moving[available]
    q = np.stack([q_skill, q_drl]).astype(np.float32)
    man = np.asarray(_manipulability(cell, jnp.asarray(q.reshape(-1, q.shape[-1]))))
    collision = np.stack([bad.astype(np.float32), np.where(available, 0.0, 1.0)])
    return Combined(
        jnp.asarray(q),
        jnp.asarray(np.clip(man / scale, 0, 1).reshape(2, STEPS)),
        jnp.asarray(collision, jnp.float32),
        jnp.asarray(available, jnp.float32),
    )


def assemble(
    combined: Combined, choice: np.ndarray, bridge: Bridge, drl: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """The chosen joint path `[point, joint]` and the source of each point.

    Where the joint agent runs from one end of its motion to the other its own way points are
    kept: a grid would cut their corners.
    """
    q = np.asarray(combined.q)
    choice = np.asarray(choice)
    available = np.asarray(combined.available) > 0
    if drl is None or not (choice == available).all():
        return q[choice, np.arange(STEPS)], choice.astype(np.uint8)
    window = np.flatnonzero(available)
    before, after = q[0, : window[0]], q[0, window[-1] + 1 :]
    sources = np.concatenate([np.zeros(len(before)), np.ones(len(drl)), np.zeros(len(after))])
    return np.concatenate([before, drl, after]), sources.astype(np.uint8)


def task_problems(planner, task: Task, key) -> list[Combined]:
    """traj_comb of every phase of a task whose infeasible part the joint agent bridges."""
    return [
        combine(options.cell, bridge, drl, planner.scale)
        for options, bridge, drl in _bridged(planner, task, key)
        if drl is not None
    ]


def skill_problems(planner, task: Task) -> list[Combined]:
    """The skill's own motion of every phase of a task, infeasible parts and all."""
    return [
        combine(options.cell, bridge, None, planner.scale)
        for options, bridge, _ in _bridged(planner, task, jax.random.key(0))
    ]


def _bridged(planner, task: Task, key):
    """Options, best bridge and the joint agent's motion of each phase, until one has no option."""
    path = skill_path(planner.library, task, planner.choose, planner.config.skills)
    start = np.asarray(planner.cell.home)
    for phase, poses in enumerate(path.phases):
        key_ik, key_drl = jax.random.split(jax.random.fold_in(key, phase))
        options = phase_options(
            planner.cell, task, phase, poses, start, planner.scale, planner.config.labels, key_ik
        )
        if not options.bridges:
            return
        bridge = options.bridges[0]
        drl = None
        if bridge.first != bridge.last and planner.bridge is not None:
            first, last = bridge_ends(bridge)
            drl = planner.bridge(options.cell.scene, bridge.q[first], bridge.q[last], key_drl)
        yield options, bridge, drl
        start = bridge.q[-1]
