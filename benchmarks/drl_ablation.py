# SPDX-License-Identifier: MIT
"""What the joint agent's environment owes to each idea: one is replaced, the rest is kept.

- `plain`: the action is the whole joint step, as is usual, and not a correction of a straight one.
- `expert`: episodes start anywhere along a path of RRT-Connect, which covers every curriculum that
  grows a segment outward from its ends, and the potential is the way to go along that path.
  Segments without such a path are left out of the training.
- `geodesic`: the potential also counts the tool's way to the goal through the feasible voxels of
  the map. Its weights are not tuned.
- `everywhere`: start/goal pairs of the whole work space instead of the harvested segments.
"""

from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from benchmarks import drl_trainings
from benchmarks.drl_default import share
from benchmarks.drl_problems import Problems, rrt_paths
from hybrid_jax.agents import joint
from hybrid_jax.agents.joint import JointAgentConfig
from hybrid_jax.agents.trainers import make_programs
from hybrid_jax.contracts import Segments, take
from hybrid_jax.envs.reach import ReachConfig, ReachEnv
from hybrid_jax.feasibility.building import FeasibilityMap, build_feasibility_map
from hybrid_jax.kernels import dualquat as dq
from hybrid_jax.kernels.kinematics import tool_pose
from hybrid_jax.runs.presets import DEFAULT
from hybrid_jax.types import Workcell

CONFIG = DEFAULT.joint
POINTS = 32
"""Points of an expert's path."""
FEW = "corrected", "plain_expert", "plain_geodesic"
"""Variants whose code is that of all."""
VOXEL_WORTH, JOINT_WORTH = 3.0, 0.5
"""Weights of the geodesic distance [1/m] and of the joints' [1/rad]."""
BEYOND = 2.0
"""Geodesic distance of voxels that are not connected to the goal's [m]."""


class PlainEnv(ReachEnv):
    """The action is the joint step."""

    def target(self, state, action):
        low, high = self.cell.chain.limits.T
        move = self.config.max_delta * jnp.clip(action, -1, 1)
        return jnp.clip(state.q + move, low, high)


class ExpertEnv(ReachEnv):
    """Starts and potential along an expert's paths `[segment, POINTS, joint]`."""

    def __init__(self, cell: Workcell, segments: Segments, config: ReachConfig, paths: Array):
        self.paths = paths
        super().__init__(cell, segments, config)

    def reset(self, key):
        key_segment, key_point = jax.random.split(key)
        segment = jax.random.randint(key_segment, (), 0, self.paths.shape[0], jnp.int32)
        point = jax.random.randint(key_point, (), 0, POINTS - 1)
        return self.start(segment, self.paths[segment, point])

    def potential(self, segment, q):
        path = self.paths[segment]
        ways = jnp.linalg.norm(jnp.diff(path, axis=0), axis=1)
        to_go = jnp.append(jnp.cumsum(ways[::-1])[::-1], 0.0)
        return -jnp.min(jnp.linalg.norm(path - q, axis=1) + to_go)


class PlainExpertEnv(ExpertEnv, PlainEnv):
    """Both."""


class GeodesicEnv(ReachEnv):
    """The potential counts the tool's way through feasible voxels."""

    def __init__(self, cell: Workcell, segments: Segments, config: ReachConfig, fmap):
        self.lower, self.spacing = fmap.lower, fmap.spacing
        goals = jax.vmap(tool_pose, (None, 0))(cell, segments.goal)
        self.away = jnp.asarray(geodesic(fmap, np.asarray(jax.vmap(dq.position)(goals))))
        super().__init__(cell, segments, config)

    def potential(self, segment, q):
        table = self.away[segment]
        place = (dq.position(tool_pose(self.cell, q)) - self.lower) / self.spacing
        place = jnp.clip(place, 0, jnp.array(table.shape) - 1.001)
        corner = jnp.floor(place).astype(int)
        part, value = place - corner, 0.0
        for bits in range(8):
            step = jnp.array([bits & 1, bits >> 1 & 1, bits >> 2])
            weight = jnp.prod(jnp.where(step == 1, part, 1 - part))
            value += weight * table[tuple(corner + step)]
        to_go = jnp.linalg.norm(self.segments.goal[segment] - q)
        return -VOXEL_WORTH * value - JOINT_WORTH * to_go


class PlainGeodesicEnv(GeodesicEnv, PlainEnv):
    """Both."""


def geodesic(fmap: FeasibilityMap, goals: np.ndarray) -> np.ndarray:
    """Distances `[goal, x, y, z]` from every voxel to each goal through feasible ones [m]."""
    open_ = np.asarray(fmap.feasibility).max(axis=-1) > 0
    shape, spacing = np.array(open_.shape), float(fmap.spacing)
    cells = np.argwhere(open_)
    number = np.full(open_.shape, -1)
    number[tuple(cells.T)] = np.arange(len(cells))
    rows, columns, lengths = [], [], []
    for step in np.argwhere(np.ones((3, 3, 3))) - 1:
        other = cells + step
        inside = ((other >= 0) & (other < shape)).all(axis=1) & bool(step.any())
        to = np.where(inside, number[tuple(np.clip(other, 0, shape - 1).T)], -1)
        rows += [np.flatnonzero(to >= 0)]
        columns += [to[to >= 0]]
        lengths += [np.full((to >= 0).sum(), spacing * np.linalg.norm(step))]
    rows, columns, lengths = (np.concatenate(a) for a in (rows, columns, lengths))
    graph = sparse.csr_matrix((lengths, (rows, columns)), shape=(len(cells), len(cells)))
    centres = np.asarray(fmap.lower) + spacing * cells
    nearest = np.linalg.norm(goals[:, None] - centres, axis=-1).argmin(axis=1)
    away = np.full((len(goals), *open_.shape), BEYOND, np.float32)
    away[:, open_] = np.minimum(dijkstra(graph, indices=nearest), BEYOND)
    return away


def expert_paths(cell: Workcell, segments: Segments) -> tuple[Segments, Array]:
    """The segments that RRT-Connect solves, and its paths `[segment, POINTS, joint]`."""
    found = rrt_paths(cell, segments)
    kept = [i for i, path in enumerate(found) if path is not None]
    return take(segments, np.array(kept)), jnp.asarray(np.stack([even(found[i]) for i in kept]))


def even(path: np.ndarray) -> np.ndarray:
    """`[POINTS, joint]` the same path in even steps."""
    ways = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1)))
    at = np.linspace(0.0, ways[-1], POINTS)
    return np.stack([np.interp(at, ways, column) for column in path.T], axis=1).astype(np.float32)


def variants(cell: Workcell, problems: Problems) -> dict[str, Callable[[], ReachEnv]]:
    """Worlds to train in, by name."""
    rules, training = CONFIG.reach, problems.training
    solved, paths = expert_paths(cell, training)
    fmap = build_feasibility_map(cell, DEFAULT.map)
    return {
        "everywhere": lambda: ReachEnv(cell, problems.everywhere, rules),
        "expert": lambda: ExpertEnv(cell, solved, rules, paths),
        "geodesic": lambda: GeodesicEnv(cell, training, rules, fmap),
        "plain": lambda: PlainEnv(cell, training, rules),
        "plain_expert": lambda: PlainExpertEnv(cell, solved, rules, paths),
        "plain_geodesic": lambda: PlainGeodesicEnv(cell, training, rules, fmap),
    }


def success(
    cell: Workcell, net, policies, kind: type[ReachEnv], config: JointAgentConfig, test: Segments
) -> tuple[list[float], list[float]]:
    """Shares of the held-out segments that reach the goal: by the mode, by the best of 16."""
    count = test.start.shape[0]
    index, spread = jnp.tile(jnp.arange(count), 16), jnp.repeat(joint.spreads(16), count)

    @jax.jit
    def run(policy):
        env = ReachEnv(cell, test, config.reach)
        if issubclass(kind, PlainEnv):  # what the action means matters, the reward does not
            env = PlainEnv(cell, test, config.reach)
        return joint.rollouts(env, net, policy, index, spread, jax.random.key(0))[1]

    tables = [np.asarray(run(policy)).reshape(16, count) for policy in policies]
    return [float(t[0].mean()) for t in tables], [float(t.any(axis=0).mean()) for t in tables]


def figures(
    cell: Workcell, problems: Problems, seeds: tuple[int, ...], steps: int, few: bool = False
) -> list[dict]:
    """Success of each variant, or of `FEW`, on the held-out segments."""
    training, rows = replace(CONFIG.training, steps=steps), []
    environments = {"corrected": lambda: ReachEnv(cell, problems.training, CONFIG.reach)}
    environments |= variants(cell, problems)
    for name in FEW if few else environments:
        make = environments[name]
        env, net, policies = make(), joint.make_net(cell, CONFIG), []
        programs = make_programs(env, net, training)
        for seed in seeds:
            start = programs.start((seed,))
            end, _ = drl_trainings.advance(programs, start, training.iterations)
            policies.append(end.policy())
        one, many = success(cell, net, policies, type(env), CONFIG, problems.held_out)
        note = f"{steps:,} steps; as the training's checks say, not proven"
        rows += [
            share(f"ablation_{name}_1", one, f"one rollout, {note}"),
            share(f"ablation_{name}_16", many, f"best of 16, {note}"),
        ]
        print(f"ablation: {name} {np.mean(one):.3f} {np.mean(many):.3f}", flush=True)
    return rows
