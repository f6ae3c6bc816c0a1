"""The older planner of robots that turn in place: boustrophedon lanes, a spin in every cell, OMPL around obstacles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planners import order
from planners.clearance import Barriers
from planners.coverage import DWELL_PERIODS
from planners.curve import CurveBuilder
from planners.errors import PlanError
from planners.joins.paths import continued, join
from planners.methods.spins import choose_departure
from planners.order import CellGraph
from planners.priority import cell_bands
from planners.reach import MIN_SHARE, Reach
from planners.search.log_phases import missed
from planners.task import JoinCounts, PlannedDrive, Task
from planners.types import Bools, Floats, Ints

OVERLAP = 0.5
"""[s] overlap of turns and moves where there is enough free space."""
BLEND_ROOM = 0.012
"""[m] beyond the clearance that the blend of a move and a turn needs."""
NEAR_SHARE = 0.75
"""Share of the area required for reachability, above which cells are visited too: another raster may count them."""
MAX_ROUNDS = 4
"""Maximum number of extra rounds for bins that a log may miss."""
ZIGZAG = 0.22
"""Alternating lean of a lane's moves to the left and right, as a share of the width of a heading bin; each spin is
shorter by twice that."""


def plan_stop_and_spin(task: Task) -> PlannedDrive:
    """Visit every cell with a missing heading, in an order that saves time.

    Raises
    ------
    PlanError : The vehicle cannot turn in place, or every bin is covered already.
    """
    if task.vehicle.drive != "diff":
        raise PlanError(
            f"planner stop_and_spin turns on the spot, which drive {task.vehicle.drive!r} cannot do; "
            "use the planner coverage"
        )
    return StopAndSpinPlanner(task, bins_to_visit(task)).run()


def bins_to_visit(task: Task) -> Bools:
    """Return the bins (nx, ny, n_phi) to visit: those still missing, also in cells that almost count as reachable.

    Raises
    ------
    PlanError : Every bin is covered already.
    """
    todo = task.coverage.reachable & (task.coverage.counts == 0)
    near = (task.reach.areas() >= NEAR_SHARE * MIN_SHARE) & ~task.reach.cells()
    todo |= (near & task.reach.blocks(task.reach.mask).any(axis=-1))[:, :, None] & (task.coverage.counts == 0)
    if not todo.any():
        raise PlanError("every reachable bin is covered already; nothing is left to plan")
    return np.asarray(todo)


Leg = tuple[Floats, Bools | None, str]
"""End (2,) [m] of a leg, the headings (n_phi,) to turn through there (None: a corner), and its label."""


class StopAndSpinPlanner:
    """Stop in every cell of `todo`, and leave each stop towards the next one."""

    def __init__(self, task: Task, todo: Bools) -> None:
        self.task, self.todo = task, todo
        self.clearance = task.reach.clearance
        width = 2 * np.pi / task.coverage.headings
        self.spin = width * task.rate / DWELL_PERIODS
        self.joins = JoinCounts()
        self.lost: Bools = np.zeros_like(todo)
        """(nx, ny, n_phi) bins to which no path was found."""
        self.builder: CurveBuilder | None = None

    def run(self) -> PlannedDrive:
        """Visit all cells, then visit again those with bins that the log of some phase misses."""
        self._visit(self.todo)
        missing = self._missed()
        for _ in range(MAX_ROUNDS):
            if not missing.any():
                break
            self._visit(missing)
            missing, before = self._missed(), missing
            if np.array_equal(missing, before):
                break
        assert self.builder is not None
        return replace(PlannedDrive.of(self.builder, self.joins), lost=self.lost)

    def _missed(self) -> Bools:
        """Return the bins (nx, ny, n_phi) that the log of at least one phase misses."""
        assert self.builder is not None
        grid = self.task.coverage
        return missed(self.builder.curve(), self.todo, grid, self.task.rate) & grid.reachable

    def _visit(self, todo: Bools) -> None:
        """Drive through all cells with a bin in `todo`."""
        cells = standing_places(self.task.reach, self.task.barriers, todo)
        sequence = self._sequence(cells, todo)
        stops = zigzag(cells, sequence, self.task, self.clearance)
        here = self._here()
        ends = stops if here is None else np.concatenate([here[None, :2], stops])
        needs: list[Bools | None] = [todo[tuple(cells.index[k])] for k in sequence.tolist()]
        if here is not None:
            needs = [None, *needs]
        self._add_stops(self._route(ends, needs, cells.index[sequence]))

    def _here(self) -> Floats | None:
        return self.task.start if self.builder is None else self.builder.pose

    def _sequence(self, cells: CellGraph, todo: Bools) -> Ints:
        """Order the cells: one priority band after the other, each in lanes along x or y, whichever is better."""
        band = cell_bands(self.task.priority, todo, self.task.reach.cell)[tuple(cells.index.T)]
        here = self._here()
        found: list[Ints] = []
        for level in np.unique(band).tolist():
            members = np.flatnonzero(band == level)
            last = here[:2] if here is not None and not found else None
            last = cells.places[found[-1][-1]] if found else last
            found.append(members[_lanes(_subset(cells, members), last, self.task)])
        return np.concatenate(found)

    def _route(self, ends: Floats, needs: list[Bools | None], cells: Ints) -> list[Leg]:
        """Return the legs through the stops `ends` (n, 2) to which a path is found; the others are lost."""
        route: list[Leg] = [(ends[0], needs[0], "move")]
        paths, joins = join(self.task, ends[:-1], ends[1:])
        self.joins += joins
        for k, planned in enumerate(paths):
            path, more = continued(planned, ends[k], route[-1][0], ends[k + 1], self.task)
            self.joins += more
            if path is None:
                self.lost[tuple(cells[k + 1 - len(ends)])] |= needs[k + 1]
                continue
            label = "move" if len(path) == 2 else "join"
            route += [(corner, None, label) for corner in path[1:-1]]
            route.append((path[-1], needs[k + 1], label))
        return route

    def _add_stops(self, route: list[Leg]) -> None:
        """Add the stops one by one; each is left towards the next one."""
        points = np.array([point for point, _, _ in route])
        roomy = self.task.barriers.are_clear(points[:-1], points[1:], self.clearance + BLEND_ROOM)
        roomy = np.concatenate([[False], roomy, [False]])
        blend = np.where(roomy[:-1] & roomy[1:], OVERLAP, 0.0)  # (n stops,)
        builder = self.builder or CurveBuilder(
            self._first_pose(points), self.task.vehicle.limits, spin=self.spin
        )
        self.builder = builder
        for k, (_, need, _) in enumerate(route):
            target = points[k + 1] if k + 1 < len(points) else None
            departure = choose_departure(builder, target, need, (float(blend[k]), float(blend[k])))
            builder.turn(departure.angle, "turn" if need is None else "spin", overlap=float(blend[k]))
            if target is not None:
                builder.move(departure.distance, route[k + 1][2], overlap=float(blend[k]))
            if self.task.progress and (k % 50 == 49 or k == len(route) - 1):
                self.task.progress(k + 1, len(route))
        builder.wait(1.0 / self.task.rate)

    def _first_pose(self, points: Floats) -> Floats:
        if self.task.start is not None:
            return self.task.start
        leg = points[1] - points[0] if len(points) > 1 else np.array([1.0, 0.0])
        return np.array([*points[0], np.arctan2(leg[1], leg[0])])


def standing_places(reach: Reach, barriers: Barriers, todo: Bools) -> CellGraph:
    """Choose a place in each cell: its centre if that is free, else the deepest place of its reachable part."""
    index = np.argwhere(todo.any(axis=2))
    centres = reach.origin + (index + 0.5) * reach.cell
    nodes = np.arange(reach.per_cell**2)
    inner = (np.stack([nodes // reach.per_cell, nodes % reach.per_cell], axis=1) + 0.5) * reach.step
    from_border = np.minimum(inner, reach.cell - inner).min(axis=1)  # (per_cell²,)
    at = tuple(index.T)
    free = np.where(reach.blocks(reach.mask)[at], reach.blocks(reach.distance)[at] - reach.clearance, -1.0)
    depth = np.minimum(free + reach.step, from_border) - 1e-3 * abs(inner - reach.cell / 2).sum(axis=1)
    best = np.where(free >= 0, depth, -np.inf).argmax(axis=1)
    chosen = reach.origin + index * reach.cell + inner[best]
    central = np.where(free > 0, 1.0, 0.0).mean(axis=1) > 0.5
    central &= barriers.distances(centres) >= reach.clearance + BLEND_ROOM
    chosen[central] = centres[central]
    pairs = order.neighbours(index)
    clear = barriers.are_clear(chosen[pairs[:, 0]], chosen[pairs[:, 1]], reach.clearance)
    return CellGraph(index=index, places=chosen, pairs=pairs[clear])


def _subset(cells: CellGraph, members: Ints) -> CellGraph:
    number = np.full(len(cells.index), -1, dtype=np.int64)
    number[members] = np.arange(len(members))
    pairs = number[cells.pairs]
    return CellGraph(
        index=cells.index[members], places=cells.places[members], pairs=pairs[(pairs >= 0).all(axis=1)]
    )


def _lanes(cells: CellGraph, here: Floats | None, task: Task) -> Ints:
    """Order cells by runs along x or along y, whichever takes less time."""
    limits = task.vehicle.limits
    best: tuple[float, Ints] | None = None
    for axis in (0, 1):
        runs = order.runs(cells, axis)
        ends = np.array([(run[0], run[-1]) for run in runs]).reshape(-1)
        cost = order.travel_times(cells, ends, limits.v, limits.v / limits.a)
        first = None
        if here is not None:
            far = np.hypot(*(cells.places[ends] - here).T) / limits.v
            n = len(cost)
            cost = np.pad(cost, ((0, 2), (0, 2)))
            cost[n:, :n] = far
            cost[:n, n:] = far[:, None]
            first = n
        tour = order.tour(cost, first, np.random.default_rng(task.seed))
        chosen = [(k, flipped) for k, flipped in tour if k < len(runs)]
        sequence = np.concatenate([runs[k][::-1] if flipped else runs[k] for k, flipped in chosen])
        total = float(np.hypot(*np.diff(cells.places[sequence], axis=0).T).sum()) / limits.v
        total += len(runs) * limits.v / limits.a
        if best is None or total < best[0] - 1e-9:
            best = (total, sequence)
    assert best is not None
    return best[1]


def zigzag(cells: CellGraph, sequence: Ints, task: Task, clearance: float) -> Floats:
    """Return the stops (n, 2) [m], with those along a lane shifted alternately to its left and right.

    The moves then lean left and right in turn. A spin from one lean to the other passes all headings in less
    than a full turn.
    """
    lean = ZIGZAG * 2 * np.pi / task.coverage.headings
    index, stops = cells.index[sequence], cells.places[sequence].copy()
    shift = 0.5 * task.reach.cell * np.tan(lean)
    step = np.diff(index, axis=0)
    straight = np.zeros(len(stops), dtype=np.bool_)
    straight[1:-1] = (step[1:] == step[:-1]).all(axis=1) & (abs(step[1:]).sum(axis=1) == 1)
    for axis in (0, 1):  # lanes along x shift in y
        lane = straight & (np.concatenate([step[:, axis], [0]]) != 0)
        moved = stops.copy()
        moved[lane, 1 - axis] += np.where(index[lane, axis] % 2, shift, -shift)
        stops = moved
    middle = cells.places[sequence]
    for _ in range(3):
        roomy = task.barriers.are_clear(stops[:-1], stops[1:], clearance + BLEND_ROOM)
        bad = np.zeros(len(stops), dtype=np.bool_)
        bad[:-1] |= ~roomy
        bad[1:] |= ~roomy
        stops[bad] = middle[bad]
    return stops
