"""OMPL side of `paths`: paths in the plane by RRTConnect, or another given planner, and OMPL's path simplifier.

This module runs as a separate process: `python -m planners.joins.ompl_paths`.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any

import numpy as np

from planners.joins.ompl_process import DistanceField, IterationLimit, planner_named, serve
from planners.joins.settings import JOINS, PLANE_PATHS
from planners.types import Floats


def _paths(base: Any, geometric: Any, request: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Answer queries from places (n, 2) [m], each with its goals."""
    solver = _PlaneSolver(base, geometric, request)
    clearance = float(request["clearance"])
    goals = np.split(request["goals"], np.cumsum(request["counts"])[:-1])
    paths = [solver.solve(start, own, clearance) for start, own in zip(request["starts"], goals, strict=True)]
    return {"points": np.concatenate(paths), "lengths": [len(path) for path in paths]}


class _PlaneSolver:
    """One OMPL problem, reused for every query, so that nothing leaks and its random streams continue."""

    def __init__(self, base: Any, geometric: Any, request: Mapping[str, np.ndarray]) -> None:
        distance, origin, step = request["distance"], request["origin"], float(request["step"])
        self.base, self.geometric = base, geometric
        self.field = DistanceField(distance, origin, step)
        self.low, self.high = origin, origin + np.array(distance.shape) * step
        space = base.RealVectorStateSpace(2)
        space.setBounds(self._bounds(self.low, self.high))
        self.space = space
        self.setup = geometric.SimpleSetup(space)
        information = self.setup.getSpaceInformation()
        information.setStateValidityCheckingResolution(JOINS.check_step / space.getMaximumExtent())
        self.setup.setStateValidityChecker(self.field.is_valid)  # holds lists and floats, no OMPL object
        planner = planner_named(str(request["planner"]), geometric, information)
        self.setup.setPlanner(planner)
        self.planner, self.iterations = planner, 0

    def solve(self, start: Floats, goals: Floats, clearance: float) -> Floats:
        """Return the best path (k, 2) [m] to one of the goals (m, 2); (0, 2) if none is found."""
        here, there = self._state(*start), [self._state(*goal) for goal in goals]
        lowest = min(self.field.value(*place) for place in (start, *goals))
        self.field.clearance = min(clearance + JOINS.clearance_slack, max(lowest, clearance)) - 1e-9
        places = np.concatenate([start[None], goals])
        for stage in PLANE_PATHS.stages:
            if hasattr(self.planner, "setRange"):
                self.planner.setRange(stage.max_step)
            self.iterations = stage.iterations
            low, high = places.min(axis=0) - stage.window, places.max(axis=0) + stage.window
            self.space.setBounds(self._bounds(np.maximum(low, self.low), np.minimum(high, self.high)))
            paths = [self._attempt(here, there)]
            if len(paths[0]):
                paths += [self._attempt(here, there) for _ in range(PLANE_PATHS.solutions - 1)]
                return min((path for path in paths if len(path)), key=_cost)
            self.field.clearance = clearance - 1e-9
        return np.zeros((0, 2))

    def _bounds(self, low: Floats, high: Floats) -> Any:
        bounds = self.base.RealVectorBounds(2)
        for axis in range(2):
            bounds.setLow(axis, float(low[axis]))
            bounds.setHigh(axis, float(high[axis]))
        return bounds

    def _attempt(self, here: Any, there: list[Any]) -> Floats:
        goals = self.base.GoalStates(self.setup.getSpaceInformation())
        for state in there:
            goals.addState(state)
        self.setup.clear()
        self.setup.setStartState(here)
        self.setup.setGoal(goals)
        self.setup.solve(self.base.PlannerTerminationCondition(IterationLimit(self.iterations)))
        if not self.setup.haveExactSolutionPath():  # the status is true for approximate solutions too
            return np.zeros((0, 2))
        path = self.setup.getSolutionPath()
        simplifier = self.setup.getPathSimplifier()
        simplifier.reduceVertices(path)
        simplifier.ropeShortcutPath(path, max(0.1, path.length() / PLANE_PATHS.rope_parts))
        simplifier.partialShortcutPath(path)
        simplifier.reduceVertices(path)
        states = [path.getState(k) for k in range(path.getStateCount())]
        return np.array([[state[0], state[1]] for state in states])

    def _state(self, x: float, y: float) -> Any:
        state = self.space.allocState()
        state[0], state[1] = float(x), float(y)
        return state


def _cost(path: Floats) -> float:
    return float(np.hypot(*np.diff(path, axis=0).T).sum()) + PLANE_PATHS.corner_cost * len(path)


if __name__ == "__main__":
    sys.exit(serve(_paths))
