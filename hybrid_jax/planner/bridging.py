# SPDX-License-Identifier: MIT
"""Motions over the gaps of a route: by the joint agent, else by a fallback (Algorithm 3)."""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import numpy as np
from jax import Array

from hybrid_jax.contracts import Bridger, Segments, take
from hybrid_jax.kernels.batching import padded_chunks
from hybrid_jax.kernels.collision.motion_validation import paths_are_free
from hybrid_jax.planner.rrt_connect import RrtConfig, plan_paths
from hybrid_jax.runtime.keys import fold_in
from hybrid_jax.types import Source, Workcell

PROBLEMS_PER_CALL = 8
"""Problems that RRT-Connect searches in one call."""


@dataclass(frozen=True)
class Way:
    """A proven motion over a gap."""

    path: np.ndarray
    """`[way point, joint]` from the start of the gap to its end [rad or m]."""
    source: Source
    """The method that found it."""


def rrt_bridger(cell: Workcell, config: RrtConfig | None) -> Bridger | None:
    """RRT-Connect as a `Bridger`.

    Args:
        cell: robot and fixtures.
        config: settings of the search; None for none.

    Returns:
        A function of segments (`start` and `goal` `[segment, joint]`) and a key. It returns way
        points `[way point, joint]` [rad or m] of each segment, proven free of collision, or None.
        Without settings there is no function: None.
    """
    if config is None:
        return None

    def bridge(segments: Segments, key: Array) -> list[np.ndarray | None]:
        bridges: list[np.ndarray | None] = []
        for call, (index, count) in enumerate(
            padded_chunks(len(segments.start), PROBLEMS_PER_CALL)
        ):
            batch, call_key = take(segments, index), fold_in(key, call)
            paths = plan_paths(cell, batch.scene, batch.start, batch.goal, config, key=call_key)
            solved = [i for i in range(count) if paths[i] is not None]
            solved_paths = [np.asarray(paths[i]) for i in solved]
            # the search checks samples only: whole edges are proven here
            scenes = jax.tree.map(lambda a, solved=solved: np.asarray(a)[solved], batch.scene)
            free = dict(zip(solved, paths_are_free(cell, scenes, solved_paths), strict=True))
            bridges += [paths[i] if free.get(i) else None for i in range(count)]
        return bridges

    return bridge


def bridge_gaps(
    bridge: Bridger | None, fallback: Bridger | None, segments: list[Segments], key: Array
) -> list[Way | None]:
    """Motions over gaps, by the joint agent or else by the fallback.

    Args:
        bridge: the joint agent, or None.
        fallback: method for the gaps that the joint agent does not bridge, or None.
        segments: the gaps, each without a leading axis: `start` and `goal` are `[joint]`.
        key: consumed.

    Returns:
        A motion over each gap; None where neither method finds one.
    """
    ways: list[Way | None] = [None] * len(segments)
    sources: list[tuple[Callable | None, Source]] = [(bridge, Source.DRL), (fallback, Source.RRT)]
    for number, (method, source) in enumerate(sources):
        missing = [i for i, way in enumerate(ways) if way is None]
        if method is None or not missing:
            continue
        stacked = jax.tree.map(lambda *a: np.stack(a), *[segments[i] for i in missing])
        for i, path in zip(missing, method(stacked, fold_in(key, number)), strict=True):
            ways[i] = None if path is None else Way(path, source)
    return ways
