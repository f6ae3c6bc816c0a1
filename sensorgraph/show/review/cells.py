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
from sensorgraph.models.base import OFF_DISTANCE
from sensorgraph.models.faces.observed_space import ObservedSpace
from sensorgraph.planning.priority import uncertainty
from sensorgraph.types import Bools, Floats, Ints

CELL_SIZE, MAX_CELLS = 0.25, 40_000
"""[m] side of a cell, doubled until no more than so many are needed."""
N_HEADINGS = 16
"""Heading bins of a full turn."""
DOUBT_HEADINGS = 4
"""Headings in which the graph is asked what it would not answer from a place."""
DOUBT_RAYS = 60
"""Rays that it is asked for in each; those between see much the same."""
MIN_RAYS_THROUGH = 20
"""Rays through a cell that make it free where there is no map."""
MAX_REACH = 10.0
"""[m] that a ray without a return is taken to be free."""
SATURATING_UNANSWERED = 0.5
"""Share of a cell's rays not answered, from which its colour is that of not answered alone."""
SATURATING_WRONG = 0.1
"""Share of a cell's answered rays that are wrong, from which its colour is that of wrong alone, or more: see
`RayCounts.saturating_wrong`."""
WORTH_A_VISIT = 0.2
"""Doubt of a place above which it is worth a visit: about the share of rays not answered from there."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RayCounts:
    """How many rays were scored, answered and wrong in each cell: (nx, ny, n_phi), or (nx, ny) over all headings."""

    scored: Ints
    answered: Ints
    wrong: Ints
    """Answered, and more than 5 cm off."""

    @classmethod
    def of(cls, evaluation: Evaluation, poses: Floats, grid: Coverage) -> RayCounts:
        """Count the rays of each scan in the cell of its pose (n_scans, 3), all on the grid."""
        scored = np.isfinite(evaluation.residual)
        answered = scored & evaluation.answered_rays
        wrong = answered & (np.abs(np.nan_to_num(evaluation.residual)) > OFF_DISTANCE)
        return cls(**{
            name: sum_in_cells(rays.sum(axis=1), poses, grid).astype(np.intp)
            for name, rays in (("scored", scored), ("answered", answered), ("wrong", wrong))
        })  # fmt: skip

    @property
    def by_place(self) -> RayCounts:
        """Over all headings."""
        return RayCounts(
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
    def saturating_wrong(self) -> float:
        """Share wrong from which colours saturate: SATURATING_WRONG, or the 90 % quantile of the cells if that is more."""
        share = self.share_wrong
        known = share[np.isfinite(share)]
        return max(SATURATING_WRONG, float(np.quantile(known, 0.9))) if len(known) else SATURATING_WRONG


@dataclass(frozen=True, kw_only=True, eq=False)
class ReviewCells:
    """(x, y, phi) cells: how often each was visited, and how well the graph predicts what is seen from there."""

    grid: Coverage
    """Visits of all scans; `reachable` are the cells that are free by the arena, or by the rays that crossed them."""
    error: Floats | None
    """(nx, ny, n_phi) [m] mean over scans of the median |residual| of a scan; nan where nothing was scored."""
    ray_counts: RayCounts | None
    doubt_map: DoubtMap | None
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
        """[m] error at which colours end: the 95 % quantile of the cells."""
        if self.error is None or not np.isfinite(self.error).any():
            return 1.0
        return float(np.nanquantile(self.error, 0.95)) or 1e-3

    @property
    def free(self) -> Bools:
        """(nx, ny) cells that are free as far as is known."""
        return np.asarray(self.grid.reachable.any(axis=2))


@dataclass(frozen=True, kw_only=True, eq=False)
class DoubtMap:
    """How little the graph knows of each free place: the priority by which a next plan would drive."""

    origin: Floats
    """(2,) [m]"""
    cell: float
    """[m]"""
    doubt: Floats
    """(nx, ny) mean over headings and rays, 1 where none would be answered; nan where not free."""

    def places(self, n: int = 3) -> list[tuple[float, float, float]]:
        """Return the n largest areas of a doubt above WORTH_A_VISIT: x, y [m] of the worst cell, and the area [m²]."""
        is_open = np.nan_to_num(self.doubt) > WORTH_A_VISIT
        parts, count = ndimage.label(is_open, structure=np.ones((3, 3)))
        sizes = np.bincount(parts.ravel(), minlength=count + 1)[1:]
        out = []
        for k in np.argsort(-sizes, kind="stable")[:n]:
            here = np.where(parts == k + 1, self.doubt, -np.inf)
            i, j = np.unravel_index(int(here.argmax()), here.shape)
            x, y = self.origin + (np.array([i, j]) + 0.5) * self.cell
            out.append((float(x), float(y), float(sizes[k]) * self.cell**2))
        return out


def count_cells(
    visited: Floats,
    shown: Floats,
    evaluation: Evaluation | None,
    *,
    rays: tuple[Floats, Floats],
    arena: Arena | None,
    graph: Sensorgraph | None,
    cell: float | None,
) -> ReviewCells:
    """Count visits, errors and rays in the cells, and ask the graph what it does not know.

    Parameters
    ----------
    visited : (n, 3) poses of all scans; `shown`: those (m, 3) that were evaluated
    rays : lasers (m, n_rays or 1, 3) in map and bearings with ranges as (m, n_rays, 2): bearing in map [rad], range [m]
    cell : [m]; None: CELL_SIZE, or coarser where that would be too many
    """
    ends = _ends(*rays)
    if arena is not None:
        low, high = np.array(arena.bounds[:2]), np.array(arena.bounds[2:])
    else:
        low, high = np.quantile(ends.reshape(-1, 2), [0.005, 0.995], axis=0)
    low = np.minimum(low, visited[:, :2].min(axis=0))
    high = np.maximum(high, visited[:, :2].max(axis=0))
    side = cell or CELL_SIZE
    while cell is None and np.prod((high - low) / side + 2) > MAX_CELLS:
        side *= 2
    origin = np.floor(low / side) * side
    last = np.floor((visited[:, :2].max(axis=0) - origin) / side) + 1
    shape = np.maximum(np.ceil((high - origin) / side - 1e-9), last).astype(int)
    free = _free(origin, side, shape, arena, rays[0], ends)
    grid = Coverage.empty(origin=origin, cell=side, cells=free, headings=N_HEADINGS)
    grid.add(visited)
    grid.reachable[:] |= np.any(grid.counts > 0, axis=2, keepdims=True)
    return ReviewCells(
        grid=grid,
        error=None if evaluation is None else _error(evaluation, shown, grid),
        ray_counts=None
        if evaluation is None
        else RayCounts.of(evaluation, shown[evaluation.scan_indices], grid),
        doubt_map=None if graph is None else _doubt_map(graph, grid),
    )


def sum_in_cells(values: Floats, poses: Floats, grid: Coverage) -> Floats:
    """Add up values (n,) in the cells (nx, ny, n_phi) of their poses (n, 3), all of them on the grid."""
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
    return _share(
        sum_in_cells(of_scan[scored], poses, grid), sum_in_cells(np.ones(scored.sum()), poses, grid)
    )


def _ends(lasers: Floats, rays: Floats) -> Floats:
    """Return where rays end, (m, n_rays, 2) [m, map]; without a return MAX_REACH away, broken ones at the laser."""
    bearing, ranges = rays[..., 0], rays[..., 1]
    reach = np.minimum(ranges, MAX_REACH)[..., None]
    ends = lasers[..., :2] + reach * np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
    return np.asarray(np.where((ranges > 0)[..., None], ends, lasers[..., :2]))


def _free(
    origin: Floats, side: float, shape: NDArray[np.int_], arena: Arena | None, lasers: Floats, ends: Floats
) -> Bools:
    """Tell which cells (nx, ny) are free: whose middle is in the arena; without one, which many rays crossed."""
    nx, ny = map(int, shape)
    if arena is not None:
        i, j = np.indices((nx, ny))
        middles = origin + (np.stack([i, j], axis=-1).reshape(-1, 2) + 0.5) * side
        return np.asarray(arena.contains(middles).reshape(nx, ny))
    origins = np.broadcast_to(lasers[..., :2], ends.shape).reshape(-1, 2)
    way = ends.reshape(-1, 2) - origins
    length = np.hypot(*way.T)
    went = length > side
    crossed = ObservedSpace.of(  # up to a cell before the return: that one is a wall's
        origins[went], way[went] / length[went, None], length[went] - side, cell=side
    )
    a, b = np.round((origin - crossed.origin) / crossed.cell).astype(int)
    free = np.zeros((nx, ny), dtype=np.bool_)
    part = crossed.counts[max(a, 0) : a + nx, max(b, 0) : b + ny]
    free[max(-a, 0) :, max(-b, 0) :][: part.shape[0], : part.shape[1]] = part >= MIN_RAYS_THROUGH
    return free


def _doubt_map(graph: Sensorgraph, grid: Coverage) -> DoubtMap:
    """Ask the graph from the middle of coarser cells, of which all four quarters are free."""
    free: Bools = np.asarray(grid.reachable.any(axis=2))
    nx, ny = np.array(free.shape) // 2
    whole: Bools = np.asarray(free[: 2 * nx, : 2 * ny].reshape(nx, 2, ny, 2).all(axis=(1, 3)))
    coarse = Coverage.empty(origin=grid.origin, cell=2 * grid.cell, cells=whole, headings=DOUBT_HEADINGS)
    value = uncertainty(graph, coarse, max_rays=DOUBT_RAYS).mean(axis=2)
    return DoubtMap(origin=grid.origin, cell=coarse.cell, doubt=np.where(whole, value, np.nan))


def _share(part: Floats | Ints, whole: Floats | Ints) -> Floats:
    return np.asarray(part / np.where(whole > 0, whole, np.nan), dtype=np.float64)
