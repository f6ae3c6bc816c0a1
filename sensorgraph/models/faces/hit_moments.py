"""Pooled moments of the end points of rays, from which faces are selected.

Hits are assigned to small cells. Each cell stores count, first and second moments of its end points and the sum of
the ray directions. Moments of several runs can be added (`merge`), so logs can be streamed, merged and distributed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sensorgraph.models.faces.settings import FACES
from sensorgraph.types import Floats

HIT_CELL = FACES.hit_cell
"""[m] Side of a cell."""
N_MOMENTS = 8  # count, x, y, xx, xy, yy (about the cell's centre), ux, uy
N_SECTORS = 8
"""Number of sectors of ray directions by which the sides of a thin thing are distinguished."""
_KEY_OFFSET = 1 << 30  # a key distinguishes ± this many cells along an axis


@dataclass(frozen=True, kw_only=True, eq=False)
class HitMoments:
    """Moments of hits in the cells of a grid; the corner of cell (0, 0) is the origin of map."""

    cells: NDArray[np.int64]
    """(n_cells, 2) column and row, in the order of the key (by column, then row)."""
    moments: Floats
    """(n_cells, 8) count, x, y, xx, xy, yy [m, relative to the cell's centre], sum of ray directions."""

    @classmethod
    def of(cls, points: Floats, directions: Floats, weights: Floats | None = None) -> HitMoments:
        """Pool end points (n, 2) [m] of rays with directions (n, 2) and weights (n,), 1 by default."""
        known = np.isfinite(points).all(axis=1)
        points, (ux, uy) = points[known], directions[known].T
        w = np.ones(len(points)) if weights is None else weights[known]
        cells = np.floor(points / HIT_CELL).astype(np.int64)
        hit, row = _distinct(cells)
        x, y = (points - (cells + 0.5) * HIT_CELL).T
        columns = (w, w * x, w * y, w * x * x, w * x * y, w * y * y, w * ux, w * uy)
        sums = [np.bincount(row, column, minlength=len(hit)) for column in columns]
        return cls(cells=hit, moments=np.stack(sums, axis=1))

    @classmethod
    def by_direction(cls, points: Floats, directions: Floats) -> list[HitMoments]:
        """Pool end points (n, 2) [m] of rays with directions (n, 2) in `N_SECTORS` sectors of direction separately."""
        sector = _sectors(directions)
        return [cls.of(points[sector == k], directions[sector == k]) for k in range(N_SECTORS)]

    def split_by_direction(self) -> list[HitMoments]:
        """Divide the cells into `N_SECTORS` sectors by the mean direction of their rays."""
        sector = _sectors(self.moments[:, 6:8])
        return [
            HitMoments(cells=self.cells[sector == k], moments=self.moments[sector == k])
            for k in range(N_SECTORS)
        ]

    def merge(self, other: HitMoments) -> HitMoments:
        """Return the moments of two disjoint sets of hits together."""
        mine, theirs = _keys(self.cells), _keys(other.cells)
        keys = np.union1d(mine, theirs)
        moments = np.zeros((len(keys), N_MOMENTS))
        moments[np.searchsorted(keys, mine)] = self.moments
        moments[np.searchsorted(keys, theirs)] += other.moments
        return HitMoments(cells=_cells(keys), moments=moments)

    def scaled_down(self, n: int) -> HitMoments:
        """Return the moments of hits in a place n times smaller, in cells of the same side: n by n of these are joined."""
        coarse = self.cells // n
        x, y = ((self.cells - n * coarse - (n - 1) / 2) * HIT_CELL).T  # from the centre of the joined cell
        w, wx, wy, wxx, wxy, wyy, ux, uy = self.moments.T
        cells, row = _distinct(coarse)
        columns = (
            w, (wx + w * x) / n, (wy + w * y) / n, (wxx + 2 * x * wx + w * x * x) / n**2,
            (wxy + x * wy + y * wx + w * x * y) / n**2, (wyy + 2 * y * wy + w * y * y) / n**2, ux, uy,
        )  # fmt: skip
        sums = [np.bincount(row, column, minlength=len(cells)) for column in columns]
        return HitMoments(cells=cells, moments=np.stack(sums, axis=1))

    @property
    def counts(self) -> Floats:
        """(n_cells,) number of hits."""
        return np.asarray(self.moments[:, 0], dtype=np.float64)

    @property
    def centres(self) -> Floats:
        """(n_cells, 2) [m] centres of the cells in map."""
        return np.asarray((self.cells + 0.5) * HIT_CELL, dtype=np.float64)


def _sectors(directions: Floats) -> NDArray[np.intp]:
    """Return the sector (n,) of each direction (n, 2), which need not be of unit length."""
    turn = np.arctan2(directions[:, 1], directions[:, 0])
    return np.floor(turn / (2 * np.pi) * N_SECTORS).astype(np.intp) % N_SECTORS


def _distinct(cells: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.intp]]:
    """Return the distinct cells in the order of the key, and the row of each cell (n,) among them.

    A table of all cells around is faster than sorting, unless it is larger than the input.
    """
    low = cells.min(axis=0, initial=_KEY_OFFSET)
    shape = cells.max(axis=0, initial=-_KEY_OFFSET) - low + 1
    if len(cells) == 0 or shape.prod() > len(cells):
        keys, row = np.unique(_keys(cells), return_inverse=True)
        return _cells(keys), row
    at = (cells - low) @ np.array([shape[1], 1])
    is_hit = np.bincount(at, minlength=shape.prod()) > 0
    hit = np.stack(np.divmod(np.flatnonzero(is_hit), shape[1]), axis=1) + low
    return hit, (np.cumsum(is_hit) - 1)[at]


def _keys(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.asarray(((cells[:, 0] + _KEY_OFFSET) << 32) | (cells[:, 1] + _KEY_OFFSET))


def _cells(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.stack([(keys >> 32) - _KEY_OFFSET, (keys & 0xFFFFFFFF) - _KEY_OFFSET], axis=1)
