"""OMPL side of `car_paths`: paths in the state space of Reeds and Shepp or of Dubins.

This module runs as a separate process: `python -m planners.joins.ompl_car_paths`.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Any

import numpy as np

from planners.joins.ompl_process import DistanceField, IterationLimit, planner_named, serve
from planners.joins.settings import CAR_PATHS, JOINS
from planners.types import Floats
from planners.vehicle import SHORTEST_ARC

SAME_POSE = 1e-7
"""[m, rad] Poses closer than this are equal."""

ArcRows = Floats
"""(k, 3) gear (1, -1), bend (1 counter-clockwise, 0 straight, -1 clockwise) and length [m] of each arc of a path."""


def _drives(base: Any, geometric: Any, request: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Answer the queries of `connect_cars`."""
    solver = _CarSolver(base, geometric, request)
    goals = np.split(request["goals"], np.cumsum(request["counts"])[:-1])
    found = [solver.solve(start, own) for start, own in zip(request["starts"], goals, strict=True)]
    return {
        "arcs": np.concatenate([arcs for arcs, _, _ in found]),
        "lengths": [len(arcs) for arcs, _, _ in found],
        "goal": [goal for _, goal, _ in found],
        "direct": [direct for _, _, direct in found],
    }


class _CarSolver:
    """One OMPL problem in a car's state space, reused for every query."""

    def __init__(self, base: Any, geometric: Any, request: Mapping[str, np.ndarray]) -> None:
        distance, origin, step = request["distance"], request["origin"], float(request["step"])
        self.base, self.radius = base, float(request["radius"])
        self.gears = (1.0, -1.0) if request["backward"] else (1.0,)
        kind = base.ReedsSheppStateSpace if request["backward"] else base.DubinsStateSpace
        self.space = kind(self.radius)
        self.low, self.high = origin, origin + np.array(distance.shape) * step
        self._bound(self.low, self.high)
        self.setup = geometric.SimpleSetup(self.space)
        self.information = self.setup.getSpaceInformation()
        self.information.setStateValidityCheckingResolution(JOINS.check_step / self.space.getMaximumExtent())
        self.clearance = float(request["clearance"])
        self.field = field = DistanceField(distance, origin, step)
        self.setup.setStateValidityChecker(
            lambda state: bool(field.value(state.getX(), state.getY()) >= field.clearance)
        )
        self.planner = planner_named(str(request["planner"]), geometric, self.information)
        self.setup.setPlanner(self.planner)
        self.ready = False

    def solve(self, start: Floats, goals: Floats) -> tuple[ArcRows, int, bool]:
        """Return the arcs to one of the goals (m, 3), its index (-1: no path), and whether it is the shortest curve."""
        if not len(goals):
            return np.zeros((0, 3)), -1, False
        here, there = self._state(start), [self._state(goal) for goal in goals]
        lowest = self.field.value(*start[:2].tolist())
        self.field.clearance = min(self.clearance + JOINS.clearance_slack, max(lowest, self.clearance)) - 1e-9
        self._begin(here, there)
        far = np.array([self.space.distance(here, goal) for goal in there])
        clear = [
            (np.array(list(self._arcs(here, there[k]))).reshape(-1, 3), k, True)
            for k in np.argsort(far, kind="stable")[: CAR_PATHS.direct_goals].tolist()
            if self.information.checkMotion(here, there[k])
        ]
        if clear:
            return min(clear, key=lambda path: _n_chatter(path[0]))
        for stage in CAR_PATHS.stages:
            if hasattr(self.planner, "setRange"):
                self.planner.setRange(stage.max_step)
            places = np.concatenate([start[None], goals])[:, :2]
            self._bound(
                np.maximum(places.min(axis=0) - stage.window, self.low),
                np.minimum(places.max(axis=0) + stage.window, self.high),
            )
            first = self._attempt(here, there, stage.iterations)
            if first is not None:
                others = [
                    self._attempt(here, there, stage.iterations) for _ in range(CAR_PATHS.solutions - 1)
                ]
                found = [first, *(path for path in others if path is not None)]
                arcs, k = min(found, key=lambda path: _cost(path[0]))
                return arcs, k, False
            self.field.clearance = self.clearance - 1e-9
        return np.zeros((0, 3)), -1, False

    def _begin(self, here: Any, there: list[Any]) -> None:
        goals = self.base.GoalStates(self.information)
        for state in there:
            goals.addState(state)
        self.setup.clear()
        self.setup.setStartState(here)
        self.setup.setGoal(goals)
        if not self.ready:  # OMPL crashes in setup() without a start and a goal
            self.setup.setup()
            self.ready = True

    def _attempt(self, here: Any, there: list[Any], iterations: int) -> tuple[ArcRows, int] | None:
        self._begin(here, there)
        self.setup.solve(self.base.PlannerTerminationCondition(IterationLimit(iterations)))
        if not self.setup.haveExactSolutionPath():  # the status is true for approximate solutions too
            return None
        path = self.setup.getSolutionPath()
        simplifier = self.setup.getPathSimplifier()
        for _ in range(2):
            simplifier.reduceVertices(path)
            simplifier.partialShortcutPath(path)
        simplifier.reduceVertices(path)
        if not path.check():
            return None
        states = [path.getState(k) for k in range(path.getStateCount())]
        end = self._pose(states[-1])
        arcs = np.array([arc for a, b in pairwise(states) for arc in self._arcs(a, b)]).reshape(-1, 3)
        goal = int(np.argmin([abs(_difference(end, self._pose(state))).max() for state in there]))
        return arcs, goal

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
                if (
                    abs(_difference(arc_end(start, gear, bend, length, self.radius), end)).max()
                    < 0.1 * SAME_POSE
                ):
                    return gear, bend
        return None

    def _bound(self, low: Floats, high: Floats) -> None:
        bounds = self.base.RealVectorBounds(2)
        for axis in range(2):
            bounds.setLow(axis, float(low[axis]))
            bounds.setHigh(axis, float(high[axis]))
        self.space.setBounds(bounds)

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


def _cost(arcs: ArcRows) -> float:
    stops = (np.diff(arcs[:, 0]) != 0).sum()
    return float(
        arcs[:, 2].sum() + CAR_PATHS.gear_change_cost * stops + CAR_PATHS.chatter_cost * _n_chatter(arcs)
    )


def _n_chatter(arcs: ArcRows) -> int:
    """Count the arcs shorter than `SHORTEST_ARC`."""
    return int((arcs[:, 2] < SHORTEST_ARC).sum())


def wrap(angle: float) -> float:
    """Wrap an angle [rad] into (-pi, pi]."""
    return np.pi - (np.pi - angle) % (2 * np.pi)


if __name__ == "__main__":
    sys.exit(serve(_drives))
