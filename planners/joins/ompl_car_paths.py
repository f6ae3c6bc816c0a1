"""OMPL side of `car_paths`: paths in the state space of Reeds and Shepp or of Dubins.

This module runs as a separate process: `python -m planners.joins.ompl_car_paths`.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Any

import numpy as np

from planners.joins.ompl_process import DistanceField, OmplProblem, SamplingStage, serve
from planners.types import Floats
from planners.vehicle import SHORTEST_ARC

SAME_POSE = 1e-7
"""[m, rad] Poses closer than this are equal."""

N_DIRECT_GOALS = 16
"""Number of goals to which the shortest curve is tried before OMPL samples."""
CHATTER_COST = 10.0
"""[m] Cost of an arc too short to steer when solutions are compared."""
ArcRows = Floats
"""(k, 3) gear (1, -1), bend (1 counter-clockwise, 0 straight, -1 clockwise) and length [m] of each arc of a path."""


def _drives(base: Any, geometric: Any, request: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Answer the queries of `connect_cars`."""
    problem = _CarProblem(base, geometric, request)
    goals = np.split(request["goals"], np.cumsum(request["counts"])[:-1])
    found = [problem.solve(start, own) for start, own in zip(request["starts"], goals, strict=True)]
    return {
        "arcs": np.concatenate([arcs for arcs, _, _ in found]),
        "lengths": [len(arcs) for arcs, _, _ in found],
        "goal": [goal for _, goal, _ in found],
        "direct": [direct for _, _, direct in found],
    }


def _is_valid(field: DistanceField, state: Any) -> bool:
    """Return whether a state keeps the clearance, as a Python bool, which OMPL requires."""
    return bool(field.value(state.getX(), state.getY()) >= field.clearance)


class _CarProblem(OmplProblem):
    """Paths of a car: rows of arcs, and the index of the goal."""

    stages = (
        SamplingStage(window=2.0, max_step=1.0, iterations=800),
        SamplingStage(window=np.inf, max_step=2.0, iterations=1_500),
        SamplingStage(window=np.inf, max_step=0.5, iterations=3_000),
    )
    n_solutions = 3

    def __init__(self, base: Any, geometric: Any, request: Mapping[str, np.ndarray]) -> None:
        self.radius, self.gear_change_cost = float(request["radius"]), float(request["gear_change_cost"])
        self.gears = (1.0, -1.0) if request["backward"] else (1.0,)
        kind = base.ReedsSheppStateSpace if request["backward"] else base.DubinsStateSpace
        super().__init__(base, geometric, kind(self.radius), request, _is_valid)
        self.is_ready = False

    def solve(self, start: Floats, goals: Floats) -> tuple[ArcRows, int, bool]:
        """Return the arcs to one of the goals (m, 3), its index (-1: no path), and whether it is the shortest curve."""
        if not len(goals):
            return np.zeros((0, 3)), -1, False
        here, there = self._state(start), [self._state(goal) for goal in goals]
        self.set_clearance(start[None, :2])
        self.state_query(here, there)
        if not self.is_ready:  # OMPL crashes in setup() without a start and a goal
            self.setup.setup()
            self.is_ready = True
        far = np.array([self.space.distance(here, goal) for goal in there])
        clear = [
            (np.array(list(self._arcs(here, there[k]))).reshape(-1, 3), k, True)
            for k in np.argsort(far, kind="stable")[:N_DIRECT_GOALS].tolist()
            if self.information.checkMotion(here, there[k])
        ]
        if clear:
            return min(clear, key=lambda path: _n_chatter(path[0]))
        found = self.best_path(here, there, np.concatenate([start[None], goals])[:, :2])
        return (np.zeros((0, 3)), -1, False) if found is None else (*found, False)

    def path_of(self, path: Any, simplifier: Any, goals: list[Any]) -> tuple[ArcRows, int] | None:
        """Shorten a solution and return its arcs and the index of its goal; None if it is not valid."""
        for _ in range(2):
            simplifier.reduceVertices(path)
            simplifier.partialShortcutPath(path)
        simplifier.reduceVertices(path)
        if not path.check():
            return None
        states = [path.getState(k) for k in range(path.getStateCount())]
        end = self._pose(states[-1])
        arcs = np.array([arc for a, b in pairwise(states) for arc in self._arcs(a, b)]).reshape(-1, 3)
        return arcs, int(np.argmin([abs(_difference(end, self._pose(state))).max() for state in goals]))

    def cost(self, path: tuple[ArcRows, int]) -> float:
        """Return the length, and a cost for each gear change and for each arc too short to steer."""
        arcs, _ = path
        stops = (np.diff(arcs[:, 0]) != 0).sum()
        return float(arcs[:, 2].sum() + self.gear_change_cost * stops + CHATTER_COST * _n_chatter(arcs))

    def _arcs(self, a: Any, b: Any) -> Iterator[tuple[float, float, float]]:
        """Yield gear, bend and length [m] of the arcs of the shortest curve between two states.

        A stretch is one arc if a single arc leads from its start to its end; any other stretch is halved.
        """
        length, between = float(self.space.distance(a, b)), self.space.allocState()

        def pose(at: float) -> Floats:
            self.space.interpolate(a, b, min(at / max(length, SAME_POSE), 1.0), between)
            return self._pose(between)

        last: tuple[float, float, float] | None = None
        left = [(0.0, length)]
        while left:
            low, high = left.pop()
            if high - low < 0.1 * SAME_POSE:
                continue
            kind = self._arc_kind(pose(low), pose(high), high - low)
            if kind is None:
                middle = 0.5 * (low + high)
                left += [(middle, high), (low, middle)]
            elif last is not None and last[:2] == kind:
                last = (*kind, last[2] + high - low)
            else:
                if last is not None:
                    yield last
                last = (*kind, high - low)
        if last is not None:
            yield last

    def _arc_kind(self, start: Floats, end: Floats, length: float) -> tuple[float, float] | None:
        """Return gear and bend of the arc between two poses; None if no single arc joins them."""
        for gear in self.gears:
            for bend in (0.0, 1.0, -1.0):
                there = arc_end(start, gear, bend, length, self.radius)
                if abs(_difference(there, end)).max() < 0.1 * SAME_POSE:
                    return gear, bend
        return None

    def _state(self, pose: Floats) -> Any:
        state = self.space.allocState()
        state.setXY(float(pose[0]), float(pose[1]))
        state.setYaw(wrap(float(pose[2])))
        return state

    @staticmethod
    def _pose(state: Any) -> Floats:
        return np.array([state.getX(), state.getY(), state.getYaw()])


def arc_end(pose: Floats, gear: float, bend: float, length: float, radius: float) -> Floats:
    """Return the pose (3,) at the end of an arc of a length [m]."""
    x, y, phi = pose.tolist()
    turned = phi + bend * length / radius
    if bend == 0:
        return np.array([x + gear * length * np.cos(phi), y + gear * length * np.sin(phi), phi])
    side = gear * bend * radius
    return np.array(
        [x + side * (np.sin(turned) - np.sin(phi)), y - side * (np.cos(turned) - np.cos(phi)), turned]
    )


def _difference(a: Floats, b: Floats) -> Floats:
    """Return the difference (3,) of two poses, with the heading wrapped."""
    return np.append(a[:2] - b[:2], wrap(float(a[2] - b[2])))


def _n_chatter(arcs: ArcRows) -> int:
    """Count the arcs shorter than `SHORTEST_ARC`."""
    return int((arcs[:, 2] < SHORTEST_ARC).sum())


def wrap(angle: float) -> float:
    """Wrap an angle [rad] into (-pi, pi]."""
    return np.pi - (np.pi - angle) % (2 * np.pi)


if __name__ == "__main__":
    sys.exit(serve(_drives))
