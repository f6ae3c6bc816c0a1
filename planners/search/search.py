"""The search for a drive that covers bins: a receding-horizon beam search over closed-form primitives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from planners.rooms import NEIGHBOUR_STEPS
from planners.search import beam
from planners.search.area import SearchArea
from planners.search.heuristic import heuristic_lattice
from planners.search.kernel_goals import cell_distances
from planners.search.kernel_world import (
    MAX_BINS_PER_PRIMITIVE,
    PrimitiveArrays,
    SearchWorld,
    apply_primitive,
    find_escape,
)
from planners.search.motion_primitives import MotionPrimitives
from planners.search.settings import KERNELS, SearchSettings
from planners.search.workspace import BeamSettings, HeuristicBuffers, workspace_for
from planners.types import Bools, Floats, Int32s, Ints

DECISIONS_PER_CALL = KERNELS.decisions_per_call
MAX_STOP_PRIMITIVES = KERNELS.max_stop_primitives


class SearchStatus(IntEnum):
    """How a run of the search ended."""

    STOPPED = beam.RUNNING
    """`tick` said stop."""
    DONE = beam.DONE
    """No bin is missing."""
    UNREACHABLE = beam.UNREACHABLE
    """No way leads to what is missing, at the resolution of the lattice."""
    GAVE_UP = beam.GAVE_UP
    """The search for the nearest bin ran out of states or of time units."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SearchResult:
    """A drive of the search."""

    start: Floats
    """(4,) x, y [m], heading step, mode."""
    sequence: Int32s
    """(n,) branches."""
    left: Bools
    """(nx, ny, n_phi) bins of the area that it did not cover."""


class _Snapshot(NamedTuple):
    """A state to go back to."""

    state: Floats
    """(4,)"""
    need: Bools
    """(nx, ny, n_phi)"""
    missing: Ints
    """(nx, ny)"""
    n_parts: int
    """Parts driven so far."""


class CoverageSearch:
    """One search in one area: `want` bins, `start_at` a state, `run` or `complete`, then ask for the `result`."""

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
        need : (nx, ny, n_phi) bins of the area to cover
        rate : [Hz] of the log
        value : (nx, ny) value of a bin in each cell; None: all the same
        """
        self.area, self.primitives, self.rate = area, primitives, rate
        self.settings = settings or SearchSettings()
        self.rng = np.random.default_rng(seed)
        self.value = 1.0 + self.settings.value_noise * self.rng.random(need.shape[:2])
        if value is not None:
            self.value *= value
        size = np.ones(3, dtype=np.int64)
        if primitives.safe_depth > 1:
            size[:] = (
                *np.ceil(np.array(area.distance.shape) * area.step / self.settings.lattice).astype(int) + 1,
                primitives.n_headings,
            )
        self._trapped = np.zeros(size, dtype=np.bool_)
        self.want(need)
        self.state = np.zeros(4)
        self.start = self.state.copy()
        self._parts: list[Int32s] = []
        self.given_up = np.zeros_like(need)
        self._snapshots = [self._snapshot()]

    def want(self, need: Bools, dwell_factor: float = 1.0, *, inner: bool = True) -> None:
        """Set the bins to cover.

        Parameters
        ----------
        need : (nx, ny, n_phi) bins of the area
        dwell_factor : log periods to stay in each bin
        inner : in cells whose inner half can be reached, count only that half
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
            inner_dwell=self.settings.inner_dwell * dwell,
            trapped=self._trapped,
        )

    def start_at(self, state: Floats) -> None:
        """Start from (x, y, heading step, mode)."""
        self.state, self.start = state.copy(), state.copy()

    @property
    def left(self) -> int:
        """Count of bins still missing."""
        return int(self.world.missing.sum())

    def run(self, tick: Callable[[int], bool]) -> SearchStatus:
        """Drive until no bin is missing or none can be reached; `tick` takes the bins left and tells whether to go on."""
        settings, primitives = self._beam_settings(), self.primitive_arrays()
        workspace, heuristic = workspace_for(settings, primitives), self._heuristic_buffers()
        counters = np.array([0, self.left, 0, beam.RUNNING])
        sequence = np.empty(DECISIONS_PER_CALL * beam.MAX_PATH_PRIMITIVES, dtype=np.int32)
        while counters[beam.STATUS] == beam.RUNNING:
            counters[beam.N_DRIVEN] = 0
            self._snapshots = [*self._snapshots[-1:], self._snapshot()]
            beam.advance(
                self.state,
                DECISIONS_PER_CALL,
                settings,
                self.world,
                primitives,
                heuristic,
                workspace,
                sequence,
                counters,
            )
            self._parts.append(sequence[: counters[beam.N_DRIVEN]].copy())
            if not tick(int(counters[beam.N_LEFT])):
                break
        return SearchStatus(int(counters[beam.STATUS]))

    def complete(self, tick: Callable[[int], bool]) -> None:
        """Run until nothing more can be reached: give up cells that nothing leads into, and back out of traps."""
        for _ in range(self.settings.max_skipped_cells):
            status = self.run(tick)
            if status in (SearchStatus.STOPPED, SearchStatus.DONE):
                return
            if status == SearchStatus.UNREACHABLE:
                if not self._is_trapped():
                    return
                self._backtrack()
            if not self._skip_nearest_cell():
                return

    def _is_trapped(self) -> bool:
        """Tell whether nothing leads from here back to where the robot began."""
        i, k = ((self.start[:2] - self.area.origin) / self.area.cell).astype(np.int64).tolist()
        home = np.zeros_like(self.world.need)
        home[i, k] = True
        way_back = CoverageSearch(self.area, self.primitives, home, self.rate, settings=self.settings)
        way_back.want(home, inner=False)
        way_back.start_at(self.state)
        return way_back.run(lambda _: False) == SearchStatus.UNREACHABLE

    def _backtrack(self) -> None:
        """Undo the last decisions, and give up the cell from which the robot could not go on."""
        i, k = self._cell
        snapshot = self._snapshots.pop(0)
        self.state, self.world.need[:], self.world.missing[:] = (
            snapshot.state,
            snapshot.need,
            snapshot.missing,
        )
        self._snapshots.clear()
        del self._parts[snapshot.n_parts :]
        self._give_up(i, k)

    def _skip_nearest_cell(self) -> bool:
        """Give up the nearest cell where something is missing; False if no such cell is connected to this one."""
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

    def _snapshot(self) -> _Snapshot:
        return _Snapshot(
            self.state.copy(), self.world.need.copy(), self.world.missing.copy(), len(self._parts)
        )

    @property
    def _cell(self) -> tuple[int, int]:
        """Cell of the area where the robot is."""
        i, k = ((self.state[:2] - self.area.origin) / self.area.cell).astype(np.int64).tolist()
        return i, k

    def _give_up(self, i: int, k: int) -> None:
        """Want no more bins of a cell."""
        self.given_up[i, k] |= self.world.need[i, k]
        self.world.need[i, k], self.world.missing[i, k] = False, 0

    def come_to_rest(self) -> bool:
        """Drive on until the robot stands still but for its spin; False if no such sequence is found."""
        out, covered = (
            np.empty(64, dtype=np.int32),
            np.empty(MAX_BINS_PER_PRIMITIVE, dtype=np.int64),
        )
        x, y, h, m = self.state.tolist()
        primitives = self.primitive_arrays()
        n = find_escape(x, y, int(h), int(m), -MAX_STOP_PRIMITIVES, self.world, primitives, covered, out)
        for j in out[: max(n, 0)].tolist():
            apply_primitive(self.state, j, self.world, primitives, covered)
        self._parts.append(out[: max(n, 0)].copy())
        return bool(n >= 0)

    def result(self) -> SearchResult:
        """Return what was driven so far."""
        return SearchResult(
            start=self.start,
            sequence=np.concatenate([np.empty(0, dtype=np.int32), *self._parts]),
            left=self.world.need.copy(),
        )

    def _beam_settings(self) -> BeamSettings:
        """Return the settings in units of time."""
        s, unit = self.settings, self.primitives.unit
        horizon = max(round(s.horizon / unit), 4)
        return BeamSettings(
            horizon=horizon,
            executed=max(round(s.executed / unit), 1),
            width=s.beam_width,
            safe_depth=self.primitives.safe_depth,
            min_bins=s.min_bins,
            goal_horizon=s.goal_horizon,
            goal_width=s.goal_width,
            goal_max_states=s.goal_max_states,
            discount=s.discount / horizon,
            goal_pull=s.goal_pull,
            completion_weight=s.completion_weight,
            overtime=s.overtime,
            lattice=s.lattice,
            guided_width=s.guided_width,
        )

    def _heuristic_buffers(self) -> HeuristicBuffers:
        area = self.area
        lattice = heuristic_lattice(self.primitives, area.distance, area.step, area.cell, area.clearance)
        side = lattice.side if self.settings.guided_width > 0 else 1
        cost_to_go = np.empty(side * side * len(lattice.bins) * lattice.n_gears, dtype=np.int16)
        entries = np.empty((2, 4 * cost_to_go.size), dtype=np.int32)
        heads = np.empty(int(lattice.cost.max()) + lattice.pause + 1, dtype=np.int32)
        return HeuristicBuffers(
            lattice, cost_to_go, entries[0], entries[1], heads, np.zeros(2, dtype=np.int64)
        )

    def primitive_arrays(self) -> PrimitiveArrays:
        """Return the primitives as the kernels take them."""
        p = self.primitives
        apart = p.offsets - p.offsets[..., [(p.offsets.shape[3] - 1) // 2], :]
        farthest = float(np.hypot(*np.moveaxis(apart, -1, 0)).max()) + 2 * self.area.step
        return PrimitiveArrays(
            p.offsets,
            p.bins,
            p.core,
            p.turned_steps,
            p.next_mode,
            p.cost,
            p.sample_period,
            p.is_fine,
            p.stops_first,
            p.heading_bin,
            farthest,
        )
