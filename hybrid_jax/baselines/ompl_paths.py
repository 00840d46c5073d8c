# SPDX-License-Identifier: MIT
"""OMPL's RRT-Connect with any validity check (optional extra `ompl`)."""

import time
from collections.abc import Callable

import numpy as np
from ompl import base, geometric, util

RESOLUTION = 1 / 32
"""Distance of checked configurations along a motion [rad]."""

util.setLogLevel(util.LOG_ERROR)


class OmplPlanner:
    """RRT-Connect between configurations of one robot; OMPL chooses the range of its steps."""

    def __init__(self, low: np.ndarray, high: np.ndarray):
        """Set up the joint space.

        Args:
            low, high: `[joint]` limits [rad or m].
        """
        self.size = len(low)
        self.space = base.RealVectorStateSpace(self.size)
        bounds = base.RealVectorBounds(self.size)
        for joint in range(self.size):
            bounds.setLow(joint, float(low[joint]))
            bounds.setHigh(joint, float(high[joint]))
        self.space.setBounds(bounds)

    def _state(self, q: np.ndarray):
        state = self.space.allocState()
        for joint in range(self.size):
            state[joint] = float(q[joint])
        return state

    def solve(
        self,
        valid: Callable[[np.ndarray], bool],
        start: np.ndarray,
        goal: np.ndarray,
        seconds: float,
        simplify: bool = False,
    ) -> tuple[np.ndarray | None, float]:
        """Search for a path from start to goal.

        Args:
            valid: is a configuration `[joint]` free?
            start, goal: `[joint]` [rad or m].
            seconds: time after which the search gives up [s].
            simplify: whether OMPL shortens the path as it does by default; that time counts.

        Returns:
            Way points `[point, joint]` [rad or m] or None, and the time that it took [s].
        """
        setup, buffer = geometric.SimpleSetup(self.space), np.empty(self.size)

        def check(state) -> bool:
            for joint in range(self.size):
                buffer[joint] = state[joint]
            return bool(valid(buffer))

        setup.setStateValidityChecker(check)
        info = setup.getSpaceInformation()
        # OMPL's resolution is a share of the extent of the space
        info.setStateValidityCheckingResolution(RESOLUTION / self.space.getMaximumExtent())
        setup.setStartAndGoalStates(self._state(start), self._state(goal))
        setup.setPlanner(geometric.RRTConnect(info))
        began = time.perf_counter()
        setup.solve(seconds)
        if not setup.haveExactSolutionPath():
            return None, time.perf_counter() - began
        if simplify:
            setup.simplifySolution()
        elapsed, path = time.perf_counter() - began, setup.getSolutionPath()
        states = [path.getState(i) for i in range(path.getStateCount())]
        return np.array([[s[j] for j in range(self.size)] for s in states]), elapsed
