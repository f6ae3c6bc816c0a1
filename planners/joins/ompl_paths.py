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
    """Answer queries from places (n, 2) to others (n, 2) [m]."""
    problem = _PlaneProblem(base, geometric, base.RealVectorStateSpace(2), request, _is_valid)
    paths = [problem.solve(*places) for places in zip(request["starts"], request["ends"], strict=True)]
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
    )
    """Most paths are short. Gaps that these stages miss are left to the raster (`paths.raster_path`)."""
    n_solutions = 2

    def solve(self, start: Floats, end: Floats) -> Floats:
        """Return the best path (k, 2) [m] from one place (2,) to another; (0, 2) if none is found."""
        places = np.stack([start, end])
        self.set_clearance(places)
        found = self.solutions(self._state(*start), [self._state(*end)], places)
        return min(found, key=_cost, default=np.zeros((0, 2)))

    def path_of(self, path: Any, simplifier: Any) -> Floats:
        """Straighten a solution and return its corners (k, 2) [m]."""
        simplifier.reduceVertices(path)
        simplifier.ropeShortcutPath(path, max(0.1, path.length() / N_ROPE_PARTS))
        simplifier.partialShortcutPath(path)
        simplifier.reduceVertices(path)
        states = [path.getState(k) for k in range(path.getStateCount())]
        return np.array([[state[0], state[1]] for state in states])

    def _state(self, x: float, y: float) -> Any:
        state = self.space.allocState()
        state[0], state[1] = float(x), float(y)
        return state


def _cost(path: Floats) -> float:
    """Return the length [m] of a path (k, 2), and a cost for each corner."""
    return float(np.hypot(*np.diff(path, axis=0).T).sum()) + CORNER_COST * len(path)


if __name__ == "__main__":
    sys.exit(serve(_paths))
