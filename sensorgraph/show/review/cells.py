"""The (x, y, phi) cells of a review: visits, answered rays and wrong rays.

A place that is not answered needs a drive. A place with wrong answers shows that the model fails there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from planners.arena import Arena
from planners.coverage import CELL, HEADINGS, Coverage
from sensorgraph.evaluation.evaluate import MAX_SCORED_RANGE, Evaluation
from sensorgraph.graph import Sensorgraph
from sensorgraph.models.base import OFF_DISTANCE
from sensorgraph.models.faces.observed_space import ObservedSpace
from sensorgraph.planning.priority import uncertainty
from sensorgraph.types import Bools, Floats, Ints

MAX_CELLS = 40_000
"""Maximum number of cells; the side of a cell is doubled until there are no more."""
EXPECTED_ERROR_HEADINGS = 4
"""Number of headings in which the expected error of a place is predicted."""
EXPECTED_ERROR_RAYS = 60
"""Approximate number of rays that are predicted in each heading; neighbouring rays are similar."""
MIN_RAYS_THROUGH = 20
"""Number of rays through a cell above which it is free, if there is no map."""
SATURATING_UNANSWERED = 0.5
"""Share of unanswered rays in a cell above which its colour is that of "not answered"."""
SATURATING_WRONG = 0.1
"""Minimum of `RayCounts.saturating_wrong`."""
WORTH_A_VISIT = 0.2
"""Expected error of a place above which a visit is suggested; about the share of rays not answered from there."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RayCounts:
    """Numbers of rays scored, answered and wrong in each cell: (nx, ny, n_phi), or (nx, ny) over all headings."""

    scored: Ints
    answered: Ints
    wrong: Ints
    """Rays that are answered with an error above 5 cm."""

    @classmethod
    def of(cls, evaluation: Evaluation, poses: Floats, grid: Coverage) -> RayCounts:
        """Count the rays of each scan in the cell of its pose (n_scans, 3); all poses are on the grid."""
        scored = np.isfinite(evaluation.residual)
        answered = scored & evaluation.answered_rays
        wrong = answered & (np.abs(np.nan_to_num(evaluation.residual)) > OFF_DISTANCE)
        return cls(**{
            name: sum_in_cells(rays.sum(axis=1), poses, grid).astype(np.intp)
            for name, rays in (("scored", scored), ("answered", answered), ("wrong", wrong))
        })  # fmt: skip

    @property
    def by_place(self) -> RayCounts:
        """Counts over all headings."""
        return RayCounts(
            scored=self.scored.sum(axis=2), answered=self.answered.sum(axis=2), wrong=self.wrong.sum(axis=2)
        )

    @property
    def share_unanswered(self) -> Floats:
        """Share of the scored rays that are not answered; nan where no ray was scored."""
        return _share(self.scored - self.answered, self.scored)

    @property
    def share_wrong(self) -> Floats:
        """Share of the answered rays that are wrong; nan where no ray was answered."""
        return _share(self.wrong, self.answered)

    @property
    def saturating_wrong(self) -> float:
        """Share of wrong rays at which colours saturate: SATURATING_WRONG or the 90 % quantile of the cells, if larger."""
        share = self.share_wrong
        known = share[np.isfinite(share)]
        return max(SATURATING_WRONG, float(np.quantile(known, 0.9))) if len(known) else SATURATING_WRONG


@dataclass(frozen=True, kw_only=True, eq=False)
class ReviewCells:
    """(x, y, phi) cells with the number of visits and the errors of the graph from there."""

    grid: Coverage
    """Visits of all scans; `reachable` marks cells that are free in the arena, or that rays crossed."""
    error: Floats | None
    """(nx, ny, n_phi) [m] Mean over scans of the median |residual| of a scan; nan where no ray was scored."""
    ray_counts: RayCounts | None
    expected_error_map: ExpectedErrorMap | None
    """Expected error of the graph in each free place; None without a graph."""

    @property
    def origin(self) -> Floats:
        """(2,) [m] Lower left corner."""
        return self.grid.origin

    @property
    def cell(self) -> float:
        """[m] Side of a cell."""
        return self.grid.cell

    @property
    def counts(self) -> Ints:
        """(nx, ny, n_phi) Number of scans; heading bins are centred on multiples of 2 pi / n_phi."""
        return np.asarray(self.grid.counts, dtype=np.intp)

    @property
    def error_top(self) -> float:
        """[m] Error at which the colour scale ends: the 95 % quantile of the cells."""
        if self.error is None or not np.isfinite(self.error).any():
            return 1.0
        return float(np.nanquantile(self.error, 0.95)) or 1e-3

    @property
    def free(self) -> Bools:
        """(nx, ny) Cells that are known to be free."""
        return np.asarray(self.grid.reachable.any(axis=2))


@dataclass(frozen=True, kw_only=True, eq=False)
class ExpectedErrorMap:
    """Expected error of the graph in each free place, by which `plan --priority` orders a drive."""

    origin: Floats
    """(2,) [m] Lower left corner."""
    cell: float
    """[m] Side of a cell."""
    expected_error: Floats
    """(nx, ny) Mean over headings and rays; 1 where no ray is answered, nan where the place is not free."""

    def places(self, n: int = 3) -> list[tuple[float, float, float]]:
        """Return the n largest areas with an expected error above WORTH_A_VISIT: x, y [m] of the worst cell, area [m²]."""
        is_open = np.nan_to_num(self.expected_error) > WORTH_A_VISIT
        parts, count = ndimage.label(is_open, structure=np.ones((3, 3)))
        sizes = np.bincount(parts.ravel(), minlength=count + 1)[1:]
        out = []
        for k in np.argsort(-sizes, kind="stable")[:n]:
            here = np.where(parts == k + 1, self.expected_error, -np.inf)
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
    """Count visits, errors and rays in the cells, and predict the expected error of the graph.

    Parameters
    ----------
    visited : (n, 3) [m, m, rad] Poses of all scans.
    shown : (m, 3) [m, m, rad] Poses of the evaluated scans.
    rays : Lasers (m, n_rays or 1, 3) in map, and (m, n_rays, 2) with bearing in map [rad] and range [m].
    cell : [m] Side of a cell. None: CELL, or larger if there would be too many cells.
    """
    ends = _ends(*rays)
    if arena is not None:
        low, high = np.array(arena.bounds[:2]), np.array(arena.bounds[2:])
    else:
        low, high = np.quantile(ends.reshape(-1, 2), [0.005, 0.995], axis=0)
    low = np.minimum(low, visited[:, :2].min(axis=0))
    high = np.maximum(high, visited[:, :2].max(axis=0))
    side = cell or CELL
    while cell is None and np.prod((high - low) / side + 2) > MAX_CELLS:
        side *= 2
    origin = np.floor(low / side) * side
    last = np.floor((visited[:, :2].max(axis=0) - origin) / side) + 1
    shape = np.maximum(np.ceil((high - origin) / side - 1e-9), last).astype(int)
    free = _free(origin, side, shape, arena, rays[0], ends)
    grid = Coverage.empty(origin=origin, cell=side, cells=free, headings=HEADINGS)
    grid.add(visited)
    grid.reachable[:] |= np.any(grid.counts > 0, axis=2, keepdims=True)
    return ReviewCells(
        grid=grid,
        error=None if evaluation is None else _error(evaluation, shown, grid),
        ray_counts=None
        if evaluation is None
        else RayCounts.of(evaluation, shown[evaluation.scan_indices], grid),
        expected_error_map=None if graph is None else _expected_error_map(graph, grid),
    )


def sum_in_cells(values: Floats, poses: Floats, grid: Coverage) -> Floats:
    """Add up values (n,) in the cells (nx, ny, n_phi) of their poses (n, 3); all poses are on the grid."""
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
    """Return the end points (m, n_rays, 2) [m, map]; a missing return ends at MAX_SCORED_RANGE, a broken one at the laser."""
    bearing, ranges = rays[..., 0], rays[..., 1]
    reach = np.minimum(ranges, MAX_SCORED_RANGE)[..., None]
    ends = lasers[..., :2] + reach * np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
    return np.asarray(np.where((ranges > 0)[..., None], ends, lasers[..., :2]))


def _free(
    origin: Floats, side: float, shape: NDArray[np.int_], arena: Arena | None, lasers: Floats, ends: Floats
) -> Bools:
    """Return which cells (nx, ny) are free: their centre is in the arena or, without an arena, many rays crossed them."""
    nx, ny = map(int, shape)
    if arena is not None:
        i, j = np.indices((nx, ny))
        middles = origin + (np.stack([i, j], axis=-1).reshape(-1, 2) + 0.5) * side
        return np.asarray(arena.contains(middles).reshape(nx, ny))
    origins = np.broadcast_to(lasers[..., :2], ends.shape).reshape(-1, 2)
    rays = ends.reshape(-1, 2) - origins
    length = np.hypot(*rays.T)
    long = length > side
    crossed = ObservedSpace.of(  # up to one cell before the return, which contains the wall
        origins[long], rays[long] / length[long, None], length[long] - side, cell=side
    )
    a, b = np.round((origin - crossed.origin) / crossed.cell).astype(int)
    free = np.zeros((nx, ny), dtype=np.bool_)
    part = crossed.counts[max(a, 0) : a + nx, max(b, 0) : b + ny]
    free[max(-a, 0) :, max(-b, 0) :][: part.shape[0], : part.shape[1]] = part >= MIN_RAYS_THROUGH
    return free


def _expected_error_map(graph: Sensorgraph, grid: Coverage) -> ExpectedErrorMap:
    """Predict from the centres of cells of twice the size whose four quarters are free."""
    free: Bools = np.asarray(grid.reachable.any(axis=2))
    nx, ny = np.array(free.shape) // 2
    whole: Bools = np.asarray(free[: 2 * nx, : 2 * ny].reshape(nx, 2, ny, 2).all(axis=(1, 3)))
    coarse = Coverage.empty(
        origin=grid.origin, cell=2 * grid.cell, cells=whole, headings=EXPECTED_ERROR_HEADINGS
    )
    value = uncertainty(graph, coarse, max_rays=EXPECTED_ERROR_RAYS).mean(axis=2)
    return ExpectedErrorMap(
        origin=grid.origin, cell=coarse.cell, expected_error=np.where(whole, value, np.nan)
    )


def _share(part: Floats | Ints, whole: Floats | Ints) -> Floats:
    return np.asarray(part / np.where(whole > 0, whole, np.nan), dtype=np.float64)
