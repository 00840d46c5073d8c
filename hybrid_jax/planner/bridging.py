# SPDX-License-Identifier: MIT
"""Motions over the gaps of a route: by the joint agent, else by RRT-Connect (Algorithm 3)."""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import numpy as np
from jax import Array

from hybrid_jax.agents.joint import Bridger
from hybrid_jax.agents.segments import Segments, take
from hybrid_jax.kernels.batching import padded_chunks
from hybrid_jax.kernels.edges import paths_are_free
from hybrid_jax.keys import fold_in
from hybrid_jax.rrt import RrtConfig, plan_paths
from hybrid_jax.types import Source, Workcell

TOGETHER = 8
"""Problems that RRT-Connect searches in one call."""


@dataclass(frozen=True)
class Way:
    """A proven motion over a gap."""

    path: np.ndarray
    """`[way point, joint]` from its start to its goal."""
    source: Source


def rrt_bridger(cell: Workcell, config: RrtConfig) -> Bridger:
    """RRT-Connect as a `Bridger`; every path that it returns is proven free."""

    def bridge(segments: Segments, key: Array) -> list[np.ndarray | None]:
        found: list[np.ndarray | None] = []
        for part, (index, count) in enumerate(padded_chunks(len(segments.start), TOGETHER)):
            some, key_part = take(segments, index), fold_in(key, part)
            paths = plan_paths(cell, some.scene, some.start, some.goal, config, key=key_part)
            rows = [i for i in range(count) if paths[i] is not None]
            good = [np.asarray(paths[i]) for i in rows]
            scenes = jax.tree.map(lambda a, rows=rows: np.asarray(a)[rows], some.scene)
            free = dict(zip(rows, paths_are_free(cell, scenes, good), strict=True))
            found += [paths[i] if free.get(i) else None for i in range(count)]
        return found

    return bridge


def bridge_gaps(
    bridge: Bridger | None, fallback: Bridger | None, segments: list[Segments], key: Array
) -> list[Way | None]:
    """A motion over each gap, None where neither finds one.

    Args:
        bridge: the joint agent, or None.
        fallback: what is tried where it fails, or None.
        segments: one gap each, without a leading axis.
        key: consumed.
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
