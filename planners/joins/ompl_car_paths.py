"""OMPL side of `car_paths`: paths in the state space of Reeds and Shepp or of Dubins.

This module runs as a separate process: `python -m planners.joins.ompl_car_paths`.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any

import numpy as np

from planners.joins.ompl_process import DistanceField, OmplProblem, SamplingStage, serve
from planners.types import Floats


def _drives(base: Any, geometric: Any, request: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Answer the query of `connect_car`: the poses of every solution, joined by shortest curves."""
    kind = base.ReedsSheppStateSpace if request["backward"] else base.DubinsStateSpace
    problem = _CarProblem(base, geometric, kind(float(request["radius"])), request, _is_valid)
    found = problem.solve(request["start"], request["goals"])
    return {"poses": np.concatenate([np.zeros((0, 3)), *found]), "lengths": [len(poses) for poses in found]}


def _is_valid(field: DistanceField, state: Any) -> bool:
    """Return whether a state keeps the clearance, as a Python bool, which OMPL requires."""
    return bool(field.value(state.getX(), state.getY()) >= field.clearance)


class _CarProblem(OmplProblem):
    """Paths of a car."""

    stages = (
        SamplingStage(window=2.0, max_step=1.0, iterations=800),
        SamplingStage(window=np.inf, max_step=2.0, iterations=1_500),
        SamplingStage(window=np.inf, max_step=0.5, iterations=3_000),
    )
    n_solutions = 3

    def solve(self, start: Floats, goals: Floats) -> list[Floats]:
        """Return the poses (k, 3) of paths to one of the goals (m, 3)."""
        self.set_clearance(start[None, :2])
        places = np.concatenate([start[None], goals])[:, :2]
        return self.solutions(self._state(start), [self._state(goal) for goal in goals], places)

    def path_of(self, path: Any, simplifier: Any) -> Floats | None:
        """Shorten a solution and return its poses (k, 3); None if it is not valid."""
        for _ in range(2):
            simplifier.reduceVertices(path)
            simplifier.partialShortcutPath(path)
        simplifier.reduceVertices(path)
        if not path.check():
            return None
        states = [path.getState(k) for k in range(path.getStateCount())]
        return np.array([[state.getX(), state.getY(), state.getYaw()] for state in states])

    def _state(self, pose: Floats) -> Any:
        state, (x, y, phi) = self.space.allocState(), pose.tolist()
        state.setXY(x, y)
        state.setYaw(np.pi - (np.pi - phi) % (2 * np.pi))
        return state


if __name__ == "__main__":
    sys.exit(serve(_drives))
