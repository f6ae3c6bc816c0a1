"""Map of free, occupied and unknown cells, as robots publish it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from logs.types import Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class OccupancyMap:
    """An occupancy-grid map of free, occupied and unknown cells."""

    data: NDArray[np.int8]
    """(ny, nx) -1: unknown, 0: free, 100: occupied; row 0 has the lowest y."""
    resolution: float
    """[m] side length of a cell."""
    origin: Floats
    """(3,) [m, m, rad] pose in map of the lower left corner of cell (0, 0)."""

    def __post_init__(self) -> None:
        if self.data.ndim != 2 or self.data.dtype != np.int8 or self.data.min(initial=0) < -1:
            raise ValueError(
                f"data has shape {self.data.shape} and type {self.data.dtype}, expected (ny, nx) int8 from -1 to 100"
            )
        if self.origin.shape != (3,) or not self.resolution > 0:
            raise ValueError(
                f"origin has shape {self.origin.shape} and resolution is {self.resolution}, "
                "expected (3,) and a positive number"
            )
