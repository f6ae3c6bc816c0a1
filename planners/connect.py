"""OMPL: collision-free moves where the straight one is blocked. The only file that imports ompl for plans.

OMPL works in a process of its own, seeded once as its first call: the same queries give the same paths whatever
ran before (its random streams advance over a whole process), a crash in the bindings becomes an error here, and
what the bindings leak or print at their exit stays there. Searches stop by count, never by the clock, so that a
plan does not depend on the load of the machine. Run as `python -m planners.connect` this file is that process.
"""

from __future__ import annotations

import io
import os
import subprocess
import sys
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import csgraph

from planners.arena import Floats
from planners.clearance import Barriers
from planners.errors import PlanError
from planners.reach import Reach
from planners.rooms import cell_graph

INSTALL = "OMPL is not installed; pip install 'ompl>=2.0.1,<2.1' (Linux or macOS 15+; on Windows use WSL)"
MISSING = 3
"""Exit code of the process when ompl cannot be imported."""
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
MOST_GOALS = 400
"""Of one query, the nearest ones."""
LEG = 4.0
"""[m] of the parts of a way that OMPL does not find as a whole."""
BATCH = 48
"""Queries for one process; batches run side by side, and do not depend on how many do."""
ROPE = 15
"""Parts that a path is cut into to be pulled straight; the time goes with its square."""
CHECK_STEP = 0.01
"""[m] between the states of a motion that OMPL checks."""
TURN_COST = 0.5
"""[m] that a corner costs when solutions are compared: turning takes time."""
SLACK = 0.002
"""[m] that OMPL keeps beyond the clearance, where start and goal do; where none does, it may miss as much."""


@dataclass(frozen=True, kw_only=True)
class Joins:
    """How the moves between primitives came about."""

    direct: int = 0
    """Straight moves that are clear."""
    planned: int = 0
    """Moves that OMPL planned."""
    failed: int = 0
    """Moves for which OMPL found no path."""
    planned_m: float = 0.0
    """[m] of all planned moves."""

    def __add__(self, other: Joins) -> Joins:
        return Joins(
            direct=self.direct + other.direct,
            planned=self.planned + other.planned,
            failed=self.failed + other.failed,
            planned_m=self.planned_m + other.planned_m,
        )


def connect(
    starts: Floats, ends: Floats, *, reach: Reach, barriers: Barriers, seed: int
) -> tuple[list[Floats | None], Joins]:
    """Find a path for each move (n, 2) -> (n, 2) [m]: straight if clear, else by OMPL.

    Returns
    -------
    paths : (k, 2) [m] with both ends, k = 2 for a straight one; None where no path was found
    """
    direct = barriers.are_clear(starts, ends, reach.clearance)
    paths: list[Floats | None] = [np.stack(ends_) for ends_ in zip(starts, ends, strict=True)]
    blocked = np.flatnonzero(~direct)
    if len(blocked):
        found = _in_processes(starts[blocked], ends[blocked], reach, seed)
        for k, way in zip(blocked.tolist(), found, strict=True):
            paths[k] = _certified(way, barriers, reach.clearance)
            if paths[k] is None:
                paths[k] = _certified(way, barriers, reach.clearance - SLACK)
            if paths[k] is None:
                paths[k] = _by_legs(starts[k], ends[k], reach, barriers, seed)
    planned = [path for k in blocked.tolist() if (path := paths[k]) is not None]
    return paths, Joins(
        direct=int(direct.sum()),
        planned=len(planned),
        failed=len(blocked) - len(planned),
        planned_m=float(sum(np.hypot(*np.diff(path, axis=0).T).sum() for path in planned)),
    )


def connect_nearest(
    start: Floats, goals: Floats, *, reach: Reach, barriers: Barriers, seed: int
) -> tuple[Floats | None, Joins]:
    """Find a path from a place (2,) to one of the goals (m, 2) [m]: straight to the nearest if clear, else by OMPL.

    One query holds them all (`ob.GoalStates`).

    Returns
    -------
    path : (k, 2) [m] with both ends; None where none was found
    """
    nearest = np.argsort(np.hypot(*(goals - start).T), kind="stable")
    clear = barriers.are_clear(np.repeat(start[None], len(goals), axis=0), goals[nearest], reach.clearance)
    if clear.any():
        return np.stack([start, goals[nearest[clear.argmax()]]]), Joins(direct=1)
    (way,) = _in_a_process(start[None], [goals[nearest[:MOST_GOALS]]], reach, seed)
    path = _certified(way, barriers, reach.clearance)
    if path is None:
        path = _certified(way, barriers, reach.clearance - SLACK)
    if path is None:
        path = _by_legs(start, goals[nearest[0]], reach, barriers, seed)
    if path is None:
        return None, Joins(failed=1)
    return path, Joins(planned=1, planned_m=float(np.hypot(*np.diff(path, axis=0).T).sum()))


def _by_legs(start: Floats, end: Floats, reach: Reach, barriers: Barriers, seed: int) -> Floats | None:
    """Find a path (k, 2) [m] that OMPL did not find as a whole, over places on the shortest way from cell to cell."""
    at = [np.floor((place - reach.origin) / reach.cell).astype(np.int64) for place in (start, end)]
    first, last = (int(np.ravel_multi_index(tuple(cell), reach.shape)) for cell in at)
    far, before = csgraph.dijkstra(
        cell_graph(reach), directed=False, indices=np.array([first]), return_predecessors=True
    )
    if not LEG / reach.cell < far[0, last] < np.inf:
        return None
    route = [last]
    while route[-1] != first:
        route.append(int(before[0, route[-1]]))
    cells = np.unravel_index(route[::-1][:: max(round(LEG / reach.cell), 1)][1:], reach.shape)
    depth = np.where(reach.blocks(reach.mask)[cells], reach.blocks(reach.distance)[cells], 0.0)
    node = depth.argmax(axis=1)
    within = np.column_stack([node // reach.per_cell, node % reach.per_cell])
    between = reach.origin + np.column_stack(cells) * reach.cell + (within + 0.5) * reach.step
    stops = np.concatenate([start[None], between, end[None]])
    legs, _ = connect(stops[:-1], stops[1:], reach=reach, barriers=barriers, seed=seed)
    found = [leg for leg in legs if leg is not None]
    return np.concatenate([start[None], *(leg[1:] for leg in found)]) if len(found) == len(legs) else None


def _certified(path: Floats, barriers: Barriers, clearance: float) -> Floats | None:
    """Leave out corners that are not needed; None unless the exact clearance holds all along."""
    if len(path) < 2:
        return None
    kept = [0]
    while kept[-1] < len(path) - 1:
        later = np.arange(len(path) - 1, kept[-1], -1)
        here = np.repeat(path[kept[-1]][None], len(later), axis=0)
        clear = barriers.are_clear(here, path[later], clearance)
        if not clear.any():
            return None
        kept.append(int(later[clear.argmax()]))
    return path[kept]


def _in_processes(starts: Floats, ends: Floats, reach: Reach, seed: int) -> list[Floats]:
    """Solve queries (n, 2) -> (n, 2) [m], in as many processes as there are processors."""
    goals = list(ends[:, None])
    batches = [slice(k, k + BATCH) for k in range(0, len(starts), BATCH)]
    seeds = [int(np.random.SeedSequence([seed, k]).generate_state(1)[0]) for k in range(len(batches))]
    if len(batches) == 1:
        return _in_a_process(starts, goals, reach, seeds[0])
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        answers = threads.map(
            lambda batch, own: _in_a_process(starts[batch], goals[batch], reach, own), batches, seeds
        )
        return [path for answer in answers for path in answer]


def _in_a_process(starts: Floats, goals: list[Floats], reach: Reach, seed: int) -> list[Floats]:
    """Solve queries (n, 2) [m], each to one of some goals (m, 2), in a fresh process; empty: no path was found."""
    data = ask(
        "planners.connect",
        seed=seed,
        starts=starts,
        goals=np.concatenate(goals),
        counts=[len(own) for own in goals],
        **field_of(reach),
    )
    return list(np.split(data["points"], np.cumsum(data["lengths"])[:-1]))


def field_of(reach: Reach) -> dict[str, Any]:
    """Return what a process must know of the floor."""
    return {
        "distance": reach.distance,
        "origin": reach.origin,
        "step": reach.step,
        "clearance": reach.clearance,
    }


def ask(module: str, **question: Any) -> dict[str, np.ndarray]:
    """Run a module of ours as a fresh process that answers a question; both are arrays by name."""
    package = Path(__file__).parent.parent
    others = [path for path in os.environ.get("PYTHONPATH", "").split(os.pathsep) if path]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(package), *others])}
    sent = io.BytesIO()
    np.savez(sent, **question)
    with subprocess.Popen(
        [sys.executable, "-P", "-m", module],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=environment,
    ) as process:
        try:
            answer, complaint = process.communicate(sent.getvalue())
        except BaseException:
            process.kill()
            raise
    if process.returncode == MISSING:
        raise PlanError(INSTALL)
    if process.returncode != 0:
        last = complaint.decode(errors="replace").strip().splitlines()[-1:] or ["no message"]
        raise PlanError(
            f"OMPL ended with code {process.returncode} ({last[0]}); please report the arena and seed"
        )
    with np.load(io.BytesIO(answer)) as data:
        return dict(data)


def serve(work: Callable[[Any, Any, Mapping[str, np.ndarray]], dict[str, Any]]) -> int:
    """Answer the question on standard input by `work(ompl.base, ompl.geometric, question)`; return an exit code."""
    try:
        from ompl import base, geometric, util  # type: ignore[import-untyped]
    except ImportError:
        return MISSING
    with np.load(io.BytesIO(sys.stdin.buffer.read())) as data:
        question = dict(data)
    util.RNG.setSeed(int(question["seed"]) % (2**31 - 1) + 1)  # must be the first call; 0 is refused
    util.setLogLevel(util.LOG_NONE)
    answer = io.BytesIO()
    np.savez(answer, **work(base, geometric, question))
    sys.stdout.buffer.write(answer.getvalue())
    sys.stdout.buffer.flush()
    return 0


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


class Countdown:
    """Say stop after so many questions."""

    def __init__(self, left: int) -> None:
        self.left = left

    def __call__(self) -> bool:
        self.left -= 1
        return self.left < 0


class Field:
    """The distance field as plain lists, which a callback reads several times faster than an array."""

    def __init__(self, distance: Floats, origin: Floats, step: float) -> None:
        self.rows: list[list[float]] = distance.tolist()
        self.low = (float(origin[0] + step / 2), float(origin[1] + step / 2))
        self.step = step
        self.size = (distance.shape[0] - 1, distance.shape[1] - 1)
        self.least = 0.0

    def value(self, x: float, y: float) -> float:
        """Interpolate the distance [m]; 0 off the raster."""
        u, v = (x - self.low[0]) / self.step, (y - self.low[1]) / self.step
        i, j = int(u), int(v)
        if (
            u < 0 or v < 0 or i >= self.size[0] or j >= self.size[1]
        ):  # bounds are closed: x may be the far one
            return 0.0
        a, b = u - i, v - j
        near, far = self.rows[i], self.rows[i + 1]
        return (1 - a) * ((1 - b) * near[j] + b * near[j + 1]) + a * ((1 - b) * far[j] + b * far[j + 1])

    def is_valid(self, state: Any) -> bool:
        """Answer OMPL, with a real bool."""
        return bool(self.value(state[0], state[1]) >= self.least)


if __name__ == "__main__":
    sys.exit(serve(_paths))
