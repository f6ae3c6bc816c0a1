"""Corners of a map, whose errors move the walls that end there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

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

    def along_normals(self, walls: Floats) -> Floats:
        """Return the matrix (2 n_walls, 2 count) from shifts of corners to shifts of wall ends along the walls' normals."""
        n_walls = len(walls)
        d = walls[:, 1] - walls[:, 0]
        d = d / np.maximum(np.hypot(d[:, 0], d[:, 1]), 1e-12)[:, None]
        n = np.stack([d[:, 1], -d[:, 0]], axis=1)  # (n_walls, 2)
        matrix = np.zeros((2, n_walls, self.count, 2))
        k = np.arange(n_walls)
        for end in (0, 1):
            matrix[end, k, self.ends[:, end]] = n
        return matrix.reshape(2 * n_walls, 2 * self.count)
