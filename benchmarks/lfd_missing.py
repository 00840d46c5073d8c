# SPDX-License-Identifier: MIT
"""Does the planner know when it does not know? Real tasks with and without their demonstration.

A task is a chain of three segments: the start-to-goal motions of held-out demonstrations of three
different real tasks, one after the other. The library holds one other demonstration of each task,
or lacks that of one segment, which the answer must then name.
"""

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.lfd_maps import Demos
from benchmarks.report import metric
from hybrid_jax.demonstrations.demonstration import Demonstration
from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.skills.costs import MAX_KEY_POSES, segment_costs
from hybrid_jax.skills.library import SkillConfig, SkillLibrary, build_library, without
from hybrid_jax.skills.task_segmentation import missing_skills, optimal_plan

TASKS = 200
SEGMENTS = 3


def _recorded(name: str, poses: np.ndarray) -> Demonstration:
    from benchmarks.lfd_maps import rows

    count = len(poses)
    return Demonstration(name, np.linspace(0, 6, count), rows(poses).astype(float), np.zeros(count))


def _chain(motions: list[np.ndarray], first: np.ndarray) -> np.ndarray:
    """Key poses `[K, 8]` that lead through the given start-to-goal motions."""
    poses = [jnp.asarray(first)]
    for path in motions:
        poses.append(
            dq.mul(poses[-1], dq.mul(dq.conj(jnp.asarray(path[0])), jnp.asarray(path[-1])))
        )
    poses += [poses[-1]] * (MAX_KEY_POSES - len(poses))
    return np.stack(poses)


def draw_task(demos: Demos, rng: np.random.Generator) -> tuple[SkillLibrary, np.ndarray, list[str]]:
    """A library with one demonstration of each real task, a chain of others, and their names."""
    names = list(demos)
    held = {name: rng.permutation(len(demos[name])) for name in names}
    library = build_library([_recorded(n, demos[n][held[n][0]]) for n in names])
    chosen = [str(n) for n in rng.choice(names, SEGMENTS, replace=False)]
    first = demos[names[0]][0, 0]
    return library, _chain([demos[n][held[n][1]] for n in chosen], first), chosen


def figures(demos: Demos, config: SkillConfig = SkillConfig()) -> list[dict]:
    """Shares of tasks that are accepted with all skills, and whose gap is named without one."""
    rng = np.random.default_rng(0)
    judge = jax.jit(
        lambda lib, poses: segment_costs(
            lib, poses, jnp.zeros(MAX_KEY_POSES, bool), SEGMENTS + 1, config
        )
    )
    accepted, named = [], []
    for _ in range(TASKS):
        library, poses, chosen = draw_task(demos, rng)
        costs = jax.device_get(judge(library, poses))
        accepted.append(bool(optimal_plan(costs.cost, SEGMENTS + 1)[0]))
        gap = int(rng.integers(SEGMENTS))
        less = jax.device_get(judge(without(library, {chosen[gap]}), poses))
        missing = missing_skills(
            less.cost, less.nearest, SEGMENTS + 1, library.names, config.tolerance
        )
        refused = not optimal_plan(less.cost, SEGMENTS + 1)[0]
        named.append(refused and [(m.start, m.end) for m in missing] == [(gap, gap + 1)])
    note = f"{TASKS} chains of {SEGMENTS} real motions, {len(demos)} skills"
    return [
        metric("lfd.need_demo_recall", float(np.mean(named)), "1", "higher", note),
        metric("lfd.own_demo_accepted", float(np.mean(accepted)), "1", "higher", note),
    ]
