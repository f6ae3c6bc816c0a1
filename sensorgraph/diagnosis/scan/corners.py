"""Corners of a map, whose errors move the walls that end there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from sensorgraph.types import Bools, Floats, Ints


@dataclass(frozen=True, kw_only=True, eq=False)
class Corners:
    """Which corners of the map each wall ends at."""

    ends: Ints
    """(n_walls, 2) index of a corner."""
    count: int

    @classmethod
    def of(cls, walls: Floats, met: Bools | None = None) -> Corners:
        """Merge wall ends that coincide, and all that only end walls (n_walls,) which nothing meets."""
        points = np.round(walls.reshape(-1, 2), 6)
        _, index = np.unique(points, axis=0, return_inverse=True)
        index = index.reshape(-1, 2)
        count = int(index.max()) + 1 if len(index) else 0
        if met is not None:
            is_met = np.zeros(count, dtype=np.bool_)
            is_met[index[met]] = True
            n_met = int(is_met.sum())
            index = np.where(is_met, np.cumsum(is_met) - 1, n_met)[index]
            count = min(n_met + 1, count)
        return cls(ends=index, count=count)

    def along_normals(self, walls: Floats) -> csr_array:
        """Return the sparse matrix (2 n_walls, 2 count) from shifts of corners to those of wall ends along normals."""
        n_walls = len(walls)
        d = walls[:, 1] - walls[:, 0]
        d = d / np.maximum(np.hypot(d[:, 0], d[:, 1]), 1e-12)[:, None]
        n = np.stack([d[:, 1], -d[:, 0]], axis=1)  # (n_walls, 2)
        columns = 2 * self.ends.T.reshape(-1, 1) + np.arange(2)  # (2 n_walls, 2), first ends before last ones
        starts = 2 * np.arange(2 * n_walls + 1)
        return csr_array((np.tile(n, (2, 1)).ravel(), columns.ravel(), starts), (2 * n_walls, 2 * self.count))
