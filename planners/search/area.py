"""The part of the floor on which a search plans."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planners.reach import Reach
from planners.rooms import NEIGHBOUR_STEPS, open_borders
from planners.types import Bools, Floats, Ints

MIN_INNER_SHARE = 0.12
"""Minimum reachable share of a cell's inner half for its bins to count only there; else they count everywhere
(`python -m benchmarks.plan_options margin`)."""
MARGIN_CELLS = 8
"""Number of cells around a room in which the search may drive."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SearchArea:
    """A rectangular part of the floor, with its own arrays."""

    corner: Ints
    """(2,) cell of the whole grid that is cell (0, 0) of the area."""
    origin: Floats
    """(2,) [m] lower left corner."""
    step: float
    """[m] between nodes of `distance`."""
    cell: float
    """[m] side of a cell."""
    clearance: float
    """[m] required distance of the robot's centre from barriers."""
    distance: Floats
    """(mx, my) [m] distance of each node to the nearest barrier."""
    inner: Bools
    """(nx, ny) cells whose bins count only in their inner half."""
    open_borders: Ints
    """(nx, ny) bits, see `rooms.open_borders`; borders to cells outside the area are closed."""

    def part(self, array: np.ndarray) -> np.ndarray:
        """Return the part of an array (whole nx, whole ny, ...) that belongs to this area."""
        (i, k), (nx, ny) = self.corner, self.inner.shape
        return np.ascontiguousarray(array[i : i + nx, k : k + ny])


def search_area(reach: Reach, cells: Bools | None = None) -> SearchArea:
    """Return the whole floor as an area, or the surroundings of `cells` (nx, ny)."""
    (nx, ny), p = reach.shape, reach.per_cell
    low, high = np.zeros(2, dtype=np.int64), np.array([nx, ny])
    if cells is not None:
        at = np.argwhere(cells)
        low, high = (
            np.maximum(at.min(axis=0) - MARGIN_CELLS, 0),
            np.minimum(at.max(axis=0) + 1 + MARGIN_CELLS, high),
        )
    window = np.s_[low[0] : high[0], low[1] : high[1]]
    nodes = np.s_[low[0] * p : high[0] * p, low[1] * p : high[1] * p]
    linked = open_borders(reach)[window].copy()
    for bit, (i, k) in enumerate(NEIGHBOUR_STEPS):  # close the borders of the area
        for axis, side in ((0, i), (1, k)):
            if side:
                edge = linked[-1 if side > 0 else 0] if axis == 0 else linked[:, -1 if side > 0 else 0]
                edge &= ~(1 << bit)
    return SearchArea(
        corner=low,
        origin=reach.origin + low * reach.cell,
        step=reach.step,
        cell=reach.cell,
        clearance=reach.clearance,
        distance=np.ascontiguousarray(reach.distance[nodes]),
        inner=np.ascontiguousarray(_inner(reach)[window]),
        open_borders=linked,
    )


def _inner(reach: Reach) -> Bools:
    """Return the cells (nx, ny) whose inner half can be reached, at least in part."""
    p = reach.per_cell
    blocks = reach.blocks(reach.mask).reshape(*reach.shape, p, p)
    within = abs((np.arange(p) + 0.5) / p - 0.5) <= 0.25
    return np.asarray(blocks[:, :, within][:, :, :, within].mean(axis=(2, 3)) >= MIN_INNER_SHARE)
