"""Space that training rays crossed, in which predictions are supported by data."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_cdt

from planners.kernel import inner_kernel, outer_kernel
from sensorgraph.models.cells.grid import traverse
from sensorgraph.models.faces.settings import FACES
from sensorgraph.types import Bools, Floats

MAX_CELLS = 1 << 26
"""Maximum number of cells; a larger grid is coarsened."""
MAX_COUNT = int(np.iinfo(np.uint8).max)
"""Maximum count of a cell, which fits into one byte."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ObservedSpace:
    """A grid that counts the training rays through each cell, up to and including the cell of the return."""

    origin: Floats
    """(2,) [m] corner of cell (0, 0)."""
    cell: float
    """[m] Side of a cell."""
    counts: NDArray[np.uint8]
    """(nx, ny) number of rays, at most 255."""
    free: Bools
    """(nx, ny) whether a returned ray crossed the cell; or any ray, if missing returns are rays through free space."""

    @classmethod
    def of(
        cls, origins: Floats, directions: Floats, reach: Floats, *, returned: Bools | None = None,
        cell: float = FACES.observed_cell,
    ) -> ObservedSpace:  # fmt: skip
        """Count rays (n, 2), (n, 2) up to `reach` (n,) [m]; rays in the mask `returned` (n,), or all, mark free space."""
        ends = origins + reach[:, None] * directions
        low, high = np.minimum(origins, ends).min(axis=0), np.maximum(origins, ends).max(axis=0)
        while np.prod((high - low) / cell + 4) > MAX_CELLS:
            cell *= 2
        corner = np.floor(low / cell - 1) * cell
        shape = np.ceil((high - corner) / cell).astype(int) + 2
        counts = np.zeros((int(shape[0]), int(shape[1])), dtype=np.uint8)
        free = np.zeros(counts.shape, dtype=np.bool_)
        marks_free = np.ones(len(reach), dtype=np.bool_) if returned is None else returned
        most = sum(counts.shape)  # a ray crosses no more cells of the grid
        work = np.empty((most, 2), np.int64), np.empty(most)
        _count_rays(origins, directions, reach, marks_free, corner, cell, counts, free, work)
        return cls(origin=corner, cell=cell, counts=counts, free=free)

    def with_missing(self, ranges: Floats, range_max: float) -> ObservedSpace:
        """Mark all counted cells as free if the missing returns among `ranges` (n,) [m] are consistent with that."""
        return replace(self, free=self.counts > 0) if missing_returns_are_free(ranges, range_max) else self

    @cached_property
    def distance_to_unobserved(self) -> NDArray[np.uint8]:
        """(nx, ny) Chebyshev distance in cells to the nearest cell without rays; cells outside the grid have none."""
        known = np.pad(self.counts > 0, 1)
        far = distance_transform_cdt(known, metric="chessboard")[1:-1, 1:-1]
        return np.minimum(far, MAX_COUNT).astype(np.uint8)

    def merge(self, other: ObservedSpace) -> ObservedSpace:
        """Add the counts of two sets of rays; a finer grid is coarsened, and both are if the sum has too many cells."""
        if self.cell != other.cell:
            fine, coarse = sorted((self, other), key=lambda grid: grid.cell)
            return fine.coarser().merge(coarse)
        corners = np.round(np.stack([self.origin, other.origin]) / self.cell).astype(int)
        low = corners.min(axis=0)
        high = np.max([corners[0] + self.counts.shape, corners[1] + other.counts.shape], axis=0)
        if np.prod((high - low).astype(float)) > MAX_CELLS:
            return self.coarser().merge(other.coarser())
        total, free = np.zeros(high - low, dtype=np.uint16), np.zeros(high - low, dtype=np.bool_)
        for corner, grid in zip(corners, (self, other), strict=True):
            i, j = corner - low
            part = np.s_[i : i + grid.counts.shape[0], j : j + grid.counts.shape[1]]
            total[part] += grid.counts
            free[part] |= grid.free
        return ObservedSpace(
            origin=low * self.cell,
            cell=self.cell,
            counts=np.minimum(total, MAX_COUNT).astype(np.uint8),
            free=free,
        )

    def coarser(self) -> ObservedSpace:
        """Return a grid of cells twice as wide; a ray counts once for each fine cell that it crossed."""
        corner = np.round(self.origin / self.cell).astype(int)
        before = corner % 2
        after = (before + self.counts.shape) % 2
        sides = np.stack([before, after], axis=1)
        counts, free = np.pad(self.counts.astype(np.uint16), sides), np.pad(self.free, sides)
        fours = (counts.shape[0] // 2, 2, counts.shape[1] // 2, 2)
        return ObservedSpace(
            origin=(corner - before) * self.cell,
            cell=2 * self.cell,
            counts=np.minimum(counts.reshape(fours).sum(axis=(1, 3)), MAX_COUNT).astype(np.uint8),
            free=free.reshape(fours).max(axis=(1, 3)),
        )


def missing_returns_are_free(ranges: Floats, range_max: float) -> bool:
    """Return whether all missing returns, the infinite `ranges` (n,) [m], may be rays through free space.

    A ray does not return from beyond `range_max`, or from black, smooth or transparent surfaces. If all missing returns
    are free up to `range_max`, rays stop at the rate 1 / mean_free_path. The mean free path is the total length of all
    rays divided by the number of returns. At least n_missing (range_max - r) / mean_free_path returns are then expected
    beyond a range r. Return False if there are fewer, for any r that is a mean free path or more below `range_max`.
    """
    returned = np.sort(ranges[np.isfinite(ranges)])
    n_missing, n = len(ranges) - len(returned), len(returned)
    if n_missing == 0 or n == 0:
        return True
    mean_free_path = (returned.sum() + n_missing * range_max) / n
    expected = n_missing * (range_max - returned) / mean_free_path
    beyond = np.arange(n)[::-1]
    return not ((beyond < expected) & (returned <= range_max - mean_free_path)).any()


@inner_kernel
def is_ray_observed(
    px: Any, py: Any, ux: Any, uy: Any, reach: Any, origin: Any, cell: Any, clearance: Any
) -> Any:
    """Return whether all cells of a ray are observed; jumps of `ObservedSpace.distance_to_unobserved` cells."""
    nx, ny = clearance.shape
    x, y = (px - origin[0]) / cell, (py - origin[1]) / cell
    i: Any = int(np.floor(x))
    j: Any = int(np.floor(y))
    if i < 0 or j < 0 or i >= nx or j >= ny:
        return False
    per_x = 1.0 / ux if abs(ux) > 1e-12 else 1e300
    per_y = 1.0 / uy if abs(uy) > 1e-12 else 1e300
    reach = reach / cell
    while True:
        jump: Any = np.int64(clearance[i, j])  # signed, since it is also subtracted
        if jump == 0:
            return False
        r_x = ((i + jump if ux > 0 else i + 1 - jump) - x) * per_x if per_x < 1e299 else 1e300
        r_y = ((j + jump if uy > 0 else j + 1 - jump) - y) * per_y if per_y < 1e299 else 1e300
        if min(r_x, r_y) > reach:
            return True
        if r_x < r_y:
            i += jump if ux > 0 else -jump
            far = int(np.floor(y + r_x * uy))
            j = min(max(far, j), j + jump - 1) if uy > 0 else max(min(far, j), j - jump + 1)
        else:
            j += jump if uy > 0 else -jump
            far = int(np.floor(x + r_y * ux))
            i = min(max(far, i), i + jump - 1) if ux > 0 else max(min(far, i), i - jump + 1)
        if i < 0 or j < 0 or i >= nx or j >= ny:
            return False


@outer_kernel
def _count_rays(
    origins: Any, directions: Any, reach: Any, marks_free: Any, origin: Any, cell: Any, counts: Any, free: Any,
    work: Any,
) -> Any:  # fmt: skip
    nx, ny = counts.shape
    at, ends = work
    for k in range(len(reach)):
        x, y = origins[k, 0] - origin[0], origins[k, 1] - origin[1]
        n = traverse(x, y, directions[k, 0], directions[k, 1], reach[k], cell, at, ends)
        for m in range(n):
            i, j = at[m]
            if 0 <= i < nx and 0 <= j < ny:
                counts[i, j] = min(counts[i, j] + 1, MAX_COUNT)
                free[i, j] = free[i, j] or marks_free[k]
