"""Pooled moments of the end points of rays, from which faces are selected.

Hits are assigned to small cells. Each cell stores count, first and second moments of its end points and the sum of
the ray directions. Moments of several runs can be added (`merge`), so logs can be streamed, merged and distributed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planners.kernel import kernel
from sensorgraph.models.faces.settings import FACES
from sensorgraph.types import Floats

HIT_CELL = FACES.hit_cell
"""[m] Side of a cell."""
N_MOMENTS = 8  # count, x, y, xx, xy, yy (about the cell's centre), ux, uy
_KEY_OFFSET = 1 << 30  # a key distinguishes ± this many cells along an axis


@dataclass(frozen=True, kw_only=True, eq=False)
class HitMoments:
    """Moments of hits in the cells of a grid; the corner of cell (0, 0) is the origin of map."""

    cells: NDArray[np.int64]
    """(n_cells, 2) column and row, in the order of the key (by column, then row)."""
    moments: Floats
    """(n_cells, 8) count, x, y, xx, xy, yy [m, relative to the cell's centre], sum of ray directions."""

    @classmethod
    def empty(cls) -> HitMoments:
        """Return moments without hits."""
        return cls(cells=np.zeros((0, 2), dtype=np.int64), moments=np.zeros((0, N_MOMENTS)))

    @classmethod
    def of(cls, points: Floats, directions: Floats, weights: Floats | None = None) -> HitMoments:
        """Pool end points (n, 2) [m] of rays with directions (n, 2) and weights (n,), 1 by default."""
        weights = np.ones(len(points)) if weights is None else weights
        n, keys, moments = _pool(points, directions, weights, HIT_CELL)
        keys, moments = keys[:n], moments[:n]
        order = np.argsort(keys, kind="stable")
        keys = keys[order]
        return cls(cells=_cells(keys), moments=moments[order])

    def merge(self, other: HitMoments) -> HitMoments:
        """Return the moments of two disjoint sets of hits together."""
        mine, theirs = _keys(self.cells), _keys(other.cells)
        keys = np.union1d(mine, theirs)
        moments = np.zeros((len(keys), N_MOMENTS))
        moments[np.searchsorted(keys, mine)] = self.moments
        moments[np.searchsorted(keys, theirs)] += other.moments
        return HitMoments(cells=_cells(keys), moments=moments)

    @property
    def counts(self) -> Floats:
        """(n_cells,) number of hits."""
        return np.asarray(self.moments[:, 0], dtype=np.float64)

    @property
    def centres(self) -> Floats:
        """(n_cells, 2) [m] centres of the cells in map."""
        return np.asarray((self.cells + 0.5) * HIT_CELL, dtype=np.float64)


def _keys(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.asarray(((cells[:, 0] + _KEY_OFFSET) << 32) | (cells[:, 1] + _KEY_OFFSET))


def _cells(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.stack([(keys >> 32) - _KEY_OFFSET, (keys & 0xFFFFFFFF) - _KEY_OFFSET], axis=1)


@kernel
def _pool(points: Any, directions: Any, weights: Any, cell: Any) -> Any:
    """Sum moments by cell in an open hash table; keys are column << 32 | row, shifted to be positive.

    Returns the number of cells n, and arrays whose first n rows hold keys and moments.
    """
    size = 1 << 12
    table: Any = np.empty(size, np.int64)  # slot -> row of moments
    slot: Any = 0
    for slot in range(size):
        table[slot] = -1
    keys = np.empty(size, np.int64)
    moments = np.zeros((size, N_MOMENTS))
    n = 0
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        if not (np.isfinite(x) and np.isfinite(y)):
            continue
        cx, cy = np.int64(np.floor(x / cell)), np.int64(np.floor(y / cell))
        key = ((cx + _KEY_OFFSET) << 32) | (cy + _KEY_OFFSET)
        slot = (key * 0x9E3779B97F4A7C1 >> 20) & (size - 1)
        while table[slot] >= 0 and keys[table[slot]] != key:
            slot = (slot + 1) & (size - 1)
        row = table[slot]
        if row < 0:
            row = n
            keys[row] = key
            table[slot] = row
            n += 1
        x -= (cx + 0.5) * cell
        y -= (cy + 0.5) * cell
        w = weights[i]
        m = moments[row]
        m[0] += w
        m[1] += w * x
        m[2] += w * y
        m[3] += w * x * x
        m[4] += w * x * y
        m[5] += w * y * y
        m[6] += w * directions[i, 0]
        m[7] += w * directions[i, 1]
        if n * 2 > size:
            size *= 2
            grown, larger = np.empty(size, np.int64), np.zeros((size, N_MOMENTS))
            table = np.empty(size, np.int64)
            for slot in range(size):
                table[slot] = -1
            for row in range(n):
                grown[row] = keys[row]
                for c in range(N_MOMENTS):
                    larger[row, c] = moments[row, c]
            keys, moments = grown, larger
            for row in range(n):
                slot = (keys[row] * 0x9E3779B97F4A7C1 >> 20) & (size - 1)
                while table[slot] >= 0:
                    slot = (slot + 1) & (size - 1)
                table[slot] = row
    return n, keys, moments
