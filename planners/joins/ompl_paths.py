"""OMPL side of `paths`: paths in the plane by RRTConnect, or another given planner, and OMPL's path simplifier.

This module runs as a separate process: `python -m planners.joins.ompl_paths`.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any

import numpy as np

from planners.joins.ompl_process import DistanceField, OmplProblem, SamplingStage, serve
from planners.types import Floats

N_ROPE_PARTS = 15
"""Number of parts into which a path is cut to be straightened; the time grows with its square."""
CORNER_COST = 0.5
"""[m] Cost of a corner when solutions are compared, since turning takes time."""


def _paths(base: Any, geometric: Any, request: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Answer queries from places (n, 2) [m], each with its goals."""
    problem = _PlaneProblem(base, geometric, base.RealVectorStateSpace(2), request, _is_valid)
    goals = np.split(request["goals"], np.cumsum(request["counts"])[:-1])
    paths = [problem.solve(start, own) for start, own in zip(request["starts"], goals, strict=True)]
    return {"points": np.concatenate(paths), "lengths": [len(path) for path in paths]}


def _is_valid(field: DistanceField, state: Any) -> bool:
    """Return whether a state keeps the clearance, as a Python bool, which OMPL requires."""
    return bool(field.value(state[0], state[1]) >= field.clearance)


class _PlaneProblem(OmplProblem):
    """Paths of a robot that turns in place."""

    stages = (
        SamplingStage(window=1.0, max_step=0.3, iterations=1_000),
        SamplingStage(window=4.0, max_step=1.0, iterations=2_000),
        SamplingStage(window=np.inf, max_step=2.0, iterations=4_000),
        SamplingStage(window=0.3, max_step=0.05, iterations=8_000),
        SamplingStage(window=1.5, max_step=0.1, iterations=8_000),
    )
    """Most paths are short; the last two stages find gaps that the coarser ones miss."""
    n_solutions = 2

    def solve(self, start: Floats, goals: Floats) -> Floats:
        """Return the best path (k, 2) [m] to one of the goals (m, 2); (0, 2) if none is found."""
        here, there = self._state(*start), [self._state(*goal) for goal in goals]
        places = np.concatenate([start[None], goals])
        self.set_clearance(places)
        path = self.best_path(here, there, places)
        return np.zeros((0, 2)) if path is None else np.asarray(path)

    def path_of(self, path: Any, simplifier: Any, goals: list[Any]) -> Floats:
        """Straighten a solution and return its corners (k, 2) [m]."""
        simplifier.reduceVertices(path)
        simplifier.ropeShortcutPath(path, max(0.1, path.length() / N_ROPE_PARTS))
        simplifier.partialShortcutPath(path)
        simplifier.reduceVertices(path)
        states = [path.getState(k) for k in range(path.getStateCount())]
        return np.array([[state[0], state[1]] for state in states])

    def cost(self, path: Floats) -> float:
        """Return the length, and a cost for each corner."""
        return float(np.hypot(*np.diff(path, axis=0).T).sum()) + CORNER_COST * len(path)

    def _state(self, x: float, y: float) -> Any:
        state = self.space.allocState()
        state[0], state[1] = float(x), float(y)
        return state


if __name__ == "__main__":
    sys.exit(serve(_paths))
