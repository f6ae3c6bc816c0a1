"""Space that training rays have crossed: where a prediction may be trusted, because someone has looked."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_cdt

from planners.kernel import inner_kernel, kernel, outer_kernel
from sensorgraph.models.faces.settings import FACES
from sensorgraph.types import Bools, Floats

PREDICTION = FACES.prediction
MAX_COUNT = 255
"""Rays that a cell counts, at most: one byte."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ObservedSpace:
    """A grid of counts: how many training rays went through each cell, up to and with the cell of the return."""

    origin: Floats
    """(2,) [m] corner of cell (0, 0)."""
    cell: float
    """[m]"""
    counts: NDArray[np.uint8]
    """(nx, ny) rays, 255 at most."""
    free: Bools
    """(nx, ny) whether a ray that returned went through; or any, if missing returns are of free rays."""

    @classmethod
    def of(
        cls,
        origins: Floats,
        directions: Floats,
        reach: Floats,
        *,
        returned: Bools | None = None,
        cell: float = PREDICTION.observed_cell,
    ) -> ObservedSpace:
        """Count rays (n, 2), (n, 2) that met nothing up to `reach` (n,) [m]; those `returned` (n,), or all, show free space."""
        low, high = _extent(origins, directions, reach)
        while np.prod((high - low) / cell + 4) > PREDICTION.max_observed_cells:
            cell *= 2
        corner = np.floor(low / cell - 1) * cell
        shape = np.ceil((high - corner) / cell).astype(int) + 2
        counts = np.zeros((int(shape[0]), int(shape[1])), dtype=np.uint8)
        free = np.zeros(counts.shape, dtype=np.bool_)
        shows = np.ones(len(reach), dtype=np.bool_) if returned is None else returned
        _count_rays(origins, directions, reach, shows, corner, cell, counts, free)
        return cls(origin=corner, cell=cell, counts=counts, free=free)

    def with_missing(self, ranges: Floats, range_max: float) -> ObservedSpace:
        """Take the way of missing returns among `ranges` (n,) [m], counted already, for free if they show that."""
        return replace(self, free=self.counts > 0) if missing_returns_are_free(ranges, range_max) else self

    @cached_property
    def distance_to_unobserved(self) -> NDArray[np.uint8]:
        """(nx, ny) cells to the nearest one that nothing crossed, the longer of both axes; the grid ends in such."""
        known = np.pad(self.counts > 0, 1)
        far = distance_transform_cdt(known, metric="chessboard")[1:-1, 1:-1]
        return np.minimum(far, MAX_COUNT).astype(np.uint8)

    def merge(self, other: ObservedSpace) -> ObservedSpace:
        """Add the counts of two sets of rays; the finer grid, or both where that is too many cells, is made coarser."""
        if self.cell != other.cell:
            fine, coarse = sorted((self, other), key=lambda grid: grid.cell)
            return fine.coarser().merge(coarse)
        corners = np.round(np.stack([self.origin, other.origin]) / self.cell).astype(int)
        low = corners.min(axis=0)
        high = np.max([corners[0] + self.counts.shape, corners[1] + other.counts.shape], axis=0)
        if np.prod((high - low).astype(float)) > PREDICTION.max_observed_cells:
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
        """Return the grid of cells twice as wide; a ray counts once for each fine cell it went through."""
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

    def supports(self, origins: Floats, directions: Floats, reach: Floats) -> Bools:
        """Tell for rays (n, 2), (n, 2) whether every cell up to `reach` (n,) [m] was crossed."""
        out = np.zeros(len(origins), dtype=np.bool_)
        _are_rays_observed(
            origins, directions, reach, self.origin, self.cell, self.distance_to_unobserved, out
        )
        return out


def missing_returns_are_free(ranges: Floats, range_max: float) -> bool:
    """Tell whether rays without a return can all have been free; `ranges` (n,) [m], not finite where nothing returned.

    Nothing returns from beyond `range_max`, nor from surfaces that are black, smooth or of glass. If all missing returns
    were of free rays, these would have gone on to `range_max`, and other rays of that length would have been stopped on
    the way at one rate: once in a mean free path, the metres gone over the returns. They were not where from beyond
    some range fewer returns came than that rate makes of the missing ones; looked at where a mean free path is left.
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
def is_ray_observed(px: Any, py: Any, ux: Any, uy: Any, reach: Any, origin: Any, cell: Any, room: Any) -> Any:
    """Walk the cells of a ray, as far at a time as there is `ObservedSpace.distance_to_unobserved`; stop at one that nothing crossed."""
    nx, ny = room.shape
    x, y = (px - origin[0]) / cell, (py - origin[1]) / cell
    i: Any = int(np.floor(x))
    j: Any = int(np.floor(y))
    if i < 0 or j < 0 or i >= nx or j >= ny:
        return False
    per_x = 1.0 / ux if abs(ux) > 1e-12 else 1e300
    per_y = 1.0 / uy if abs(uy) > 1e-12 else 1e300
    reach = reach / cell
    while True:
        jump: Any = np.int64(room[i, j])  # signed: it is taken away as well
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
def _are_rays_observed(
    origins: Any, directions: Any, reach: Any, origin: Any, cell: Any, room: Any, out: Any
) -> Any:
    for k in range(len(out)):
        out[k] = is_ray_observed(
            origins[k, 0], origins[k, 1], directions[k, 0], directions[k, 1], reach[k], origin, cell, room
        )


@kernel
def _extent(origins: Any, directions: Any, reach: Any) -> Any:
    """Return the corners of the box around all rays."""
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for k in range(len(reach)):
        for axis in range(2):
            a = origins[k, axis]
            b = a + reach[k] * directions[k, axis]
            low[axis] = min(low[axis], a, b)
            high[axis] = max(high[axis], a, b)
    return low, high


@outer_kernel
def _count_rays(
    origins: Any, directions: Any, reach: Any, shows: Any, origin: Any, cell: Any, counts: Any, free: Any
) -> Any:
    nx, ny = counts.shape
    for k in range(len(reach)):
        ux, uy = directions[k, 0], directions[k, 1]
        x, y = (origins[k, 0] - origin[0]) / cell, (origins[k, 1] - origin[1]) / cell
        i, j = int(np.floor(x)), int(np.floor(y))
        step_x = 1 if ux > 0 else -1
        step_y = 1 if uy > 0 else -1
        per_x = cell / abs(ux) if abs(ux) > 1e-12 else 1e300
        per_y = cell / abs(uy) if abs(uy) > 1e-12 else 1e300
        next_x = ((i + 1 - x) if ux > 0 else (x - i)) * per_x
        next_y = ((j + 1 - y) if uy > 0 else (y - j)) * per_y
        while 0 <= i < nx and 0 <= j < ny:
            if counts[i, j] < MAX_COUNT:
                counts[i, j] += 1
            if shows[k]:
                free[i, j] = True
            if next_x < next_y:
                if next_x > reach[k]:
                    break
                next_x += per_x
                i += step_x
            else:
                if next_y > reach[k]:
                    break
                next_y += per_y
                j += step_y
