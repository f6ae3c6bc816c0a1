"""The (x, y, phi) cells of a review: where the run has been, what was answered there, and what was wrong.

"Not answered" and "wrong" are two things: the first says drive there, the second says the model fails there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from planners.arena import Arena
from planners.coverage import Coverage
from sensorgraph.evaluation.evaluate import Evaluation
from sensorgraph.graph import Sensorgraph
from sensorgraph.models.base import OFF
from sensorgraph.models.faces.observed_space import Crossed
from sensorgraph.planning.priority import doubt
from sensorgraph.types import Bools, Floats, Ints

CELL = 0.25  # [m] unless that would be too many
MOST_CELLS = 40_000
HEADINGS = 16
LOOKED = 20  # rays through a cell of unknown walls that make it free
FARTHEST = 10.0  # [m] a ray without a return counts so far
NEXT_HEADINGS = 4  # in which a place is asked what would not be answered from there
MUCH_UNANSWERED = 0.5
"""Share of a cell's rays not answered at which its colour is that of not answered alone."""
MUCH_WRONG = 0.1
"""Share of a cell's answered rays that are wrong at which its colour is that of wrong alone, or more: see `Tally`."""
OPEN = 0.2
"""Doubt of a place above which it is worth a visit: about the share of rays not answered from there."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Tally:
    """What came of the rays scored in each cell; counts (nx, ny, n_phi), or (nx, ny) over all headings."""

    scored: Ints
    answered: Ints
    wrong: Ints
    """Answered, and more than 5 cm off."""

    @classmethod
    def of(cls, evaluation: Evaluation, poses: Floats, grid: Coverage) -> Tally:
        """Count the rays of each scan in the cell of its pose (n_scans, 3), all on the grid."""
        scored = np.isfinite(evaluation.residual)
        answered = scored & evaluation.prediction.answered
        wrong = answered & (np.abs(np.nan_to_num(evaluation.residual)) > OFF)
        return cls(**{
            name: spread(rays.sum(axis=1), poses, grid).astype(np.intp)
            for name, rays in (("scored", scored), ("answered", answered), ("wrong", wrong))
        })  # fmt: skip

    @property
    def flat(self) -> Tally:
        """Over all headings."""
        return Tally(
            scored=self.scored.sum(axis=2), answered=self.answered.sum(axis=2), wrong=self.wrong.sum(axis=2)
        )

    @property
    def share_unanswered(self) -> Floats:
        """Of the scored rays; nan where none was scored."""
        return _share(self.scored - self.answered, self.scored)

    @property
    def share_wrong(self) -> Floats:
        """Of the answered rays; nan where none was answered."""
        return _share(self.wrong, self.answered)

    @property
    def much_wrong(self) -> float:
        """Share wrong that counts as much: `MUCH_WRONG`, or what nine cells in ten stay under if that is more."""
        share = self.share_wrong
        known = share[np.isfinite(share)]
        return max(MUCH_WRONG, float(np.quantile(known, 0.9))) if len(known) else MUCH_WRONG


@dataclass(frozen=True, kw_only=True, eq=False)
class Cells:
    """(x, y, phi) cells: how often visited, and how well the graph knows what is seen from there."""

    grid: Coverage
    """Visits of all scans; `reachable` are cells that are free, by the arena or by the rays that went through."""
    error: Floats | None
    """(nx, ny, n_phi) [m] mean over scans of the median |residual| of a scan; nan where nothing was scored."""
    tally: Tally | None
    next: Next | None
    """Where the graph would not answer; None without a graph."""

    @property
    def origin(self) -> Floats:
        """(2,) [m] lower left corner."""
        return self.grid.origin

    @property
    def cell(self) -> float:
        """[m]"""
        return self.grid.cell

    @property
    def counts(self) -> Ints:
        """(nx, ny, n_phi) scans; heading bins centred on multiples of 2 pi / n_phi."""
        return np.asarray(self.grid.counts, dtype=np.intp)

    @property
    def error_top(self) -> float:
        """[m] that 95 % of the cells stay under, where colours end."""
        if self.error is None or not np.isfinite(self.error).any():
            return 1.0
        return float(np.nanquantile(self.error, 0.95)) or 1e-3

    @property
    def free(self) -> Bools:
        """(nx, ny) cells where a robot may be, for all that is known."""
        return np.asarray(self.grid.reachable.any(axis=2))


@dataclass(frozen=True, kw_only=True, eq=False)
class Next:
    """What `plan --priority GRAPH` goes by: how little the graph knows of each free place."""

    origin: Floats
    """(2,) [m]"""
    cell: float
    """[m]"""
    doubt: Floats
    """(nx, ny) mean over headings and rays, 1 where none would be answered; nan where not free."""

    def places(self, n: int = 3) -> list[tuple[float, float, float]]:
        """Return the n largest stretches in doubt above `OPEN`: x, y [m] of the worst cell in each, area [m²]."""
        is_open = np.nan_to_num(self.doubt) > OPEN
        parts, count = ndimage.label(is_open, structure=np.ones((3, 3)))
        sizes = np.bincount(parts.ravel(), minlength=count + 1)[1:]
        out = []
        for k in np.argsort(-sizes, kind="stable")[:n]:
            here = np.where(parts == k + 1, self.doubt, -np.inf)
            i, j = np.unravel_index(int(here.argmax()), here.shape)
            x, y = self.origin + (np.array([i, j]) + 0.5) * self.cell
            out.append((float(x), float(y), float(sizes[k]) * self.cell**2))
        return out


def cells_of(
    visited: Floats,
    shown: Floats,
    evaluation: Evaluation | None,
    *,
    rays: tuple[Floats, Floats],
    arena: Arena | None,
    graph: Sensorgraph | None,
    cell: float | None,
) -> Cells:
    """Count what happened in the cells.

    Parameters
    ----------
    visited : (n, 3) poses of all scans; `shown`: those (m, 3) that were evaluated
    rays : lasers (m, 3) in map and bearings with ranges as (m, n_rays, 2): bearing in map [rad], range [m]
    cell : [m]; None: `CELL`, or coarser where that would be too many
    """
    ends = _ends(*rays)
    if arena is not None:
        low, high = np.array(arena.bounds[:2]), np.array(arena.bounds[2:])
    else:
        low, high = np.quantile(ends.reshape(-1, 2), [0.005, 0.995], axis=0)
    low = np.minimum(low, visited[:, :2].min(axis=0))
    high = np.maximum(high, visited[:, :2].max(axis=0))
    side = cell or CELL
    while cell is None and np.prod((high - low) / side + 2) > MOST_CELLS:
        side *= 2
    origin = np.floor(low / side) * side
    last = np.floor((visited[:, :2].max(axis=0) - origin) / side) + 1
    shape = np.maximum(np.ceil((high - origin) / side - 1e-9), last).astype(int)
    free = _free(origin, side, shape, arena, rays[0], ends)
    grid = Coverage.empty(origin=origin, cell=side, cells=free, headings=HEADINGS)
    grid.add(visited)
    grid.reachable[:] |= np.any(grid.counts > 0, axis=2, keepdims=True)
    return Cells(
        grid=grid,
        error=None if evaluation is None else _error(evaluation, shown, grid),
        tally=None if evaluation is None else Tally.of(evaluation, shown[evaluation.scan_indices], grid),
        next=None if graph is None else _next(graph, grid),
    )


def spread(values: Floats, poses: Floats, grid: Coverage) -> Floats:
    """Add values (n,) up in the cells (nx, ny, n_phi) of their poses (n, 3), all on the grid."""
    bins, _ = grid.bins(poses)
    flat = np.ravel_multi_index(tuple(bins.T), grid.counts.shape)
    total = np.bincount(flat, weights=values, minlength=grid.counts.size)
    return np.asarray(total.reshape(grid.counts.shape), dtype=np.float64)


def median_per_scan(residual: Floats) -> Floats:
    """Return the median |residual| of every scan (n_scans,) [m]; nan where no ray was scored."""
    out = np.full(len(residual), np.nan)
    scored = np.isfinite(residual).any(axis=1)
    out[scored] = np.nanmedian(np.abs(residual[scored]), axis=1)
    return out


def _error(evaluation: Evaluation, shown: Floats, grid: Coverage) -> Floats:
    of_scan = median_per_scan(evaluation.residual)
    scored = np.isfinite(of_scan)
    poses = shown[evaluation.scan_indices][scored]
    return _share(spread(of_scan[scored], poses, grid), spread(np.ones(scored.sum()), poses, grid))


def _ends(lasers: Floats, rays: Floats) -> Floats:
    """Return the end points (n, 2) [m] in map of all rays that were not broken, those without a return cut off."""
    bearing, ranges = rays[..., 0], rays[..., 1]
    reach = np.minimum(ranges, FARTHEST)[..., None]
    ends = lasers[:, None, :2] + reach * np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
    return np.asarray(np.where((ranges > 0)[..., None], ends, lasers[:, None, :2]))


def _free(
    origin: Floats, side: float, shape: NDArray[np.int_], arena: Arena | None, lasers: Floats, ends: Floats
) -> Bools:
    """Tell which cells (nx, ny) are free: their middles by the arena; without one, where rays went through."""
    nx, ny = map(int, shape)
    if arena is not None:
        i, j = np.indices((nx, ny))
        middles = origin + (np.stack([i, j], axis=-1).reshape(-1, 2) + 0.5) * side
        return np.asarray(arena.contains(middles).reshape(nx, ny))
    origins = np.repeat(lasers[:, :2], ends.shape[1], axis=0)
    way = ends.reshape(-1, 2) - origins
    length = np.hypot(*way.T)
    went = length > side
    crossed = Crossed.of(  # up to a cell before the return: that one is a wall's
        origins[went], way[went] / length[went, None], length[went] - side, cell=side
    )
    a, b = np.round((origin - crossed.origin) / crossed.cell).astype(int)
    free = np.zeros((nx, ny), dtype=np.bool_)
    part = crossed.counts[max(a, 0) : a + nx, max(b, 0) : b + ny]
    free[max(-a, 0) :, max(-b, 0) :][: part.shape[0], : part.shape[1]] = part >= LOOKED
    return free


def _next(graph: Sensorgraph, grid: Coverage) -> Next:
    """Ask the graph from the middle of coarser cells, those whose four parts are all free."""
    free: Bools = np.asarray(grid.reachable.any(axis=2))
    nx, ny = np.array(free.shape) // 2
    whole: Bools = np.asarray(free[: 2 * nx, : 2 * ny].reshape(nx, 2, ny, 2).all(axis=(1, 3)))
    coarse = Coverage.empty(origin=grid.origin, cell=2 * grid.cell, cells=whole, headings=NEXT_HEADINGS)
    value = doubt(graph, coarse).mean(axis=2)
    return Next(origin=grid.origin, cell=coarse.cell, doubt=np.where(whole, value, np.nan))


def _share(part: Floats | Ints, whole: Floats | Ints) -> Floats:
    return np.asarray(part / np.where(whole > 0, whole, np.nan), dtype=np.float64)
