"""OMPL's side of `car_connect`: ways in the state space of Reeds and Shepp or of Dubins.

Run as `python -m planners.joins.ompl_car_paths` this file is the process that answers.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Any

import numpy as np

from planners.joins.ompl_process import CHECK_STEP, SLACK, Countdown, Field, serve
from planners.types import Floats
from planners.vehicle import SHORTEST_ARC

SEARCHES = ((2.0, 1.0, 800), (np.inf, 2.0, 1_500), (np.inf, 0.5, 3_000))
"""Window [m] around start and goals to sample in, longest step [m], iterations; the first to succeed is used."""
ATTEMPTS = 3
"""Solutions for each query, of which the best is kept."""
NEAREST = 16
"""Goals to which the shortest curve is tried."""
CUSP_COST = 0.6
"""[m] that a change of gear costs when solutions are compared: the car must stop."""
TWITCH_COST = 10.0
"""[m] that a shorter one costs when solutions are compared."""
SAME = 1e-7
"""[m, rad] poses closer than this are the same."""

Arcs = Floats
"""(k, 3) gear (1, -1), bend (1 turns counter-clockwise, 0 not, -1 clockwise), length [m] of the parts of a way."""


def _solve(base: Any, geometric: Any, question: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Answer the queries of `connect_cars`, with OMPL."""
    solver = _Solver(base, geometric, question)
    goals = np.split(question["goals"], np.cumsum(question["counts"])[:-1])
    found = [solver.solve(start, own) for start, own in zip(question["starts"], goals, strict=True)]
    return {
        "arcs": np.concatenate([arcs for arcs, _, _ in found]),
        "lengths": [len(arcs) for arcs, _, _ in found],
        "goal": [goal for _, goal, _ in found],
        "direct": [direct for _, _, direct in found],
    }


class _Solver:
    """One OMPL problem in a car's state space, used again for every query."""

    def __init__(self, base: Any, geometric: Any, question: Mapping[str, np.ndarray]) -> None:
        distance, origin, step = question["distance"], question["origin"], float(question["step"])
        self.base, self.radius = base, float(question["radius"])
        self.gears = (1.0, -1.0) if question["backward"] else (1.0,)
        kind = base.ReedsSheppStateSpace if question["backward"] else base.DubinsStateSpace
        self.space = kind(self.radius)
        self.low, self.high = origin, origin + np.array(distance.shape) * step
        self._bound(self.low, self.high)
        self.setup = geometric.SimpleSetup(self.space)
        self.information = self.setup.getSpaceInformation()
        self.information.setStateValidityCheckingResolution(CHECK_STEP / self.space.getMaximumExtent())
        self.clearance = float(question["clearance"])
        self.field = field = Field(distance, origin, step)
        self.setup.setStateValidityChecker(
            lambda state: bool(field.value(state.getX(), state.getY()) >= field.least)
        )
        self.planner = geometric.RRTConnect(self.information)
        self.setup.setPlanner(self.planner)
        self.ready = False

    def solve(self, start: Floats, goals: Floats) -> tuple[Arcs, int, bool]:
        """Return the arcs to one of the goals (m, 3), which one, and whether that is the shortest curve; -1: none."""
        if not len(goals):
            return np.zeros((0, 3)), -1, False
        here, there = self._state(start), [self._state(goal) for goal in goals]
        lowest = self.field.value(*start[:2].tolist())
        self.field.least = min(self.clearance + SLACK, max(lowest, self.clearance)) - 1e-9
        self._begin(here, there)
        far = np.array([self.space.distance(here, goal) for goal in there])
        clear = [
            (np.array(list(self._arcs(here, there[k]))).reshape(-1, 3), k, True)
            for k in np.argsort(far, kind="stable")[:NEAREST].tolist()
            if self.information.checkMotion(here, there[k])
        ]
        if clear:
            return min(clear, key=lambda way: _twitches(way[0]))
        for window, step, iterations in SEARCHES:
            self.planner.setRange(step)
            places = np.concatenate([start[None], goals])[:, :2]
            self._bound(
                np.maximum(places.min(axis=0) - window, self.low),
                np.minimum(places.max(axis=0) + window, self.high),
            )
            first = self._attempt(here, there, iterations)
            if first is not None:
                others = [self._attempt(here, there, iterations) for _ in range(ATTEMPTS - 1)]
                found = [first, *(way for way in others if way is not None)]
                arcs, k = min(found, key=lambda way: _cost(way[0]))
                return arcs, k, False
            self.field.least = self.clearance - 1e-9
        return np.zeros((0, 3)), -1, False

    def _begin(self, here: Any, there: list[Any]) -> None:
        goals = self.base.GoalStates(self.information)
        for state in there:
            goals.addState(state)
        self.setup.clear()
        self.setup.setStartState(here)
        self.setup.setGoal(goals)
        if not self.ready:  # crashes before there are a start and a goal
            self.setup.setup()
            self.ready = True

    def _attempt(self, here: Any, there: list[Any], iterations: int) -> tuple[Arcs, int] | None:
        self._begin(here, there)
        self.setup.solve(self.base.PlannerTerminationCondition(Countdown(iterations)))
        if not self.setup.haveExactSolutionPath():  # the status is also true for approximate ones
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
        goal = int(np.argmin([abs(_apart(end, self._pose(state))).max() for state in there]))
        return arcs, goal

    def _arcs(self, a: Any, b: Any) -> Iterator[tuple[float, float, float]]:
        """Yield the gear, bend and length [m] of the parts of the shortest curve between two states.

        A stretch whose end is where one arc would lead is that arc; any other is halved.
        """
        length, between = float(self.space.distance(a, b)), self.space.allocState()

        def pose(at: float) -> Floats:
            self.space.interpolate(a, b, min(at / max(length, SAME), 1.0), between)
            return self._pose(between)

        last: tuple[float, float, float] | None = None
        left = [(0.0, length)]
        while left:
            low, high = left.pop()
            if high - low < 0.1 * SAME:
                continue
            kind = self._kind(pose(low), pose(high), high - low)
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

    def _kind(self, start: Floats, end: Floats, length: float) -> tuple[float, float] | None:
        """Return gear and bend of the one arc between two poses; None if it is not one."""
        for gear in self.gears:
            for bend in (0.0, 1.0, -1.0):
                if abs(_apart(along(start, gear, bend, length, self.radius), end)).max() < 0.1 * SAME:
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


def along(pose: Floats, gear: float, bend: float, length: float, radius: float) -> Floats:
    """Return the pose (3,) at the end of an arc of some length [m]."""
    x, y, phi = pose.tolist()
    turned = phi + bend * length / radius
    if bend == 0:
        return np.array([x + gear * length * np.cos(phi), y + gear * length * np.sin(phi), phi])
    side = gear * bend * radius
    return np.array(
        [x + side * (np.sin(turned) - np.sin(phi)), y - side * (np.cos(turned) - np.cos(phi)), turned]
    )


def _apart(a: Floats, b: Floats) -> Floats:
    """Return (3,) the difference of two poses."""
    return np.append(a[:2] - b[:2], wrap(float(a[2] - b[2])))


def _cost(arcs: Arcs) -> float:
    stops = (np.diff(arcs[:, 0]) != 0).sum()
    return float(arcs[:, 2].sum() + CUSP_COST * stops + TWITCH_COST * _twitches(arcs))


def _twitches(arcs: Arcs) -> int:
    """Count arcs that are too short."""
    return int((arcs[:, 2] < SHORTEST_ARC).sum())


def wrap(angle: float) -> float:
    """Wrap an angle [rad] into (-pi, pi]."""
    return np.pi - (np.pi - angle) % (2 * np.pi)


if __name__ == "__main__":
    sys.exit(serve(_solve))
