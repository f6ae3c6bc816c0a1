"""Corners of a map, whose position errors move the walls that end there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sensorgraph.types import Bools, Floats, Ints


@dataclass(frozen=True, kw_only=True, eq=False)
class Corners:
    """Corners at the ends of each wall."""

    ends: Ints
    """(n_walls, 2) Indices of the corners."""
    count: int
    rest: int = -1
    """Index shared by all fixed corners; -1 if every corner may shift."""

    @classmethod
    def of(cls, walls: Floats, met: Bools | None = None) -> Corners:
        """Merge wall ends that coincide; corners that only end walls which no ray meets, by `met` (n_walls,), are fixed."""
        x, y = np.round(walls.reshape(-1, 2), 6).T
        _, index = np.unique(x + 1j * y, return_inverse=True)
        index = index.reshape(-1, 2)
        count = int(index.max()) + 1 if len(index) else 0
        if met is None:
            return cls(ends=index, count=count)
        is_met = np.zeros(count, dtype=np.bool_)
        is_met[index[met]] = True
        n_met = int(is_met.sum())
        if n_met == count:
            return cls(ends=index, count=count)
        index = np.where(is_met, np.cumsum(is_met) - 1, n_met)[index]
        return cls(ends=index, count=n_met + 1, rest=n_met)
