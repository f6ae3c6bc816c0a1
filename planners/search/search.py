"""Search for a drive that covers bins: a receding-horizon beam search over closed-form primitives.

In each step, `beam.beam_search` looks ahead over the horizon, and `beam.drive` executes the first part. If
the beam covers too few bins, `nearest_goal.find_nearest_goal` replaces it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from itertools import count

import numpy as np

from planners.rooms import NEIGHBOUR_STEPS
from planners.search.area import SearchArea
from planners.search.beam import beam_search, drive
from planners.search.heuristic import HeuristicBuffers, heuristic_buffers
from planners.search.kernel_goals import cell_distances
from planners.search.kernel_world import (
    LATTICE,
    SearchWorld,
    apply_primitive,
    find_escape,
    new_scratch,
)
from planners.search.motion_primitives import INNER_DWELL, MotionPrimitives
from planners.search.nearest_goal import find_nearest_goal, nearest_goal_search
from planners.search.settings import SearchSettings
from planners.search.workspace import GOAL_HORIZON, SearchTables, workspace_for
from planners.types import Bools, Floats, Int32s

RETRY_DWELL = (1.3, 1.6)
"""Minimum stay [log periods] in bins that a log of some phase missed, at the first and the second retry."""
MIN_BINS = 3
"""Minimum number of bins covered by the beam; below it, the nearest missing bin is searched for instead."""
VALUE_NOISE = 0.1
"""Random share by which the values of cells differ between seeds."""
MAX_SKIPPED_CELLS = 16
"""Maximum number of unreachable cells that a search gives up."""
MAX_STOP_PRIMITIVES = 24
"""Maximum number of primitives to come to rest at the end of a search."""
DECISIONS_PER_TICK = 20
"""Number of decisions between two progress reports."""


class SearchStatus(IntEnum):
    """Reason why a run of the search ended."""

    STOPPED = 0
    """`tick` returned False."""
    DONE = 1
    """No bin is missing."""
    UNREACHABLE = 2
    """No path leads to the missing bins at the resolution of the lattice."""
    GAVE_UP = 3
    """The search for the nearest bin exceeded its number of states or units of time."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SearchResult:
    """Result of a search."""

    start: Floats
    """(4,) start state: x, y [m], heading step, mode."""
    sequence: Int32s
    """(n,) branches of the drive."""
    left: Bools
    """(nx, ny, n_phi) bins of the area that the drive does not cover."""


class CoverageSearch:
    """A search in one area: call `want` and `start_at`, then `run` or `complete`, then `result`."""

    def __init__(
        self,
        area: SearchArea,
        primitives: MotionPrimitives,
        need: Bools,
        rate: float,
        *,
        seed: int = 0,
        value: Floats | None = None,
        settings: SearchSettings | None = None,
    ) -> None:
        """Prepare a search.

        Parameters
        ----------
        need : (nx, ny, n_phi) Bins of the area to cover.
        rate : [Hz] Rate of the log.
        value : (nx, ny) Value of a bin in each cell; None: equal values.
        """
        self.area, self.primitives, self.rate = area, primitives, rate
        self.settings = settings or SearchSettings()
        self.rng = np.random.default_rng(seed)
        self.value = 1.0 + VALUE_NOISE * self.rng.random(need.shape[:2])
        if value is not None:
            self.value *= value
        size = np.ones(3, dtype=np.int64)
        if primitives.safe_depth > 1:
            size[:] = (
                *np.ceil(np.array(area.distance.shape) * area.step / LATTICE).astype(int) + 1,
                primitives.n_headings,
            )
        self._trapped = np.zeros(size, dtype=np.bool_)
        self.want(need)
        self.state = np.zeros(4)
        self.start = self.state.copy()
        self._parts: list[Int32s] = []
        self.seconds = 0.0  # [s] driven so far
        self.given_up = np.zeros_like(need)

    def want(self, need: Bools, dwell_factor: float = 1.0, *, inner: bool = True) -> None:
        """Set the bins to cover.

        Parameters
        ----------
        need : (nx, ny, n_phi) Bins of the area.
        dwell_factor : Minimum stay in each bin, in log periods.
        inner : Whether only the inner half counts, in cells whose inner half can be reached.
        """
        area, dwell = self.area, dwell_factor / self.rate
        self.world = SearchWorld(
            distance=area.distance,
            need=need.copy(),
            missing=need.sum(axis=2).astype(np.int64),
            inner=area.inner if inner else np.zeros_like(area.inner),
            value=self.value,
            open_borders=area.open_borders,
            x0=float(area.origin[0]),
            y0=float(area.origin[1]),
            step=area.step,
            cell=area.cell,
            clearance=area.clearance,
            dwell=dwell,
            inner_dwell=INNER_DWELL * dwell,
            trapped=self._trapped,
        )

    def start_at(self, state: Floats) -> None:
        """Start from a state (x, y, heading step, mode)."""
        self.state, self.start = state.copy(), state.copy()

    @property
    def left(self) -> int:
        """Number of bins still missing."""
        return int(self.world.missing.sum())

    def run(self, tick: Callable[[int], bool]) -> SearchStatus:
        """Drive until no bin is missing or reachable; `tick` gets the number of bins left, False ends the search."""
        tables, left = self._tables(), self.left
        heuristic = heuristic_buffers(self.settings, self.primitives, self.area)
        for decision in count():
            if decision > 0 and decision % DECISIONS_PER_TICK == 0 and not tick(left):
                break
            status, left = self._decide(left, tables, heuristic)
            if status is not None:
                tick(left)
                return status
        return SearchStatus.STOPPED

    def compile(self) -> None:
        """Compile the kernels of `run`, or load them from the cache, by calling them where no bin is missing."""
        tables = self._tables()
        buffers = heuristic_buffers(self.settings, self.primitives, self.area)
        cell_distances(self.world, tables.workspace.far, tables.workspace.cell_queue)
        beam_search(self.state, tables)
        drive(self.state, 0, 0, 0, tables)
        nearest_goal_search(self.state, tables, 1, True, buffers)

    def _tables(self) -> SearchTables:
        """Return the input and the memory of the kernels."""
        workspace = workspace_for(self.settings, self.primitives, self.world.missing.shape)
        return SearchTables(self.settings, self.world, self.primitives, workspace)

    def _decide(
        self, left: int, tables: SearchTables, heuristic: HeuristicBuffers
    ) -> tuple[SearchStatus | None, int]:
        """Choose the next part of the drive and execute it.

        Returns
        -------
        The reason why the search ended, None if it goes on; and the number of bins left.
        """
        if left == 0:
            return SearchStatus.DONE, left
        settings, workspace = tables.settings, tables.workspace
        state, units = self.state, max(round(settings.executed * self.primitives.n_headings), 1)
        cell_distances(tables.world, workspace.far, workspace.cell_queue)
        n, n_new = beam_search(state, tables)
        if n_new < min(MIN_BINS, left):
            found = find_nearest_goal(state, tables, heuristic)
            if found > 0:
                n, units = found, GOAL_HORIZON
            elif n_new == 0:
                return SearchStatus.UNREACHABLE if found == 0 else SearchStatus.GAVE_UP, left
        mode = int(state[3])
        n_driven, left = drive(state, n, units, left, tables)
        self._parts.append(workspace.sequence[:n_driven].copy())
        self.seconds += self.primitives.unit * self.primitives.units(mode, self._parts[-1])
        return None, left

    def complete(self, tick: Callable[[int], bool]) -> None:
        """Run until no more bins can be reached, and give up cells that no path enters."""
        for _ in range(MAX_SKIPPED_CELLS):
            status = self.run(tick)
            if status in (SearchStatus.STOPPED, SearchStatus.DONE):
                return
            if status == SearchStatus.UNREACHABLE:
                return
            if not self._skip_nearest_cell():
                return

    def _skip_nearest_cell(self) -> bool:
        """Give up the nearest cell with a missing bin; False if no such cell is connected to this one."""
        world = self.world
        far, queue = np.empty(world.missing.shape, np.int64), np.empty(world.missing.size, np.int64)
        cell_distances(world, far, queue)
        i, k = self._cell
        while 0 < far[i, k] <= far.size:
            neighbours = [
                (i + a, k + b)
                for bit, (a, b) in enumerate(NEIGHBOUR_STEPS)
                if world.open_borders[i, k] >> bit & 1
            ]
            i, k = min(neighbours, key=lambda cell: int(far[cell]))
        if far[i, k] > 0:
            return False
        self._give_up(i, k)
        return self.left > 0

    @property
    def _cell(self) -> tuple[int, int]:
        """Cell of the area in which the robot is."""
        i, k = ((self.state[:2] - self.area.origin) / self.area.cell).astype(np.int64).tolist()
        return i, k

    def _give_up(self, i: int, k: int) -> None:
        """Remove the bins of a cell from the wanted ones."""
        self.given_up[i, k] |= self.world.need[i, k]
        self.world.need[i, k], self.world.missing[i, k] = False, 0

    def come_to_rest(self) -> bool:
        """Drive on until v is zero; the robot may still turn. False if no such sequence is found."""
        x, y, h, m = self.state.tolist()
        primitives, scratch = self.primitives, new_scratch(MAX_STOP_PRIMITIVES)
        n = find_escape(x, y, int(h), int(m), -MAX_STOP_PRIMITIVES, self.world, primitives, scratch)
        escape = scratch.escape[: max(n, 0)]
        for j in escape.tolist():
            apply_primitive(self.state, j, self.world, primitives, scratch.covered)
        self._parts.append(escape)
        return bool(n >= 0)

    def result(self) -> SearchResult:
        """Return the drive so far."""
        return SearchResult(
            start=self.start,
            sequence=np.concatenate([np.empty(0, dtype=np.int32), *self._parts]),
            left=self.world.need.copy(),
        )
