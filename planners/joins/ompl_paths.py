"""OMPL's side of `connect`: paths in the plane, by RRTConnect and its simplifier.

Run as `python -m planners.joins.ompl_paths` this file is the process that answers.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any

import numpy as np

from planners.joins.ompl_process import CHECK_STEP, SLACK, Countdown, Field, serve
from planners.types import Floats

ATTEMPTS = 2
"""Solutions for each query, of which the best is kept."""
SEARCHES = (
    (1.0, 0.3, 1_000),
    (4.0, 1.0, 2_000),
    (np.inf, 2.0, 4_000),
    (0.3, 0.05, 8_000),
    (1.5, 0.1, 8_000),
)
"""Window [m] around start and goal to sample in, longest step [m], iterations; the first to succeed is used.

Most ways are short; the last two find gaps that the coarser ones miss.
"""
ROPE = 15
"""Parts that a path is cut into to be pulled straight; the time goes with its square."""
TURN_COST = 0.5
"""[m] that a corner costs when solutions are compared: turning takes time."""


def _paths(base: Any, geometric: Any, question: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Answer queries (n, 2) [m], each with its goals."""
    solver = _Solver(base, geometric, question["distance"], question["origin"], float(question["step"]))
    clearance = float(question["clearance"])
    goals = np.split(question["goals"], np.cumsum(question["counts"])[:-1])
    paths = [
        solver.solve(start, own, clearance) for start, own in zip(question["starts"], goals, strict=True)
    ]
    return {"points": np.concatenate(paths), "lengths": [len(path) for path in paths]}


class _Solver:
    """One OMPL problem, used again for every query: leaks nothing, and its random streams go on."""

    def __init__(self, base: Any, geometric: Any, distance: Floats, origin: Floats, step: float) -> None:
        self.base, self.geometric = base, geometric
        self.field = Field(distance, origin, step)
        self.low, self.high = origin, origin + np.array(distance.shape) * step
        space = base.RealVectorStateSpace(2)
        space.setBounds(self._bounds(self.low, self.high))
        self.space = space
        self.setup = geometric.SimpleSetup(space)
        information = self.setup.getSpaceInformation()
        information.setStateValidityCheckingResolution(CHECK_STEP / space.getMaximumExtent())
        self.setup.setStateValidityChecker(self.field.is_valid)  # holds lists and floats, nothing of OMPL
        planner = geometric.RRTConnect(information)
        self.setup.setPlanner(planner)
        self.planner, self.iterations = planner, 0

    def solve(self, start: Floats, goals: Floats, clearance: float) -> Floats:
        """Return the best of some paths (k, 2) [m] to one of the goals (m, 2); (0, 2) if there is none."""
        here, there = self._state(*start), [self._state(*goal) for goal in goals]
        lowest = min(self.field.value(*place) for place in (start, *goals))
        self.field.least = min(clearance + SLACK, max(lowest, clearance)) - 1e-9
        places = np.concatenate([start[None], goals])
        for window, step, iterations in SEARCHES:
            self.planner.setRange(step)
            self.iterations = iterations
            low, high = places.min(axis=0) - window, places.max(axis=0) + window
            self.space.setBounds(self._bounds(np.maximum(low, self.low), np.minimum(high, self.high)))
            paths = [self._attempt(here, there)]
            if len(paths[0]):
                paths += [self._attempt(here, there) for _ in range(ATTEMPTS - 1)]
                return min((path for path in paths if len(path)), key=_cost)
            self.field.least = clearance - 1e-9
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
        self.setup.solve(self.base.PlannerTerminationCondition(Countdown(self.iterations)))
        if not self.setup.haveExactSolutionPath():  # the status is also true for approximate ones
            return np.zeros((0, 2))
        path = self.setup.getSolutionPath()
        simplifier = self.setup.getPathSimplifier()
        simplifier.reduceVertices(path)
        simplifier.ropeShortcutPath(path, max(0.1, path.length() / ROPE))
        simplifier.partialShortcutPath(path)
        simplifier.reduceVertices(path)
        states = [path.getState(k) for k in range(path.getStateCount())]
        return np.array([[state[0], state[1]] for state in states])

    def _state(self, x: float, y: float) -> Any:
        state = self.space.allocState()
        state[0], state[1] = float(x), float(y)
        return state


def _cost(path: Floats) -> float:
    return float(np.hypot(*np.diff(path, axis=0).T).sum()) + TURN_COST * len(path)


if __name__ == "__main__":
    sys.exit(serve(_paths))
